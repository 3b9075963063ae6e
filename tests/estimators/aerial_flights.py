"""Whole flights of GNSS and inertial navigation as one function of JAX, for statistics: errors and sigmas.

The world's own sensors on its own path; each flight draws noise, biases and the error of its start. What is compared
stands at the filter's horizon, with all 15 numbers, and now.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import from_euler, to_euler
from trimtab.core.signals import Frame
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.estimators.inertial.error_state import catch_up
from trimtab.estimators.kalman import nees
from trimtab.loop.structure import strengthen_types
from trimtab.scenarios.navigation.aerial import LAP
from trimtab.vehicles.closed_path import ClosedPath
from trimtab.vehicles.rotating_platform import PlatformDrive

TICK = ms(1)
BLOCKS = {"attitude": (0, 3), "velocity": (3, 6), "position": (6, 9), "gyro bias": (9, 12), "force bias": (12, 15)}


class Setting(NamedTuple):
    """What flies: path, sensors, filter, and the error of its start, in sigmas (0 or 1)."""

    path: Any
    imu: Any
    gnss: Any
    form: Any
    off: Any = 1.0


class Outcome(NamedTuple):
    """At each checkpoint.

    nees: of all 15.  blocks: of each three (5,).  error, sigma: at the horizon (15,).
    now, sigma_now: of attitude, velocity and position as told (9,).  used, rejected: measurements so far.
    """

    nees: Any
    blocks: Any
    error: Any
    sigma: Any
    now: Any
    sigma_now: Any
    used: Any
    rejected: Any


def truth(path: ClosedPath, rate: Any, t: Any) -> Any:
    """The motion at integer time t of a lap at a constant rate (rad/s)."""
    s = jnp.asarray(to_seconds(t), float)
    at = path.at(0.0, rate)
    return path.motion(t, replace(at, angle=rate * s, rate=jnp.asarray(rate, float)), PlatformDrive(rate=rate))


def pose_error(q: Any, v: Any, p: Any, motion: Any) -> Any:
    """Attitude, velocity, position: what is missing (9,)."""
    R = from_euler(*motion.attitude)
    turn = quaternion.local(q, quaternion.from_matrix(R))
    return jnp.concatenate([turn, R @ motion.v_WB_B - v, motion.p_WB - p])


def start_of(form: Any, motion: Any, z: Any) -> Any:
    """The filter with a start that is off by z (9,) sigmas."""
    e = z * form.start.sigmas(9)
    R = from_euler(*motion.attitude)
    q = quaternion.multiply(quaternion.from_matrix(R), quaternion.exponential(-e[:3]))
    start = replace(
        form.start,
        angles=to_euler(quaternion.to_matrix(q)),
        velocity=R @ motion.v_WB_B - e[3:6],
        position=motion.p_WB - e[6:9],
    )
    return replace(form, start=start)


def fly(setting: Setting, run: Any, *, length: float, every: float, rate: float = LAP) -> Outcome:
    """One flight of `length` (s), looked at each `every` (s); run: its number (uint32)."""
    path, imu, gnss, form, off = setting
    key = Key(jnp.asarray(7, np.uint32), jnp.asarray(run, np.uint32), 99)
    form = start_of(form, truth(path, rate, np.int64(0)), off * normals(key.at("start"), 0, 9))

    def step(t: Any, carry: Any) -> Any:
        s_imu, s_gnss, s_form, _ = carry
        motion = truth(path, rate, t)
        s_imu, imu_reading = imu.step(t, s_imu, motion)
        s_gnss, fix = gnss.step(t, s_gnss, motion)
        s_form, estimate = form.step(t, s_form, Frame(t, {"imu": imu_reading, "gnss": fix}))
        return s_imu, s_gnss, s_form, estimate

    first = imu.init(key.at("imu")), gnss.init(key.at("gnss")), form.init(key)
    shape = jax.eval_shape(lambda: step(np.int64(0), (*first, None)))
    blank = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shape[3])
    carry = strengthen_types((*first, blank))
    kinds = jax.tree.map(jnp.result_type, carry)

    def chunk(carry: Any, k: Any) -> Any:
        n = seconds(every) // TICK

        def one(i: Any, carry: Any) -> Any:
            return jax.tree.map(jnp.asarray, step((k * n + i).astype(np.int64) * TICK, carry), kinds)

        carry = jax.lax.fori_loop(0, n, one, carry)
        return carry, look(path, rate, imu, form, (k * n + n - 1).astype(np.int64) * TICK, carry)

    return jax.lax.scan(chunk, carry, jnp.arange(round(length / every)))[1]


def look(path: Any, rate: Any, imu: Any, form: Any, t: Any, carry: Any) -> Outcome:
    """What is known at the horizon and now, against the truth."""
    s_imu, _, s_form, estimate = carry
    x = catch_up(s_form.nominal, form.noise)
    pose = pose_error(x.attitude, x.velocity, x.position, truth(path, rate, s_form.t))
    biases = [
        errors.turn_on_bias * state.draws[:3] + state.walk - believed
        for errors, state, believed in (
            (imu.gyro, s_imu.gyro, x.gyro_bias),
            (imu.accelerometer, s_imu.accelerometer, x.force_bias),
        )
    ]
    behind = to_seconds(t - s_form.t)  # biases are those of now: their walk since
    walk = jnp.repeat(jnp.stack([form.noise.gyro_walk, form.noise.force_walk]), 3) ** 2 * behind
    i = np.arange(9, 15)
    error, P = jnp.concatenate([pose, *biases]), x.P[:15, :15].at[i, i].add(walk)
    told = estimate.state
    sigma_now = jnp.concatenate([told.sigma_attitude, told.sigma_velocity, told.sigma_position])
    return Outcome(
        nees=nees(error, P),
        blocks=jnp.stack([nees(error[a:b], P[a:b, a:b]) for a, b in BLOCKS.values()]),
        error=error,
        sigma=jnp.sqrt(jnp.diagonal(P)),
        now=pose_error(told.attitude, told.velocity, told.position, truth(path, rate, t)),
        sigma_now=sigma_now,
        used=told.gnss_fix.used,
        rejected=told.gnss_fix.rejected,
    )
