"""Fusion at a delayed horizon: the filter runs a fixed delay behind the present, so that late measurements arrive in
time. The motion from the filter's time to the present is kept separately.

Samples of the IMU wait in a ring buffer until they are `delay` old. Then the filter uses them. A newer fix
waits as well, and is fused when the filter reaches the time at which the fix was measured. No sample is
processed twice, only one state is stored, and the cost of a step does not depend on the delay of a fix.

The vehicle's motion from the filter's time to the present is a single increment (`strapdown`), updated at both ends: a
new sample is appended, and samples that the filter has used are removed from the front. The increments form a group, so
that this is exact. Each sample was added with the biases estimated when it arrived. The window stores the integral of
these biases and is corrected to first order for later changes (`correct_window`).

Source: delayed horizon: Khosravian et al., "Recursive attitude estimation in the presence of multi-rate and multi-delay
vector measurements", ACC 2015; the group: docs page, Gnss and inertial.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core import quaternion
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import NEVER, to_seconds
from trimtab.estimators.inertial.strapdown import (
    Increment,
    average_samples,
    compose,
    increment_of,
    no_increment,
    normalise_turn,
    remove_first,
)

FIXES = 4
"""Maximum number of fixes that wait until the delayed filter reaches their time."""


@record
class InertialWindow:
    """IMU samples not yet used by the filter, the last sample, and their combined increment. Source: this module."""

    head: Scalar = quantity("1", "Slot of the oldest waiting IMU sample in the ring buffer.", kind="count")
    count: Scalar = quantity("1", "Number of waiting IMU samples.", kind="count")
    t: Any = quantity("100 ns", "Time at the end of each IMU sample (slots,).", kind="time")
    dt: Any = quantity("s", "Duration of each IMU sample (slots,).")
    rate: Any = quantity("rad/s", "Measured angular velocity of each sample (slots, 3).", frame="B")
    force: Any = quantity("m/s^2", "Measured specific force of each sample (slots, 3).", frame="B")
    bias: Any = quantity("1", "Gyro and accelerometer biases estimated when each sample arrived (slots, 6).")
    untrusted: Any = quantity("1", "Flag of each sample (slots,): 1 if the sample is not trusted.")
    last: Scalar = quantity("100 ns", "Time at which the last sample was measured.", kind="time")
    imu_reading: Any = quantity(
        "1", "Last IMU sample: angular velocity (rad/s), specific force (m/s^2).", frame="B", shape=(6,)
    )
    motion: Increment = part("Combined motion increment of all waiting samples.")
    entered: Any = quantity(
        "1", "Time integral of the biases of all waiting samples: gyro (rad), accelerometer (m/s).", shape=(6,)
    )


@record
class WaitingFixes:
    """Queue of fixes that were measured after the delayed filter's time. Source: this module."""

    head: Scalar = quantity("1", "Slot of the oldest waiting fix in the queue.", kind="count")
    count: Scalar = quantity("1", "Number of waiting fixes.", kind="count")
    t: Any = quantity("100 ns", "Time at which each fix was measured.", kind="time", shape=(FIXES,))
    value: Any = quantity("1", "Measured values of each fix (FIXES, w).")


class FeltSample(NamedTuple):
    """IMU sample removed from the window: integer end time, duration (s), readings (6,), and 1 if it is not trusted."""

    t: Any
    dt: Any
    imu_reading: Any
    untrusted: Any


def empty_window(slots: int) -> InertialWindow:
    """Return an empty window for the given number of IMU samples."""
    none = np.int32(0)
    return InertialWindow(
        head=none,
        count=none,
        t=np.zeros(slots, np.int64),
        dt=np.zeros(slots),
        rate=np.zeros((slots, 3)),
        force=np.zeros((slots, 3)),
        bias=np.zeros((slots, 6)),
        untrusted=np.zeros(slots),
        last=np.int64(NEVER),
        imu_reading=np.zeros(6),
        motion=no_increment(),
        entered=np.zeros(6),
    )


def no_fixes(width: int) -> WaitingFixes:
    """Return an empty queue of fixes. width: number of values in one fix."""
    none = np.int32(0)
    return WaitingFixes(none, none, np.zeros(FIXES, np.int64), np.zeros((FIXES, width)))


