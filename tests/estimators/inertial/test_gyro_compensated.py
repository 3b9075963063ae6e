"""Navigation behind the gyro's inverse: what reaches it is the compensator's output, sample by sample."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import QUICK, TICK, fly_frames, rest, ride, ticks, turn

from studies.hovercraft2006.gyro_compensation import TABLE_6_5
from trimtab.compiler.function import lower_function
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
    given.imu_reading[:, 0] = rates
    return given


@partial(jax.jit, compiler_options=QUICK)
def flown(given):
    """The last compensated rate (n, 3) and the estimate after each frame."""

    def step(state, frame):
        state, estimate = BEHIND.step(frame.t, state, frame)
        return state, (state.rate, estimate)

    return jax.lax.scan(step, strengthen_types(BEHIND.init(key(0))), given)[1]


def compensated_rates(given):
    """About z (n,)."""
    return np.asarray(flown(given.frames(PLAIN))[0])[:, 2]


@pytest.mark.thorough
def test_navigation_behind_compensator_matches_ideal_gyro():
    truth = turn(ticks(N))
    given = ride(truth, InertialNoise(gyro=1e-30, forward=1e-30, starboard=1e-30, heading=1e-12, position=1e-12))
    swung = given.imu_reading.copy()
    swung[:, 0] += np.sin(np.arange(N) / 7.0)
    gyro = IdentifiedGyro()
    slow = jax.lax.scan(gyro.respond, gyro.start(swung[0, 0]), swung[:, 0])[1]
    direct, behind = (
        given._replace(imu_reading=swung),
        given._replace(imu_reading=np.column_stack([slow, swung[:, 1:]])),
    )
    wanted, _ = fly_frames(PLAIN, direct.frames(PLAIN))
    got = flown(behind.frames(PLAIN))[1]
    np.testing.assert_allclose(got.state.heading, wanted.state.heading, atol=1e-10)
    np.testing.assert_allclose(got.state.yaw_rate, wanted.state.yaw_rate, atol=1e-9)


@pytest.mark.thorough
def test_compensated_rates_match_the_difference_equation():
    y = np.random.default_rng(0).normal(size=N)
    got = compensated_rates(sampled(y))
    c = GyroCompensator()
    b0, past = 1 + c.a1 + c.a2, np.concatenate([[y[0], y[0]], y])
    wanted = (past[2:] + c.a1 * past[1:-1] + c.a2 * past[:-2]) / b0
    np.testing.assert_allclose(got, wanted, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("spoilt", ["nan", "stale", "gap"])
def test_bad_samples_do_not_persist_in_the_filter_state(spoilt):
    y = np.full(N, 0.7)
    given = sampled(y)
    if spoilt == "nan":
        given.imu_reading[10] = np.nan
    elif spoilt == "stale":
        given.felt_fresh[10] = False
        given.imu_reading[10, 0] = 99.0
    else:
        later = np.arange(N) * TICK + np.where(np.arange(N) >= 10, ms(50), 0)
        given = given._replace(now=later, felt_t=later)
    np.testing.assert_allclose(compensated_rates(given), 0.7, atol=1e-12)


def test_rejects_invalid_navigation_intake():
    with pytest.raises(Exception, match="slots"):
        CompensatedInertial(navigation=replace(PLAIN, intake=Intake(slots=2))).check()


PERIOD = 0.0065536
TABLE = np.array(TABLE_6_5)


def compensated(compensator, y):
    run = jax.jit(lambda c, y: jax.lax.scan(c.compensate, c.start(y[0]), y)[1])
    return np.asarray(run(compensator, jnp.asarray(y)))


def measured_response(compensator, f):
    """Complex gain at f (Hz): the compensator fed with a sine, projected on sine and cosine."""
    t = np.arange(400) * PERIOD
    u = compensated(compensator, np.sin(2 * np.pi * f * t))
    basis = np.stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)], 1)[10:]
    a, b = np.linalg.lstsq(basis, u[10:], rcond=None)[0]
    return a + 1j * b


def test_compensator_response_matches_table_6_5():
    """Compensated over uncompensated: gain 1 %, phase 0.006 rad, delay within 0.01 rad/w. [1] table 6.5, eq. 6.2."""
    f, gain, phase, after, phase_after, delay = TABLE.T
    got = np.array([measured_response(GyroCompensator(normalised=False), x) for x in f])
    np.testing.assert_allclose(np.abs(got), after / gain, rtol=0.01)
    np.testing.assert_allclose(np.angle(got), phase_after - phase, atol=0.006)
    assert (np.abs(-np.angle(got) / (2 * np.pi * f) - delay * 1e-3) <= 0.01 / (2 * np.pi * f)).all()


def test_compensator_inverts_the_identified_gyro_exactly():
    u = np.cumsum(np.random.default_rng(0).normal(size=200))
    for normalised in (True, False):
        gyro = IdentifiedGyro(normalised=normalised)
        y = jax.lax.scan(gyro.respond, gyro.start(u[0]), jnp.asarray(u))[1]
        compensator = GyroCompensator(normalised=normalised)
        # Both start settled; without normalisation the gyro rests at 1.046 u.
        np.testing.assert_allclose(compensated(compensator, y), u, atol=1e-12)


def test_gyro_and_compensator_have_equal_parameters():
    """Sensors and estimators do not import each other, so both define the identified parameters."""
    gyro, compensator = IdentifiedGyro(), GyroCompensator()
    for name in (f.name for f in dataclasses.fields(GyroCompensator)):
        assert getattr(gyro, name) == getattr(compensator, name)


@pytest.mark.parametrize(("normalised", "fastest", "white"), [(False, 7.02, 4.42), (True, 7.34, 4.62)])
def test_compensator_amplifies_noise_up_to_nyquist_frequency(normalised, fastest, white):
    compensator = GyroCompensator(normalised=normalised)
    alternating, impulse = np.tile([1.0, -1.0], 20), np.eye(40)[10]
    assert np.abs(compensated(compensator, alternating))[10:].max() == pytest.approx(fastest, abs=0.01)
    assert np.linalg.norm(compensated(compensator, impulse)) == pytest.approx(white, abs=0.01)


@pytest.mark.thorough
def test_compensator_lowers_to_generated_c():
    compensator = GyroCompensator()
    lower_function(lambda c, s, y: c.compensate(s, y), (compensator, compensator.start(jnp.zeros(3)), jnp.zeros(3)))
