"""A filter that runs a fixed delay behind, so that late measurements arrive in time, and the motion from there to now.

Samples of the IMU wait in a ring until they are `delay` old; then the filter takes them. A fix that is less old waits
as well, and is fused when the filter reaches the time at which the fix was made. Nothing is computed twice, only one
state is kept, and a step costs the same whenever a fix arrives.

The vehicle's motion since then is one increment (`strapdown`), updated at both ends: a new sample is appended, and the
samples that the filter has taken are removed from the front. The increments form a group, so this is exact and no
sample is processed again. Each sample entered with the biases estimated at that time. The window stores the mean of
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
"""Maximum number of waiting fixes."""


@record
class InertialWindow:
    """IMU samples not yet used by the filter, the last sample, and their combined increment. Source: this module."""

    head: Scalar = quantity("1", "Slot of the oldest sample.", kind="count")
    count: Scalar = quantity("1", "Number of waiting samples.", kind="count")
    t: Any = quantity("100 ns", "End time of each sample (slots,).", kind="time")
    dt: Any = quantity("s", "Duration of each sample (slots,).")
    rate: Any = quantity("rad/s", "Measured angular velocity (slots, 3).", frame="B")
    force: Any = quantity("m/s^2", "Measured specific force (slots, 3).", frame="B")
    bias: Any = quantity("1", "Gyro and accelerometer biases estimated when each sample came (slots, 6).")
    untrusted: Any = quantity("1", "Flag of each sample (slots,): 1 if the sample is not trusted.")
    last: Scalar = quantity("100 ns", "Time at which the last sample was measured.", kind="time")
    imu_reading: Any = quantity("1", "Reading of the last sample: rad/s, m/s^2.", frame="B", shape=(6,))
    motion: Increment = part("Combined increment of all waiting samples.")
    entered: Any = quantity("1", "Biases of the waiting samples, integrated over their time: rad, m/s.", shape=(6,))


@record
class WaitingFixes:
    """Queue of fixes measured after the time that the filter has reached. Source: this module."""

    head: Scalar = quantity("1", "Slot of the oldest fix.", kind="count")
    count: Scalar = quantity("1", "Number of waiting fixes.", kind="count")
    t: Any = quantity("100 ns", "Time at which each fix was measured.", kind="time", shape=(FIXES,))
    value: Any = quantity("1", "Measured values of each fix (FIXES, w).")


class FeltSample(NamedTuple):
    """Sample as it leaves the window: integer end time, duration (s), readings (6,), and 1 if untrusted."""

    t: Any
    dt: Any
    imu_reading: Any
    untrusted: Any


def empty_window(slots: int) -> InertialWindow:
    """Return the initial window, before the first sample."""
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
    """Return an empty queue; width: numbers of one fix."""
    none = np.int32(0)
    return WaitingFixes(none, none, np.zeros(FIXES, np.int64), np.zeros((FIXES, width)))


def add_sample(window: InertialWindow, t: Any, imu_reading: Any, bias: Any, untrusted: Any) -> InertialWindow:
    """Return the window with one more sample; the first gives only an end time.

    imu_reading, bias: rad/s and m/s² (6,).
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
    """Return True if the oldest sample is due: it is old enough, or its slot is needed."""
    old = _read_slot(window.t, window.head) <= window.last - delay
    return (window.count > 0) & (old | (window.count >= window.t.shape[0]))


def take_sample(window: InertialWindow) -> tuple[InertialWindow, FeltSample]:
    """Return the window without its oldest sample, and that sample."""
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
    """Return the motion of the window for these biases: to first order, the change spread evenly over its time."""
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
    """Return the queue with one more fix, measured later than the waiting ones, and whether there was room for it."""
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
    """Return the oldest waiting fix if due: integer time, value (w,), and the remaining queue."""
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
