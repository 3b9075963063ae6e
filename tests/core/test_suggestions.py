"""Suggestions after a misspelt name."""

import pytest

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest, unknown_setting

CHOICES = ["world.vehicle.mass", "world.vehicle.inertia", "autopilot.law.k1"]


def test_closest_finds_a_misspelling():
    assert closest("world.vehicle.mas", CHOICES)[0] == "world.vehicle.mass"


def test_closest_completes_a_bare_last_name():
    assert closest("k1", CHOICES) == ["autopilot.law.k1"]


def test_closest_is_empty_when_nothing_is_near():
    assert closest("zzzz", CHOICES) == []


def test_closest_returns_at_most_n_without_duplicates():
    names = [f"part{i}.mass" for i in range(5)]
    found = closest("mass", names, n=3)
    assert found == ["part0.mass", "part1.mass", "part2.mass"]
    assert closest("part0.mass", names, n=5)[0] == "part0.mass"
    assert len(set(closest("part0.mass", names, n=5))) == len(closest("part0.mass", names, n=5))


@pytest.mark.parametrize(
    ("typed", "choices", "fix"),
    [
        ("world.vehicle.mas", "world.vehicle.mass", 'settings={"world.vehicle.mass": "…"}'),
        ("world.vehicle", "world.vehicle.mass", 'settings={"world.vehicle.mass": "…"}'),
        ("law.k2", "autopilot.law.k1", 'settings={"autopilot.law.k1": "…"}'),
        ("zzzz", "autopilot", "settings(SCENARIO)"),
    ],
)
def test_unknown_setting_error_suggests_the_nearest(typed, choices, fix):
    error = unknown_setting("settings", typed, CHOICES)
    assert isinstance(error, InputError)
    assert error.choices[0] == choices
    assert error.fix.startswith(fix), error.fix


def test_paths_that_only_resemble_the_end_of_a_known_path_are_not_suggested():
    known = ["autopilot.law.k1", "world.wind.mean"]
    assert unknown_setting("settings", "fan.kind", known).choices == ("autopilot", "world")
