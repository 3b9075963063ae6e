"""The filter of a linear model, instant by instant: samples that are late, not finite or old; disturbance."""

import jax
import numpy as np
import pytest

from examples.my_tank import FIRST, Push, Tank, TankState
from trimtab.core.record import replace
from trimtab.core.signals import Frame, new_sample
from trimtab.core.time import ms
from trimtab.loop.linear_filter import design_filter
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPoseState

T = ms(10)


@pytest.fixture(scope="module")
def estimator():
    words = (Tank(), TankState(), Push(), {"pose": NoisyPlanarPose()}, {"pose.north": 0.002}, FIRST)
    return design_filter(*words, {"slosh_rate": 0.3}, period=T)


def frame(t, north, measured=None, force=0.0):
    pose = new_sample(t if measured is None else measured, PlanarPoseState(0.0, 0.0, 0.0, 0.0, north, 0.0))
    return Frame(t=t, samples={"pose": pose, "actuators": new_sample(t, Push(np.float64(force)))})


@jax.jit
def step(estimator, state, frame):
    return estimator.step(frame.t, state, frame)


def fly(estimator, *frames):
    state = strengthen_types(estimator.init(None))
    for one in frames:
        state, estimate = step(estimator, state, strengthen_types(one))
    return state, estimate


@pytest.mark.thorough
def test_sample_is_used_once_while_fresh(estimator):
    state, first = fly(estimator, frame(0, 0.1))
    assert (int(first.used), bool(first.valid), bool(first.fresh)) == (1, True, True)
    assert float(first.state.position) == pytest.approx(0.1, abs=1e-4)
    _, again = estimator.step(T, state, frame(T, 0.3, measured=0))
    assert (int(again.used), float(again.nis), float(again.age)) == (0, 0.0, 0.01)
    _, late = estimator.step(5 * T, state, frame(5 * T, 0.3, measured=T))
    assert int(late.used) == 0
    _, new = estimator.step(T, state, frame(T, 0.3))
    assert int(new.used) == 1


@pytest.mark.thorough
def test_nan_measurements_are_not_used(estimator):
    state, before = fly(estimator, frame(0, 0.1))
    _, after = estimator.step(T, state, frame(T, np.nan, force=np.nan))
    assert int(after.used) == 0
    assert np.isfinite(np.asarray(after.P)).all()
    assert np.isfinite(float(after.state.velocity))
    assert float(after.P[0]) > float(before.P[0])


def test_estimate_is_held_between_periods(estimator):
    state, before = fly(estimator, frame(0, 0.1))
    _, held = step(estimator, state, strengthen_types(frame(T // 2, 0.3)))
    assert (int(held.used), float(held.state.position)) == (0, float(before.state.position))
    np.testing.assert_array_equal(held.P, before.P)


def test_estimate_is_invalid_before_the_first_measurement(estimator):
    _, estimate = fly(estimator, frame(0, np.nan))
    assert not bool(estimate.valid)


def test_disturbance_noise_keeps_the_covariance_large(estimator):
    still = replace(estimator, Qd=np.zeros((4, 4)))
    frames = [frame(k * T, 0.0) for k in range(300)]
    awake, asleep = (fly(one, *frames)[1].P[-1] for one in (estimator, still))
    assert float(awake) > 4 * float(asleep)
