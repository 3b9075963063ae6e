"""The pilot's scenario: its demonstration on the full loop, and a missing stick.

Bands are regression bands around results of this package, over eight seeds.
"""

from functools import cache

import numpy as np
import pytest

from trimtab.core.time import ms, seconds
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.run.replay import replay
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario

ARM = 0.096 / (2.6 * 0.32)


@cache
def flown(navigation, links="chain"):
    scenario, _ = catalogue.load_scenario("hovercraft/pilot", {"navigation": navigation, "links": links})
    return simulate_many(scenario, seeds=range(8), log_period=ms(20), signals=("truth", "law"))


def velocity(log):
    """Return the velocity (north, east) of the steered point over the floor."""
    u, v, r, psi = (log[f"truth.{n}"] for n in ("surge_velocity", "sway_velocity", "yaw_rate", "heading"))
    side = v + ARM * r
    return u * np.cos(psi) - side * np.sin(psi), u * np.sin(psi) + side * np.cos(psi)


def tracking(log, start, end):
    """Return the rms velocity error, the mean speed, and the rate of the course."""
    part = (log.t >= start) & (log.t < end)
    north, east = (x[part] for x in velocity(log))
    speed, course = log["law.speed_reference"][part], log["law.course_reference"][part]
    error = np.sqrt(np.mean((north - speed * np.cos(course)) ** 2 + (east - speed * np.sin(course)) ** 2))
    turn = np.polyfit(log.t[part], np.unwrap(np.arctan2(east, north)), 1)[0]
    return error, np.hypot(north, east).mean(), turn


@pytest.mark.thorough
@pytest.mark.parametrize("links", ["chain", "measured"])
def test_demonstration_tracks_the_stick_on_ins(links):
    """Ahead, turn, stop, spin: 36 and 40 ms of delay or the radio's own, all limits, 8 seeds."""
    logs = flown("ins", links)
    ahead, turn = (np.array([tracking(log, *part) for log in logs]) for part in ((6, 8), (14, 20)))
    assert ahead[:, 0].max() < 0.05
    assert turn[:, 0].max() < 0.12
    np.testing.assert_allclose(turn[:, 1], 0.6, atol=0.05)
    np.testing.assert_allclose(turn[:, 2], 0.36, atol=0.04)
    for log in logs:
        still, spin = log.t > 30, log.t > 38
        assert np.hypot(*velocity(log))[still & (log.t < 32)].max() < 0.08
        assert np.abs(log["truth.yaw_rate"][spin] - 0.9).max() < 0.05


@pytest.mark.thorough
def test_demonstration_tracks_the_stick_on_the_error_model():
    """The thesis' navigation has errors of 0.1 m/s and more, and so have the flights: wider bands, for medians."""
    logs = flown("errors")
    turn = np.median([tracking(log, 14, 20) for log in logs], axis=0)
    assert turn[0] < 0.25
    np.testing.assert_allclose(turn[1:], (0.6, 0.36), atol=0.08)
    spin = np.median([np.abs(log["truth.yaw_rate"][log.t > 36] - 0.9).mean() for log in logs])
    assert spin < 0.15


@pytest.mark.thorough
def test_missing_stick_is_lost_and_craft_stays_still():
    scenario, _ = catalogue.load_scenario("hovercraft/pilot", {"stick": "console"})
    assert scenario.duration >= seconds(600)
    log = simulate(scenario.without("navigation-error"), duration=seconds(10), log_period=ms(10))
    assert log["law.stick_lost"].astype(bool).all()
    assert np.hypot(log["truth.north"], log["truth.east"]).max() == 0.0


@pytest.mark.thorough
def test_log_is_rebuilt_and_replays_exactly(tmp_path):
    for stick in ("script", "console"):
        scenario = build("hovercraft/pilot", {"stick": stick, "supervisor": "automatic", "duration": "3 s"})
        log = read_mcap(write_mcap(simulate(scenario), tmp_path / f"{stick}.mcap"))
        assert replay(log, rebuild_scenario(log)).exact