def add_sample(window: InertialWindow, t: Any, imu_reading: Any, bias: Any, untrusted: Any) -> InertialWindow:
    """Return the window with an IMU sample added. The very first sample has no duration and only sets the start time.

    imu_reading: angular velocity (rad/s) and specific force (m/s²) (6,).  bias: estimated biases in these units (6,).
    """
    begun = window.last > NEVER
    dt = jnp.where(begun, to_seconds(t - window.last), 0.0)
    old = jnp.where(begun, window.imu_reading, imu_reading)
    w, f = average_samples(old[:3], old[3:], imu_reading[:3], imu_reading[3:], dt)
    one = increment_of(w - bias[:3], f - bias[3:], dt)
    slots = window.t.shape[0]
    slot = _wrap_index(window.head + window.count, slots)
    new = {"t": t, "dt": dt, "rate": w, "force": f, "bias": bias, "untrusted": untrusted}
    rings = {name: _write_slot(getattr(window, name), slot, value) for name, value in new.items()}
    return replace(
        window,
        **rings,
        count=(window.count + 1).astype(np.int32),
        last=t,
        imu_reading=imu_reading,
        motion=compose(window.motion, one),
        entered=window.entered + bias * dt,
    )


def is_due(window: InertialWindow, delay: Any) -> Any:
    """Return True if the filter must use the oldest IMU sample: it is older than the delay, or the window is full."""
    old = _read_slot(window.t, window.head) <= window.last - delay
    return (window.count > 0) & (old | (window.count >= window.t.shape[0]))


def take_sample(window: InertialWindow) -> tuple[InertialWindow, FeltSample]:
    """Return the window without its oldest IMU sample, and the removed sample."""
    t, dt, w, f, bias, untrusted = (
        _read_slot(ring, window.head)
        for ring in (window.t, window.dt, window.rate, window.force, window.bias, window.untrusted)
    )
    one = increment_of(w - bias[:3], f - bias[3:], dt)
    left = replace(
        window,
        head=_wrap_index(window.head + 1, window.t.shape[0]),
        count=(window.count - 1).astype(np.int32),
        motion=normalise_turn(remove_first(window.motion, one)),
        entered=window.entered - bias * dt,
    )
    return left, FeltSample(t, dt, jnp.concatenate([w, f]), untrusted)


def correct_window(window: InertialWindow, gyro_bias: Any, force_bias: Any) -> Increment:
    """Return the window's motion increment, corrected to first order for new biases.

    The change of bias is spread evenly over the window's time.
    """
    one = window.motion
    turned = window.entered[:3] - gyro_bias * one.time
    pushed = window.entered[3:] - force_bias * one.time
    R = quaternion.to_matrix(one.turn)
    return Increment(
        turn=quaternion.retract(one.turn, (turned + R.T @ turned) / 2),
        velocity=one.velocity + (pushed + R @ pushed) / 2 + jnp.cross(turned, one.velocity) / 2,
        position=one.position + one.time / 6 * (2 * pushed + R @ pushed) + jnp.cross(turned, one.position) / 3,
        time=one.time,
    )


def add_fix(fixes: WaitingFixes, t: Any, value: Any) -> tuple[WaitingFixes, Any]:
    """Return the queue with a fix added, and True, or the unchanged queue and False if it is full.

    The fix must have been measured later than all waiting fixes.
    """
    room = fixes.count < FIXES
    slot = _wrap_index(fixes.head + fixes.count, FIXES)
    after = replace(
        fixes,
        count=(fixes.count + 1).astype(np.int32),
        t=_write_slot(fixes.t, slot, t),
        value=_write_slot(fixes.value, slot, value),
    )
    return jax.tree.map(lambda a, b: jnp.where(room, a, b), after, fixes), room


def next_fix(fixes: WaitingFixes) -> tuple[Any, Any, WaitingFixes]:
    """Return the oldest waiting fix, as integer time and value (w,), and the queue without it."""
    t, value = _read_slot(fixes.t, fixes.head), _read_slot(fixes.value, fixes.head)
    count = (fixes.count - 1).astype(np.int32)
    return t, value, replace(fixes, head=_wrap_index(fixes.head + 1, FIXES), count=count)


def _wrap_index(i: Any, n: int) -> Any:
    return jnp.where(i >= n, i - n, i).astype(np.int32)


def _read_slot(ring: Any, slot: Any) -> Any:
    return lax.dynamic_index_in_dim(ring, slot, keepdims=False)


def _write_slot(ring: Any, slot: Any, value: Any) -> Any:
    ring = jnp.asarray(ring)
    return lax.dynamic_update_index_in_dim(ring, jnp.asarray(value, ring.dtype), slot, 0)
