"""Every public record of the part folders is documented, tested and on a page."""

import re
from pathlib import Path

import pytest

from contracts.checks import assert_declared
from contracts.parts import FOLDERS, blocks, every, modules, records, vehicles
from trimtab.core.record import Scalar, quantity, record

ROOT = Path(__file__).parents[2]
FOLDERS_WITH_TESTS = ("environment", *FOLDERS, "design", "analysis.identify", "logs", "plots")
FLYING = ("vehicles", "sensors", "links", "estimators", "laws", "actuators")


@pytest.mark.parametrize(
    ("folder", "cls"), every(records, ("environment", *FOLDERS, "core", "loop", "logs", "design", "analysis.identify"))
)
def test_record_declares_source_units_and_meaning(folder, cls):
    assert_declared(cls)


def _text(path):
    return path.read_text(encoding="utf-8") if path.is_file() else ""


@pytest.mark.parametrize(("folder", "module"), every(modules, FOLDERS_WITH_TESTS))
def test_module_has_a_test_file(folder, module):
    """A module has its own test file, or a test of its folder imports it."""
    _, *families, name = module.__name__.split(".")
    path = ROOT.joinpath("tests", *families, f"test_{name}.py")
    neighbours = "".join(_text(p) for p in sorted(ROOT.joinpath("tests", *folder.split(".")).rglob("test_*.py")))
    assert "def test_" in _text(path) or module.__name__ in neighbours, f"write {path.relative_to(ROOT)}"


@pytest.mark.parametrize("folder", FLYING)
def test_every_block_and_vehicle_is_on_a_page(folder):
    """Each block and each vehicle is named on a page of its folder, or of the vehicle that it is for."""
    pages = [p for where in (folder, "vehicles") for p in sorted((ROOT / "docs" / where).rglob("*.md"))]
    words = set(re.findall(r"\w+", "".join(_text(p) for p in pages)))
    flies = blocks(folder) if folder != "vehicles" else vehicles()
    assert [cls.__name__ for cls in flies if cls.__name__ not in words] == []


def test_folders_are_not_empty():
    """A search that finds no module would pass every test."""
    assert [cls.__name__ for cls in records("vehicles")].count("Hovercraft") == 1
    assert all(modules(folder) for folder in FOLDERS)


def test_detects_record_without_source():
    @record
    class Silent:
        """Says nothing."""

        x: Scalar = quantity("m", "A length.")

    with pytest.raises(AssertionError, match="Source:"):
        assert_declared(Silent)


@pytest.mark.parametrize(("unit", "doc", "kind"), [("m", " ", "real"), ("m", "A.", "angle")])
def test_detects_quantity_without_meaning_and_angle_in_metres(unit, doc, kind):
    @record
    class Vague:
        """Source: this test."""

        x: Scalar = quantity(unit, doc, kind=kind)

    with pytest.raises(AssertionError, match=r"Vague\.x"):
        assert_declared(Vague)
