"""Sensor faults, for each form: every fault is flagged, and the sigmas stay consistent.

Single faults in detail, and filters without fault detection: inertial/test_aided.py.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from estimators.flights import DT, TICK, Truth, fly_frames, ride, ticks, weave

from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays
from trimtab.core.rotation import wrap
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.mechanisation import InertialStart

N = 1000
NOISE = InertialNoise(gyro=1.6e-4, gyro_walk=1e-8, forward=6.7e-3, starboard=6.7e-3, force_walk=1e-8)
START = InertialStart(sigma_gyro_bias=0.02, sigma_force_bias=0.2)
BIASES = (0.012, 0.1, -0.08)
TRUTH = jax.tree.map(np.asarray, weave(ticks(N)))
AFTER = np.arange(N) >= 500
FORMS = {
    cls.__name__: to_arrays(cls(noise=NOISE, start=START, intake=Intake(slots=48)))
    for cls in (AidedInertialFeedback, AidedInertialDirect, AidedInertialFeedforward, AidedInertialCoupled)
}
FEEDBACK = FORMS["AidedInertialFeedback"]


class Fault(NamedTuple):
    """A fault that begins at sample 500.

    spoil: ride -> ride.  signal: NavigationState -> flags (N,).  grows: sigmas that grow from the flag on.
    truth: of the vehicle.  left_out: samples at which the estimate is not asked to be right about now.
    """

    spoil: Any
    signal: Any
    grows: tuple[str, ...] = ()
    truth: Truth = TRUTH
    left_out: range = range(0)


def given(sent, **changes):
    return sent._replace(**{name: np.where(_rows(new), new[0], getattr(sent, name)) for name, new in changes.items()})


def _rows(new):
    return new[1] if np.ndim(new[0]) < 2 else new[1][:, None]


def nan_imu(sent):
    return given(sent, imu_reading=(np.full((N, 3), np.nan), AFTER))


def nan_position(sent):
    return given(sent, fix=(np.full((N, 2), np.nan), AFTER))


def frozen_heading(sent):
    return given(sent, heading=(np.full((N, 1), sent.heading[500]), AFTER))


def frozen_position(sent):
    sent = sent._replace(fix_fresh=np.arange(N) % 5 == 0)
    return given(sent, fix=(np.tile(sent.fix[500], (N, 1)), AFTER))


def imu_twice(sent):
    """Every fourth packet is the one before it again, so that its own sample is lost."""
    k = np.flatnonzero(AFTER & (np.arange(N) % 4 == 0))
    sent.imu_reading[k], sent.felt_t[k] = sent.imu_reading[k - 1], sent.felt_t[k - 1]
    return sent


def position_again(sent):
    """Each fix is repeated after a newer one, so that a check of the last time alone does not find the duplicate."""
    due = np.flatnonzero(sent.fix_fresh & AFTER)[1:]
    again = due + 2
    again, before = again[again < N], due[: np.sum(again < N)] - 15
    sent.fix[again], sent.fix_t[again] = sent.fix[before], sent.fix_t[before]
    sent.fix_fresh[again] = True
    return sent


def frozen_imu(sent):
    return given(sent, imu_reading=(np.tile(sent.imu_reading[500], (N, 1)), AFTER))


def imu_clock_backwards(sent):
    """By more than the rest of the flight; when it has caught up, its samples are late by that, which `age` reports."""
    return given(sent, felt_t=(sent.felt_t - 520 * TICK, AFTER))


def imu_clock_stops(sent):
    return given(sent, felt_t=(np.full(N, sent.felt_t[500]), AFTER))


def position_clock_backwards(sent):
    return given(sent, fix_t=(sent.fix_t - 400 * TICK, AFTER))


def position_from_the_future(sent):
    return given(sent, fix_t=(sent.fix_t + TICK, AFTER))


def motor_beside_the_compass(sent):
    return given(sent, heading=(sent.heading + 0.6, AFTER & (np.arange(N) < 800)))


def moved_position(sent):
    return given(sent, fix=(sent.fix + np.array([0.5, 0.0]), AFTER))


def _jolt():
    """Truth with 25 m/s² to the north for 0.2 s and back for as long."""
    a = 25.0 * (((np.arange(N) >= 500) & (np.arange(N) < 530)) * 1.0 - ((np.arange(N) >= 530) & (np.arange(N) < 560)))
    v = np.append(0.0, np.cumsum((a[1:] + a[:-1]) / 2 * DT))
    r = np.append(0.0, np.cumsum((v[:-1] + (a[1:] + 2 * a[:-1]) * DT / 6) * DT))
    c, s = np.cos(TRUTH.heading), np.sin(TRUTH.heading)
    imu_reading = TRUTH.imu_reading + np.stack([0 * a, c * a, -s * a], axis=1)
    north = np.stack([v, 0 * v], axis=1), np.stack([r, 0 * r], axis=1)
    return Truth(imu_reading, TRUTH.heading, TRUTH.velocity + north[0], TRUTH.position + north[1])


def _whirl():
    """Truth with 7 rad/s more for a second, which exceeds the gyro's range."""
    extra = 7.0 * ((np.arange(N) >= 500) & (np.arange(N) < 650))
    turned = np.append(0.0, np.cumsum((extra[1:] + extra[:-1]) / 2 * DT))
    c, s = np.cos(turned), np.sin(turned)
    fx, fy = TRUTH.imu_reading[:, 1:].T
    imu_reading = np.stack([TRUTH.imu_reading[:, 0] + extra, c * fx + s * fy, -s * fx + c * fy], axis=1)
    return Truth(imu_reading, TRUTH.heading + turned, TRUTH.velocity, TRUTH.position)


