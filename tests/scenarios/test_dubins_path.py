"""`dubins/path`: the word of each goal's shortest path, arrival at the goal, and the effect of the links."""

import numpy as np
import pytest

from trimtab import simulate
from trimtab.design.dubins_paths import WORDS, word_of
from trimtab.scenarios.build import build
from trimtab.scenarios.dubins.path import GOALS


def at_goal(log, scenario, word):
    """Return distance (m) and angle (rad) from the goal when the target reaches it."""
    path = scenario.autopilot.law.reference
    k = int(np.argmax(log["law.progress"] >= path.length / path.speed))
    north, east, heading = GOALS[word]
    turn = log["truth.heading"][k] - np.deg2rad(heading)
    away = np.hypot(log["truth.north"][k] - north, log["truth.east"][k] - east)
    return away, abs((turn + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.thorough("LSL", "RSR", "RSL", "LRL")
@pytest.mark.parametrize("word", WORDS)
def test_car_reaches_the_goal_by_the_shortest_word(word):
    scenario = build("dubins/path", {"word": word})
    assert word_of(scenario.autopilot.law.reference) == word
    away, turn = at_goal(simulate(scenario.ideal()), scenario, word)
    assert away < 0.06  # of a step's 5 cm
    assert turn < 0.06
    away, turn = at_goal(simulate(scenario), scenario, word)
    assert away < 0.25
    assert turn < 0.35


@pytest.mark.thorough
@pytest.mark.parametrize("word", ["RLR", "LRL"])
def test_predictor_halves_the_tracking_error_of_links(word):
    """From one turn into the other, where a delay has the largest effect."""
    late, on = (simulate(build("dubins/path", {"word": word, "predictor": p})) for p in ("off", "on"))
    rms = [np.sqrt(np.mean(log["law.cross_track"][log.t > 3] ** 2)) for log in (late, on)]
    assert 0.04 < rms[0] < 0.1
    assert rms[1] < rms[0] / 2
