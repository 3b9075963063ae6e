"""Navigation behind the gyro's inverse: what reaches it is the compensator's output, sample by sample."""

from functools import partial

import jax
import numpy as np
import pytest
from estimators.flights import QUICK, TICK, fly_frames, rest, ride, ticks, turn

from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.gyro_compensated import CompensatedInertial, GyroCompensator
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.gyro_dynamics import IdentifiedGyro

PLAIN = AidedInertialFeedforward(intake=Intake(frozen_imu=0))
BEHIND = CompensatedInertial(navigation=PLAIN)
N = 200


def sampled(rates):
    """Frames of a vehicle at rest whose gyro says `rates` (n,), everything else without error."""
    given = ride(rest(ticks(len(rates))), InertialNoise(gyro=1e-30, forward=1e-30, starboard=1e-30))
    given.felt[:, 0] = rates
    return given


@partial(jax.jit, compiler_options=QUICK)
def flown(given):
    """The last compensated rate (n, 3) and the estimate after each frame."""

    def step(state, frame):
        state, estimate = BEHIND.step(frame.t, state, frame)
        return state, (state.rate, estimate)

    return jax.lax.scan(step, strengthen_types(BEHIND.init(key(0))), given)[1]


def rates_told(given):
    """About z (n,)."""
    return np.asarray(flown(given.frames(PLAIN))[0])[:, 2]


@pytest.mark.slow
def test_it_undoes_the_identified_gyro_and_the_navigation_sees_the_truth():
    truth = turn(ticks(N))
    given = ride(truth, InertialNoise(gyro=1e-30, forward=1e-30, starboard=1e-30, heading=1e-12, position=1e-12))
    swung = given.felt.copy()
    swung[:, 0] += np.sin(np.arange(N) / 7.0)
    gyro = IdentifiedGyro()
    slow = jax.lax.scan(gyro.respond, gyro.start(swung[0, 0]), swung[:, 0])[1]
    direct, behind = given._replace(felt=swung), given._replace(felt=np.column_stack([slow, swung[:, 1:]]))
    wanted, _ = fly_frames(PLAIN, direct.frames(PLAIN))
    got = flown(behind.frames(PLAIN))[1]
    np.testing.assert_allclose(got.state.heading, wanted.state.heading, atol=1e-10)
    np.testing.assert_allclose(got.state.yaw_rate, wanted.state.yaw_rate, atol=1e-9)


@pytest.mark.slow
def test_rates_are_the_difference_equation():
    y = np.random.default_rng(0).normal(size=N)
    got = rates_told(sampled(y))
    c = GyroCompensator()
    b0, past = 1 + c.a1 + c.a2, np.concatenate([[y[0], y[0]], y])
    wanted = (past[2:] + c.a1 * past[1:-1] + c.a2 * past[:-2]) / b0
    np.testing.assert_allclose(got, wanted, atol=1e-12)


@pytest.mark.parametrize("spoilt", ["nan", "stale", "gap"])
def test_spoilt_samples_do_not_stay_in_its_memory(spoilt):
    y = np.full(N, 0.7)
    given = sampled(y)
    if spoilt == "nan":
        given.felt[10] = np.nan
    elif spoilt == "stale":
        given.felt_fresh[10] = False
        given.felt[10, 0] = 99.0
    else:
        later = np.arange(N) * TICK + np.where(np.arange(N) >= 10, ms(50), 0)
        given = given._replace(now=later, felt_t=later)
    np.testing.assert_allclose(rates_told(given), 0.7, atol=1e-12)


def test_it_refuses_what_the_navigation_refuses():
    with pytest.raises(Exception, match="slots"):
        CompensatedInertial(navigation=replace(PLAIN, intake=Intake(slots=2))).check()
