"""The identity of a scenario on both sides of a link, and the reported differences."""

import pytest

from trimtab.flight.autopilot_end import scenario_dialect
from trimtab.flight.connection_problem import scenario_problem
from trimtab.flight.injector import add_idle_faults
from trimtab.flight.scenario_identity import identity_path, scenario_identity
from trimtab.flight.station.identity import SettingDifference
from trimtab.scenarios.build import build

TYPED = "trimtab fly hovercraft/spin --link udp://127.0.0.1:14550"


def identity(name, settings=None, **kinds):
    scenario = build(name, settings, **kinds)
    return scenario_identity(scenario, scenario_dialect(scenario)), scenario


def differ(one, other):
    return {path for path in {*one, *other} if one.get(path) != other.get(path)}


@pytest.fixture(scope="module")
def plain():
    return identity("hovercraft/forward")[0]


def test_links_supervisor_gains_and_faults_are_not_compared(plain):
    both, scenario = identity("hovercraft/forward", {"supervisor": "automatic", "autopilot.law.k1": "2"})
    assert differ(plain, both) == set()
    vehicle = scenario_identity(add_idle_faults(scenario), scenario_dialect(scenario))
    assert differ(plain, vehicle) == set()
    faulty = identity("hovercraft/forward", faults=["sensor:navigation off @ 3 s"])[0]
    assert differ(plain, faulty) == set()


@pytest.mark.parametrize(
    ("name", "settings", "paths"),
    [
        ("hovercraft/forward", {"world.vehicle.mass": "2.8"}, {"world.vehicle.mass"}),
        ("hovercraft/forward", {"world.sensors.navigation.period": "0.012"}, {"world.sensors.navigation.period"}),
        ("hovercraft/forward", {"failsafe.timeout": "0.5"}, {"failsafe.timeout"}),
        ("hovercraft/forward", {"autopilot.period": "0.005"}, {"autopilot.period"}),
    ],
)
def test_different_setting_on_one_side_is_a_difference(plain, name, settings, paths):
    assert differ(plain, identity(name, settings)[0]) == paths


def test_reported_settings_can_be_set_on_this_side(plain):
    changed = {"world.sensors.navigation.period": "20 ms", "failsafe.timeout": "0.35", "world.vehicle.mass": "2.81"}
    other = identity("hovercraft/forward", changed)[0]
    assert identity("hovercraft/forward", {path: other[path] for path in differ(plain, other)})[0] == other
    own = {p: t for p, t in plain.items() if p.startswith(("world.", "failsafe.")) and " " not in t}
    assert len(own) > 40
    assert identity("hovercraft/forward", own)[0] == plain


def test_different_scenario_with_same_messages_is_a_difference(plain):
    other = identity("hovercraft/spin")[0]
    assert other["messages"] == plain["messages"]
    assert "scenario" in differ(plain, other)


def test_identity_paths_ignore_idle_fault_wrappers(plain):
    assert identity_path("world.sensors.navigation.inner.period") == "world.sensors.navigation.period"
    assert identity_path("world.sensors.navigation.inner.period") in plain


def test_suggested_command_resolves_each_kind_of_difference():
    mass = SettingDifference("world.vehicle.mass", "2.8", "2.6")
    problem = scenario_problem([mass], TYPED)
    assert problem.problem.endswith("world.vehicle.mass: 2.8 on the vehicle, 2.6 here")
    assert problem.fix.startswith(f"{TYPED} --set world.vehicle.mass=2.8 ")
    assert "--accept world.vehicle.mass" in problem.fix
    for given in ("--set world.vehicle.mass=2.6", "--set=world.vehicle.mass=2.6", "--set 'world.vehicle.mass=2.6 kg'"):
        once = scenario_problem([mass], f"{TYPED} {given} --seed 1").fix  # set twice it would be refused
        assert once.startswith(f"{TYPED} --seed 1 --set world.vehicle.mass=2.8 ")
    name = SettingDifference("scenario", "hovercraft/forward", "hovercraft/spin")
    assert scenario_problem([name, mass], TYPED).fix == TYPED.replace("spin", "forward")
    table = SettingDifference("world.actuators.table.values", "100 numbers, hash 1", "100 numbers, hash 2")
    assert scenario_problem([mass, table], TYPED).fix.endswith(
        f"{TYPED} --accept world.actuators --accept world.vehicle"
    )
    many = [SettingDifference(f"world.vehicle.n{k}", "1.0", "2.0") for k in range(20)]
    assert "and 12 more" in scenario_problem(many, TYPED).problem
    assert "same trimtab" in scenario_problem([SettingDifference("version", "0.1", "0.2")], TYPED).fix
