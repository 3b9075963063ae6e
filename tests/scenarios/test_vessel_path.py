"""`vessel/path`: way-points in a current and over a radio, and the effect of settings."""

import numpy as np
import pytest

from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios.build import build


def cross_track(log, start=0.0):
    return np.asarray(log["law.cross_track"])[log.t >= start]


@pytest.mark.thorough
def test_vessel_passes_all_waypoints_at_its_speed():
    log = simulate(build("vessel/path"), seed=0)
    north, east = log["truth.north"], log["truth.east"]
    for place in ((12.0, 0.0), (18.0, 8.0)):
        assert np.hypot(north - place[0], east - place[1]).min() < 2.0
    assert north[-1] > 26
    assert east[-1] == pytest.approx(8.0, abs=0.5)
    assert np.sqrt(np.mean(cross_track(log, 10) ** 2)) < 0.8
    assert log["truth.surge_velocity"][-1] == pytest.approx(0.58, abs=0.05)


@pytest.mark.thorough
def test_zero_integral_gain_leaves_cross_track_error_in_current():
    """The error is D tan(crab), where crab is the angle of the vessel to the path in the current."""
    settings = {"duration": "125"}
    logs = {
        g: simulate(build("vessel/path", {**settings, "autopilot.law.integral_gain": g}).ideal()) for g in ("0.1", "0")
    }
    end = {g: cross_track(log, 120).mean() for g, log in logs.items()}
    through_water = logs["0"]["truth.surge_velocity"][-1] + 0.1
    lookahead = 2.0 + np.exp(-((end["0"] / 2.0) ** 2))
    assert end["0"] == pytest.approx(-lookahead * 0.1 / through_water, rel=0.1)
    assert abs(end["0.1"]) < 0.1 * abs(end["0"])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("settings", "since", "most"),
    [
        ({"links": "none"}, 20, 0.8),
        ({"weather": "breeze"}, 20, 0.9),
        ({"weather": "calm"}, 20, 0.9),
        ({"reference": "circle"}, 45, 0.5),
    ],
)
def test_each_choice_tracks_within_its_bound(settings, since, most):
    log = simulate(build("vessel/path", settings), seed=1)
    assert np.sqrt(np.mean(cross_track(log, since) ** 2)) < most


@pytest.mark.thorough
def test_slow_rudder_makes_the_vessel_weave():
    """The vessel is unstable in yaw: with a rudder rate of 2 deg/s it weaves, with the default it does not."""
    slow = simulate(build("vessel/path", {"world.vehicle.rudder_rate": "0.035"}), seed=0)
    quick = simulate(build("vessel/path"), seed=0)
    weave = [np.abs(np.asarray(log["truth.yaw_rate"])[log.t > 30]).max() for log in (slow, quick)]
    assert weave[0] > 1.5 * weave[1]


@pytest.mark.thorough
def test_seeds_vary_the_error_within_its_bound():
    logs = simulate_many(build("vessel/path"), seeds=range(20))
    errors = [np.sqrt(np.mean(cross_track(log, 20) ** 2)) for log in logs]
    assert np.std(errors) > 0
    assert max(errors) < 0.9