def clipped(sent):
    limits = np.array([FEEDBACK.intake.rate_range, FEEDBACK.intake.force_range, FEEDBACK.intake.force_range])
    return sent._replace(imu_reading=np.clip(sent.imu_reading, -limits, limits))


MOVED = TRUTH._replace(position=TRUTH.position + np.array([0.5, 0.0]) * AFTER[:, None])
EVERYTHING = ("heading", "north", "east", "gyro_bias")
SILENT = range(500, 507)
"""Until the filter coasts, the estimate is old; `age` reports by how much."""
FAULTS = {
    "NaN from the IMU": Fault(nan_imu, lambda s: s.imu.invalid > 0, EVERYTHING, left_out=SILENT),
    "NaN from the position source": Fault(nan_position, lambda s: s.position_sensor.invalid > 0, ("north", "east")),
    "frozen heading": Fault(frozen_heading, lambda s: s.heading_sensor.frozen, ("heading",)),
    "frozen position": Fault(frozen_position, lambda s: s.position_sensor.frozen, ("north", "east")),
    "IMU packets twice": Fault(imu_twice, lambda s: s.imu.duplicates > 0),
    "position packets again": Fault(position_again, lambda s: s.position_sensor.duplicates > 0),
    "IMU clock stands still": Fault(imu_clock_stops, lambda s: s.imu.duplicates > 0, EVERYTHING, left_out=SILENT),
    "IMU clock goes back": Fault(imu_clock_backwards, lambda s: s.imu.backwards, EVERYTHING, left_out=SILENT),
    "frozen IMU": Fault(frozen_imu, lambda s: s.imu.frozen),
    "position clock goes back": Fault(position_clock_backwards, lambda s: s.position_sensor.late > 0, ("north",)),
    "position from the future": Fault(position_from_the_future, lambda s: s.position_sensor.invalid > 0, ("north",)),
    "motor beside the compass": Fault(motor_beside_the_compass, lambda s: s.heading_fix.rejected_in_a_row > 5),
    "position source moved": Fault(
        moved_position, lambda s: s.position_fix.forced == 1, truth=MOVED, left_out=range(500, 650)
    ),
    "gyro at its limit": Fault(clipped, lambda s: s.imu.saturated, truth=_whirl()),
    "accelerometers at their limit": Fault(clipped, lambda s: s.imu.saturated, truth=_jolt()),
}


def flown(form, fault):
    real = TRUTH if fault.truth is MOVED else fault.truth
    told, _ = fly_frames(form, fault.spoil(ride(real, NOISE, biases=BIASES)).frames(form))
    return jax.tree.map(np.asarray, told.state)


def sigmas_off(state, fault):
    """Largest error of each quantity in its own sigma, once the start is over."""
    asked = (np.arange(N) >= 200) & ~np.isin(np.arange(N), fault.left_out)
    errors = {
        "heading": wrap(state.heading - fault.truth.heading),
        "north": state.north - fault.truth.position[:, 0],
        "east": state.east - fault.truth.position[:, 1],
        "gyro_bias": state.gyro_bias - BIASES[0],
        "forward_bias": state.forward_bias - BIASES[1],
        "starboard_bias": state.starboard_bias - BIASES[2],
    }
    return {name: float(np.abs(e / getattr(state, f"sigma_{name}"))[asked].max()) for name, e in errors.items()}


@pytest.mark.thorough
@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("form", FORMS)
def test_each_fault_is_flagged_and_sigmas_stay_consistent(form, name):
    fault = FAULTS[name]
    state = flown(FORMS[form], fault)
    flags = fault.signal(state)
    assert flags[500:].any()
    assert not flags[:495].any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    assert state.covariance.positive.all()
    off = sigmas_off(state, fault)
    assert max(off.values()) < 5, off
    since = int(np.flatnonzero(flags)[0]) + 10
    for which in fault.grows:
        if form == "AidedInertialCoupled" and fault.spoil is frozen_heading:
            assert state.sigma_heading[-1] > 2 * state.sigma_heading[since]  # each fix tells a little of the heading
            continue
        assert (np.diff(getattr(state, f"sigma_{which}")[since:]) > 0).all(), which


TRUSTING = {
    "frozen heading": {"frozen_heading": 0},
    "frozen position": {"frozen_position": 0},
    "gyro at its limit": {"rate_range": 100.0},
    "accelerometers at their limit": {"force_range": 1000.0},
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", TRUSTING)
def test_filter_without_fault_detection_is_wrong(name):
    """The same flights and filter, with the detection of the fault switched off."""
    believed = {key: np.asarray(v, getattr(FEEDBACK.intake, key).dtype) for key, v in TRUSTING[name].items()}
    naive = replace(FEEDBACK, intake=replace(FEEDBACK.intake, **believed))
    assert max(sigmas_off(flown(naive, FAULTS[name]), FAULTS[name]).values()) > 6


def test_rejects_frozen_threshold_above_the_patience():
    with pytest.raises(InputError, match="frozen_position"):
        Intake(frozen_position=6).check()
    Intake(frozen_position=0).check()
