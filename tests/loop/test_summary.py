"""Short summaries of scenarios and parts."""

import pickle

import numpy as np
import pytest

from trimtab.loop.summary import describe_part, summarise_scenario
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import find_scenario
from trimtab.vehicles.hovercraft import Hovercraft


def test_scenario_summary_shows_its_main_parameters():
    text = repr(find_scenario("hovercraft/spin"))
    assert text.startswith("Scenario hovercraft/spin, 22 s\n")
    for said in ("mass 2.6 kg", "yaw_rate 0.1 rad/s", "yaw_rate 3 ± 0.15", "NavigationErrors", "period 20 ms"):
        assert said in text
    assert "<b>hovercraft/spin, 22 s</b>" in find_scenario("hovercraft/spin")._repr_html_()


@pytest.mark.thorough
@pytest.mark.parametrize("name", catalogue.scenario_names())
def test_every_scenario_summary_is_under_twenty_lines(name):
    lines = repr(find_scenario(name)).splitlines()
    assert 10 <= len(lines) < 20
    assert max(map(len, lines)) <= 130


def test_part_summary_shows_class_and_first_parameters():
    assert describe_part(Hovercraft(mass=3.0)) == "Hovercraft: mass 3 kg, inertia 0.096 kg m^2, arm 0.32 m"
    assert describe_part(None) == "none"
    assert describe_part(np.zeros(3)) == "ndarray"


def test_zero_initial_states_are_omitted_from_the_summary():
    rows = dict(summarise_scenario(find_scenario("hovercraft/spin")))
    assert rows["initial"] == "HovercraftState: yaw_rate 0.1 rad/s"


MEMBERS = {
    "run": "simulate(scenario)",
    "plot": "plot_run(simulate(scenario))",
    "vehicle": "scenario.world.vehicle",
    "law": "scenario.autopilot.law",
    "mass": "scenario.world.vehicle.mass",
    "durations": "duration",
}


@pytest.mark.parametrize("name", MEMBERS)
def test_missing_scenario_member_error_says_what_to_write(name):
    scenario = find_scenario("hovercraft/spin")
    with pytest.raises(AttributeError, match="a Scenario has no") as refused:
        getattr(scenario, name)
    assert str(refused.value).endswith(f"write  {MEMBERS[name]}")
    assert pickle.loads(pickle.dumps(scenario)).duration == scenario.duration
