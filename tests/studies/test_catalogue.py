"""What studies and groups there are follows from the folders."""

import pytest

from studies import catalogue
from trimtab.core.errors import InputError

NAME = "hovercraft2006"


def test_studies_and_groups_are_the_files_with_rows():
    assert NAME in catalogue.list_studies()
    found = catalogue.list_groups(NAME)
    folder = catalogue.FOLDER / NAME
    files = {f.stem.replace("_", "-") for f in folder.glob("*.py") if "\ndef rows(" in f.read_text(encoding="utf-8")}
    assert {g.name for g in found} == files >= {"control-laws", "inertia", "simulated-autopilot"}
    assert all(g.title and g.section for g in found)


def test_groups_are_in_the_order_of_the_publication(tmp_path, monkeypatch):
    sections = {"early": "2.10", "late": "10.1", "first": "2.2", "equations": "eqs. 3-4", "unnumbered": "simulation"}
    for name, section in sections.items():
        (tmp_path / "s").mkdir(exist_ok=True)
        (tmp_path / "s" / f"{name}.py").write_text(f'"""T."""\nSECTION = "{section}"\ndef rows(): ...\n')
    (tmp_path / "s" / "__init__.py").write_text('"""A study."""\n')
    (tmp_path / "s" / "errata.py").write_text('"""No group."""\n')
    monkeypatch.setattr(catalogue, "FOLDER", tmp_path)
    found = catalogue.list_groups("s")
    assert [g.name for g in found] == ["first", "early", "equations", "late", "unnumbered"]
    assert [g.place for g in found[1:3]] == ["section 2.10", "eqs. 3-4"]
    assert [g.name for g in catalogue.list_groups("s", ["late"])] == ["late"]


def test_unknown_names_are_refused_with_the_choices():
    with pytest.raises(InputError, match=r"no such study.*\nChoices: .*\nFix: trimtab reproduce hovercraft2006"):
        catalogue.list_groups("hovercraft")
    with pytest.raises(InputError, match=r"no group 'inertial'.*\nChoices: .*\nFix: --only inertia"):
        catalogue.list_groups(NAME, ["inertia", "inertial"])
