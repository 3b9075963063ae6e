"""Tests of the estimator, alone and in a flight: pytest test_my_estimator.py"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import build, replace, simulate
from trimtab.core.signals import Frame, new_sample
from trimtab.sensors.planar_pose import PlanarPoseState

FLOWN = build(f"{Path(__file__).with_name('my_estimator.py')}:scenario")
FILTER = FLOWN.autopilot.estimator


def feed(yaw_rates: list[float], fresh: bool = True) -> list[Any]:
    """Return the estimate after each measured rate of turn (rad/s). The samples are 50 ms apart."""
    state, estimates = FILTER.init(None), []
    for k, rate in enumerate(yaw_rates):
        sample = new_sample(k * 500_000, PlanarPoseState(0.5, 0.0, rate, 1.0, 2.0, 3.0), fresh=fresh or k == 0)
        state, estimate = FILTER.step(sample.t, state, Frame(sample.t, {FILTER.sensor: sample}))
        estimates.append(estimate)
    return estimates


def test_first_measurement_sets_the_estimate():
    """Before the first measurement the estimate is not valid."""
    (estimate,) = feed([0.3])
    assert float(estimate.state.yaw_rate) == 0.3
    assert bool(estimate.valid)
    assert not bool(FILTER.init(None).begun)


def test_step_response_is_of_first_order():
    """The step response after k measurements is 1 - (1 - share)^k. Position and heading are as measured."""
    last = feed([0.0] + [1.0] * 5)[-1].state
    np.testing.assert_allclose(float(last.yaw_rate), 1 - (1 - FILTER.share) ** 5, rtol=1e-12)
    assert (float(last.heading), float(last.north), float(last.east)) == (1.0, 2.0, 3.0)


def test_old_sample_changes_nothing():
    """A sample that was already used is not used again."""
    assert float(feed([0.0, 1.0, 1.0], fresh=False)[-1].state.yaw_rate) == 0.0


def test_reduces_noise_in_flight():
    """Compare the noise of the yaw rate with and without the filter, in two flights compiled to C."""

    def noise(share: Any) -> Any:
        flown = replace(FLOWN.autopilot, estimator=replace(FILTER, share=share))
        log = simulate(replace(FLOWN, autopilot=flown))
        assert abs(log.final["truth.surge_velocity"] - 0.58) < 0.1
        return np.std(np.diff(log["estimate.state.yaw_rate"]))

    assert noise(FILTER.share) < 0.7 * noise(1.0)
