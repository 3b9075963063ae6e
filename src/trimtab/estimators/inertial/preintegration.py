"""What an IMU felt between two instants, summed up once for any number of filters that start from different states.

With the turn a since the first instant, everything in the body's axes of that instant:

    turn,  dv = int R(a) f dt,  dr = int dv dt,  D1 = int R(a) dt,  D2 = int D1 dt

so that from heading phi, velocity v, position r and biases (bg, ba), T later:

    phi + turn - bg T,   v + B(phi) (dv - D1 ba),   r + v T + B(phi) (dr - D2 ba)

to first order in the biases; what bg T does to B within the step is left out (for 1 deg/s and 0.1 s, 0.002 of dv).

Source: Lupton, Sukkarieh, "Visual-inertial-aided navigation for high-dynamic motion", IEEE Trans. Robotics 28 (2012).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.record import quantity, record
from trimtab.core.rotation import planar
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.mechanisation import mechanise
from trimtab.estimators.inertial.sensor_watch import NEVER


@record
class ImuHistory:
    """The last samples of an IMU, the newest at the end. Source: docs page, Particle filter."""

    t: Any = quantity("100 ns", "When each was taken; never: none yet.", kind="time")
    felt: Any = quantity("1", "Yaw rate (rad/s), force per mass forward and starboard (m/s^2); (slots, 3).")
    doubt: Any = quantity("1", "1 where gyro, or accelerometers, can't be trusted; (slots, 2).")


class PreintegratedMotion(NamedTuple):
    """Between two instants: time (s), turn (rad), velocity (2,), position (2,), D1 and D2 (2, 2), doubt (2,)."""

    time: Any
    turn: Any
    velocity: Any
    position: Any
    D1: Any
    D2: Any
    doubt: Any


def empty_imu_history(slots: int) -> ImuHistory:
    """Before the first."""
    return ImuHistory(np.full(slots, NEVER, np.int64), np.zeros((slots, 3)), np.zeros((slots, 2)))


def append_sample(h: ImuHistory, t: Any, felt: Any, doubt: Any) -> ImuHistory:
    """With one more sample; the oldest is forgotten."""
    t, felt, doubt = (jnp.asarray(v) for v in (t, felt, doubt))
    return ImuHistory(
        jnp.concatenate([h.t[1:], t[None]]),
        jnp.concatenate([h.felt[1:], felt[None]]),
        jnp.concatenate([h.doubt[1:], doubt[None]]),
    )


def preintegrate(h: ImuHistory, begin: Any, end: Any) -> PreintegratedMotion:
    """The motion from one instant to another, as far as samples reach; readings run straight between samples."""
    zero, two = jnp.zeros(()), jnp.zeros(2)
    start = PreintegratedMotion(zero, zero, two, two, jnp.zeros((2, 2)), jnp.zeros((2, 2)), two)

    def one(m: PreintegratedMotion, i: Any) -> tuple[PreintegratedMotion, None]:
        t0, t1 = h.t[i], h.t[i + 1]
        a, b = jnp.maximum(t0, begin), jnp.minimum(t1, end)
        there = (t0 > NEVER) & (b > a)
        span = jnp.where(there, t1 - t0, 1).astype(np.float64)
        share = [jnp.where(there, (t - t0).astype(np.float64) / span, 0.0) for t in (a, b)]
        f0, f1 = (h.felt[i] + s * (h.felt[i + 1] - h.felt[i]) for s in share)
        dt = jnp.where(there, to_seconds(b - a), 0.0)
        turn = m.turn + dt * (f0[0] + f1[0]) / 2
        R0, R1 = planar(m.turn), planar(turn)
        velocity, position = mechanise(dt, R0 @ f0[1:], R1 @ f1[1:], m.velocity, m.position)
        D1, D2 = mechanise(dt, R0, R1, m.D1, m.D2)
        doubt = jnp.where(there, jnp.maximum(m.doubt, jnp.maximum(h.doubt[i], h.doubt[i + 1])), m.doubt)
        return PreintegratedMotion(m.time + dt, turn, velocity, position, D1, D2, doubt), None

    return lax.scan(one, start, jnp.arange(h.t.shape[0] - 1))[0]
