"""Strapdown navigation by increments: IMU readings over a time become one increment of attitude, velocity and position.

Increments are independent of the initial state. An increment can be appended to another (`compose`), removed from the
front of another (`remove_first`), and applied to any state (`move`). If angular velocity and specific force are
constant in B, the result is exact over any time. Coning and sculling terms cover linear changes between two samples.

    R+ = R dR,    v+ = v + g T + R dv,    p+ = p + v T + g T²/2 + R dp

Source: Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508; Groves, "Principles of GNSS,
inertial, and multisensor integrated navigation systems", 2nd ed., section 5.5; Forster et al., "On-manifold
preintegration for real-time visual-inertial odometry", IEEE Trans. Robotics 33 (2017).
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.record import Scalar, quantity, record

ORDER = 4
"""Order of the power series in the rotation angle within one IMU sample. The truncation error is 1e-8 at 1 rad. For
angles of at most 0.1 rad it is smaller than the rounding error."""


@record
class Increment:
    """Motion increment over a time T, in the axes of B at the beginning, without gravity. Source: this module."""

    turn: Any = quantity("1", "Quaternion dR from B at the end to B at the beginning of the increment.", shape=(4,))
    velocity: Any = quantity("m/s", "Integral dv of the specific force over the increment.", frame="B", shape=(3,))
    position: Any = quantity("m", "Double integral dp of the specific force over the increment.", frame="B", shape=(3,))
    time: Scalar = quantity("s", "Duration T of the increment.")


class Kinematics(NamedTuple):
    """Kinematic state: attitude q_WB (4,), velocity (3,) and position (3,) in W."""

    attitude: Any
    velocity: Any
    position: Any


def no_increment() -> Increment:
    """Return the increment of zero duration and no motion."""
    three = jnp.zeros(3)
    return Increment(jnp.asarray(quaternion.IDENTITY), three, three, jnp.zeros(()))


def average_samples(w0: Any, f0: Any, w1: Any, f1: Any, dt: Any) -> tuple[Any, Any]:
    """Return the constant angular velocity and force (3,) that act over dt (s) like a linear change between two
    samples.

    The coning term dt/12 w0 × w1 and the sculling term dt/12 (w0 × f1 - w1 × f0) are the second term of the Magnus
    series for a rate that changes linearly.
    Source: Groves, 2nd ed., section 5.5.4; Savage, J. Guidance, Control, Dynamics 21 (1998) 19.
    """
    w = (w0 + w1) / 2 + dt / 12 * jnp.cross(w0, w1)
    f = (f0 + f1) / 2 + dt / 12 * (jnp.cross(w0, f1) - jnp.cross(w1, f0))
    return w, f


def increment_of(w: Any, f: Any, dt: Any) -> Increment:
    """Return the increment of a constant angular velocity w (rad/s) and force f (m/s²), (3,) in B, over dt (s).

    With a = w dt, the integrals of the rotation are G1 = sum a×^k/(k+1)! and G2 = sum a×^k/(k+2)!. Their coefficients
    are power series in |a|², so that no trigonometric function is needed.
    """
    a = w * dt
    a2 = a @ a
    half = a / 2
    cosine, sinc = _series(a2 / 4, 0), _series(a2 / 4, 1)
    c, d = _series(a2, 3), _series(a2, 4)
    b = 0.5 - a2 * d
    across = jnp.cross(a, f)
    twice = jnp.cross(a, across)
    turn = jnp.concatenate([cosine[None], sinc * half])
    velocity = (f + b * across + c * twice) * dt
    position = (f / 2 + c * across + d * twice) * (dt * dt)
    return Increment(turn, velocity, position, jnp.asarray(dt, float))


def _series(x2: Any, n: int) -> Any:
    """Return the sum over k of (-x²)^k/(2 k + n)!: cos, sin/x, (1 - cos)/x², … for n = 0, 1, 2, …"""
    total = jnp.asarray(1.0 / math.factorial(2 * ORDER + n))
    for k in range(ORDER - 1, -1, -1):
        total = 1.0 / math.factorial(2 * k + n) - x2 * total
    return total


def compose(first: Increment, then: Increment) -> Increment:
    """Return the increment that combines two increments, one after the other."""
    R = quaternion.to_matrix(first.turn)
    return Increment(
        turn=quaternion.multiply(first.turn, then.turn),
        velocity=first.velocity + R @ then.velocity,
        position=first.position + first.velocity * then.time + R @ then.position,
        time=first.time + then.time,
    )


def remove_first(both: Increment, first: Increment) -> Increment:
    """Return the rest of an increment after the part `first`, so that compose(first, rest) is the complete
    increment."""
    R_T = quaternion.to_matrix(first.turn).T
    time = both.time - first.time
    return Increment(
        turn=quaternion.multiply(quaternion.conjugate(first.turn), both.turn),
        velocity=R_T @ (both.velocity - first.velocity),
        position=R_T @ (both.position - first.position - first.velocity * time),
        time=time,
    )


def normalise_turn(one: Increment) -> Increment:
    """Return the increment with its quaternion normalised to first order, to remove rounding errors."""
    q = one.turn
    return Increment(q * (1.5 - 0.5 * (q @ q)), one.velocity, one.position, one.time)


def move(x: Kinematics, one: Increment, gravity: Any) -> Kinematics:
    """Return the kinematic state after an increment, under the gravity vector (3,) in W (m/s²)."""
    R, T = quaternion.to_matrix(x.attitude), one.time
    q = quaternion.multiply(x.attitude, one.turn)
    return Kinematics(
        attitude=q * (1.5 - 0.5 * (q @ q)),
        velocity=x.velocity + gravity * T + R @ one.velocity,
        position=x.position + x.velocity * T + gravity * (T * T / 2) + R @ one.position,
    )
