"""Navigation behind the gyro's inverse: what reaches it is the compensator's output, sample by sample."""

import jax
import numpy as np
import pytest

from estimators.flights import TICK, fly_frames, rest, ride, ticks, turn
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.estimators.aided_inertial import Intake
from trimtab.estimators.aided_inertial_feedforward import AidedInertialFeedforward
from trimtab.estimators.compensated_inertial import CompensatedInertial
from trimtab.estimators.dual_filter import InertialNoise
from trimtab.estimators.gyro_compensator import GyroCompensator
from trimtab.loop.structure import strong
from trimtab.sensors.gyro_dynamics import IdentifiedGyro

PLAIN = AidedInertialFeedforward(intake=Intake(frozen_imu=0))
BEHIND = CompensatedInertial(navigation=PLAIN)
N = 200


def sampled(rates):
    """Frames of a vehicle at rest whose gyro says `rates` (n,), everything else without error."""
    given = ride(rest(ticks(len(rates))), InertialNoise(gyro=1e-30, forward=1e-30, starboard=1e-30))
    given.felt[:, 0] = rates
    return given


def rates_told(given, form=BEHIND):
    """The last compensated rate (n, 3) after each frame."""
    step = jax.jit(lambda s, f: form.step(f.t, s, f)[0])
    state, out = strong(form.init(key(0))), []
    frames = given.frames(form.navigation)
    for k in range(len(given.now)):
        state = step(state, jax.tree.map(lambda a, k=k: a[k], frames))
        out.append(np.asarray(state.rate))
    return np.array(out)


def test_it_undoes_the_identified_gyro_and_the_navigation_sees_the_truth():
    truth = turn(ticks(N))
    given = ride(truth, InertialNoise(gyro=1e-30, forward=1e-30, starboard=1e-30, heading=1e-12, position=1e-12))
    swung = given.felt.copy()
    swung[:, 0] += np.sin(np.arange(N) / 7.0)
    gyro = IdentifiedGyro()
    slow = jax.lax.scan(gyro.respond, gyro.start(swung[0, 0]), swung[:, 0])[1]
    direct, behind = given._replace(felt=swung), given._replace(felt=np.column_stack([slow, swung[:, 1:]]))
    wanted, _ = fly_frames(PLAIN, direct.frames(PLAIN))
    got = _fly(behind)
    np.testing.assert_allclose(got.state.heading, wanted.state.heading, atol=1e-10)
    np.testing.assert_allclose(got.state.yaw_rate, wanted.state.yaw_rate, atol=1e-9)


def _fly(given):
    step = lambda s, f: BEHIND.step(f.t, s, f)  # noqa: E731
    return jax.jit(lambda frames: jax.lax.scan(step, strong(BEHIND.init(key(0))), frames)[1])(given.frames(PLAIN))


def test_rates_are_the_difference_equation():
    y = np.random.default_rng(0).normal(size=30)
    got = rates_told(sampled(y))[:, 2]
    c = GyroCompensator()
    b0, past = 1 + c.a1 + c.a2, np.concatenate([[y[0], y[0]], y])
    wanted = (past[2:] + c.a1 * past[1:-1] + c.a2 * past[:-2]) / b0
    np.testing.assert_allclose(got, wanted, atol=1e-12)


@pytest.mark.parametrize("spoilt", ["nan", "stale", "gap"])
def test_spoilt_samples_do_not_stay_in_its_memory(spoilt):
    y = np.full(30, 0.7)
    given = sampled(y)
    if spoilt == "nan":
        given.felt[10] = np.nan
    elif spoilt == "stale":
        given.felt_fresh[10] = False
        given.felt[10, 0] = 99.0
    else:
        later = np.arange(30) * TICK + np.where(np.arange(30) >= 10, ms(50), 0)
        given = given._replace(now=later, felt_t=later)
    np.testing.assert_allclose(rates_told(given)[:, 2], 0.7, atol=1e-12)


def test_it_refuses_what_the_navigation_refuses():
    with pytest.raises(Exception, match="slots"):
        CompensatedInertial(navigation=replace(PLAIN, intake=Intake(slots=2))).check()
