"""Top-level names of the package: complete, typed, and imported only on use."""

import doctest
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import trimtab


@pytest.mark.parametrize("name", trimtab.HOMES)
def test_every_top_level_name_is_the_object_of_its_module(name):
    module, _, own = trimtab.HOMES[name].partition(":")
    home = importlib.import_module(f"trimtab.{module}")
    assert getattr(trimtab, name) is getattr(home, own or name)


def test_type_checkers_see_the_same_names():
    stub = Path(trimtab.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    found = re.findall(r"^from trimtab\.(\S+) import (.*)$", stub, re.MULTILINE)
    names = {own.strip(): home for home, several in found for own in several.split(",")}
    seen = {own.partition(" as ")[2]: home for own, home in names.items() if " as " in own}
    for other, own in re.findall(r"^(\w+) = (\w+)$", stub, re.MULTILINE):
        seen[other] = f"{names[own]}:{own}"
    assert seen == trimtab.HOMES


def test_importing_the_package_imports_no_heavy_module():
    code = "import sys, trimtab; print([m for m in ('jax', 'numpy', 'scipy', 'click') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_unknown_attribute_suggests_existing_name():
    with pytest.raises(AttributeError, match="Campaign"):
        trimtab.campain  # noqa: B018


@pytest.mark.parametrize("name", trimtab.OTHER_NAMES)
def test_common_alternative_name_suggests_ours(name):
    assert trimtab.OTHER_NAMES[name] in trimtab.HOMES
    with pytest.raises(AttributeError, match=f"write  trimtab.{trimtab.OTHER_NAMES[name]};"):
        trimtab.__getattr__(name)


def test_star_import_gives_the_public_names():
    names = {}
    exec("from trimtab import *", names)
    assert set(trimtab.HOMES) <= set(names)


FLIES = [
    "simulate_batch",
    "plot_run",
    "metrics",
    "read_log",
    "write_log",
    "replay",
    "Campaign",
    "error_budget",
    "falsify",
    "tune",
    "trim",
    "linearise",
    "compile",
    "export_c",
]
"""Names whose examples compile something."""


def run_example(name):
    """Run the example in the docstring of a name."""
    thing = getattr(trimtab, name)
    test = doctest.DocTestParser().get_doctest(thing.__doc__, {}, name, None, 0)
    assert test.examples, f"{name} has no example"
    said = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    runner.run(test, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)


@pytest.mark.parametrize("name", [n for n in trimtab.HOMES if n not in FLIES])
def test_docstring_example_prints_the_shown_output(name):
    run_example(name)


@pytest.mark.thorough
@pytest.mark.parametrize("name", FLIES)
def test_docstring_example_of_simulation_prints_the_shown_output(name):
    run_example(name)


def test_class_docs_show_fields_with_unit_and_meaning():
    from trimtab.vehicles.hovercraft import Hovercraft

    assert "mass [kg]: Total mass with batteries. Default: 2.6." in Hovercraft.__doc__
    assert "max_step: Longest step of the integration. Default: 1 ms." in trimtab.World.__doc__
    assert "vehicle: Model of the true vehicle: dynamics and motion." in trimtab.World.__doc__


@pytest.mark.parametrize("value", ["3 m", "three"])
def test_rejects_text_that_is_not_a_mass(value):
    with pytest.raises(trimtab.InputError, match=r"Hovercraft\.mass.*") as refused:
        trimtab.replace(trimtab.build("hovercraft/spin").world.vehicle, mass=value)
    assert refused.value.fix.startswith('mass="')


@pytest.mark.parametrize(
    ("duration", "said"),
    [(30, "30 units of 100 ns are 0.003 ms"), (30.0, "not a whole number"), ("3 kg", "is not a time"), (True, "True")],
)
def test_rejects_invalid_duration_with_message(duration, said):
    with pytest.raises(trimtab.InputError, match=said) as refused:
        trimtab.simulate("hovercraft/spin", duration=duration)
    assert 'duration="' in refused.value.fix


def test_rejects_invalid_scenario_argument():
    with pytest.raises(trimtab.InputError, match="must be a Scenario or a scenario's name, got a int"):
        trimtab.simulate(3)
    with pytest.raises(trimtab.InputError, match="unknown scenario"):
        trimtab.simulate("hovercraft/spn")


SAMPLE = """
from trimtab import Autopilot, Scenario, World, build
from trimtab.scenarios.hovercraft import spin
from trimtab.vehicles.hovercraft import Hovercraft

def of(scenario: Scenario[Hovercraft], any_one: Scenario, world: World[Hovercraft]) -> None:
    reveal_type(scenario.world.vehicle)
    reveal_type(any_one.world.vehicle)
    reveal_type(world.vehicle.mas)
    reveal_type(World(Hovercraft(), {}, None, None, None).vehicle)
    reveal_type(spin.scenario().world.vehicle)
"""


@pytest.mark.thorough
def test_type_checker_infers_vehicle_class(tmp_path):
    (tmp_path / "sample.py").write_text(SAMPLE)
    package = Path(trimtab.__file__).parent
    assert (package / "py.typed").exists()
    (tmp_path / "pyrightconfig.json").write_text(f'{{"extraPaths": ["{package.parent}"]}}')
    command = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable, "-p", str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout
    types = re.findall(r'sample.py:(\d+).*Type of ".*" is "(.*)"', said)
    assert [t for line, t in types if line != "9"] == ["Hovercraft", "Any", "Hovercraft", "Hovercraft"], said
    assert 'Cannot access attribute "mas" for class "Hovercraft"' in said
