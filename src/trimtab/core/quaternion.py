"""Unit quaternions: attitude in three dimensions without a singular angle.

Conventions: Hamilton's product, scalar first, q = (w, x, y, z); q_WB transforms body components to world components,
v_W = q_WB (0, v_B) q_WB*, and q_AC = q_AB q_BC. q and -q are the same attitude. The results of `to_matrix` and `rotate`
do not depend on the quaternion's length, which may drift during integration.

Source: Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, chapters 1, 2 and 4;
Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1 (1978).
"""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar

IDENTITY = (1.0, 0.0, 0.0, 0.0)
"""Quaternion of the zero rotation."""
SMALL2 = 1e-8
"""Squared half angle (rad²) below which a power series replaces the closed formula, which would divide by zero."""


def multiply(p: Any, q: Any) -> Any:
    """Return the product p q (4,), the rotation by q followed by the rotation by p."""
    return jnp.stack(
        [
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        ]
    )


def conjugate(q: Any) -> Any:
    """Return the conjugate q* (4,), which is the inverse of a unit quaternion: q_BW for q_WB."""
    return jnp.stack([q[0], -q[1], -q[2], -q[3]])


def normalise(q: Any) -> Any:
    """Return the unit quaternion (4,) of the same attitude."""
    return q / jnp.sqrt(q @ q)


def rotate(q_WB: Any, v_B: Any) -> Any:
    """Return v_W (3,), the vector v_B (3,) rotated by q_WB."""
    return to_matrix(q_WB) @ v_B


def to_matrix(q: Any) -> Any:
    """Return R_WB (3, 3) for q_WB (4,) of any length except zero."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    s = 2 / (w * w + x * x + y * y + z * z)
    return jnp.stack(
        [
            jnp.stack([1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)]),
            jnp.stack([s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)]),
            jnp.stack([s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)]),
        ]
    )


def from_matrix(R: Any) -> Any:
    """Return q_WB (4,), w >= 0, for a rotation matrix R_WB (3, 3), by Shepperd's method."""
    T = R[0, 0] + R[1, 1] + R[2, 2]
    a, b, c = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    d, e, f = R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] + R[1, 2]
    rows = jnp.stack(
        [
            jnp.stack([1 + T, a, b, c]),
            jnp.stack([a, 1 + 2 * R[0, 0] - T, d, e]),
            jnp.stack([b, d, 1 + 2 * R[1, 1] - T, f]),
            jnp.stack([c, e, f, 1 + 2 * R[2, 2] - T]),
        ]
    )
    squares = jnp.stack([rows[0, 0], rows[1, 1], rows[2, 2], rows[3, 3]])
    q = normalise(rows[jnp.argmax(squares)])
    return jnp.where(q[0] < 0, -q, q)


def from_euler(roll: Scalar, pitch: Scalar, yaw: Scalar) -> Any:
    """Return q_WB (4,) for roll, pitch and yaw (rad), order 3-2-1."""
    cr, sr, cp, sp, cy, sy = (g(a / 2) for a in (roll, pitch, yaw) for g in (jnp.cos, jnp.sin))
    return jnp.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def exponential(v: Any) -> Any:
    """Return q (4,) that rotates by |v| (rad) about v (3,). For small |v|, a power series is used."""
    a2 = (v @ v) / 4
    small = a2 < SMALL2
    a = jnp.sqrt(jnp.where(small, 1.0, a2))
    half_sinc = jnp.where(small, 0.5 - a2 / 12, jnp.sin(a) / (2 * a))
    cosine = jnp.where(small, 1 - a2 / 2 + a2 * a2 / 24, jnp.cos(a))
    return jnp.stack([cosine, half_sinc * v[0], half_sinc * v[1], half_sinc * v[2]])


def logarithm(q: Any) -> Any:
    """Return the shortest rotation vector v (3,) (rad), |v| <= pi, with exponential(v) = ± q, for a unit q (4,)."""
    sign = jnp.where(q[0] < 0, -1.0, 1.0)
    w, x = sign * q[0], sign * q[1:]
    s2 = x @ x
    small = s2 < SMALL2
    s = jnp.sqrt(jnp.where(small, 1.0, s2))
    w_safe = jnp.where(small, w, 1.0)
    return jnp.where(small, 2 / w_safe - 2 * s2 / (3 * w_safe**3), 2 * jnp.arctan2(s, w) / s) * x


def retract(q_WB: Any, v_B: Any) -> Any:
    """Return q_WB (4,) after a further rotation by v_B (3,) (rad), given in body axes."""
    return multiply(q_WB, exponential(v_B))


def local(p_WB: Any, q_WB: Any) -> Any:
    """Return v_B (3,) (rad) with retract(p, v) = ± q: the rotation from p to q in body axes."""
    return logarithm(multiply(conjugate(p_WB), q_WB))


def rate(q_WB: Any, w_WB_B: Any) -> Any:
    """Return the derivative (4,) of q_WB under an angular velocity (3,) (rad/s) in body axes."""
    return multiply(q_WB, jnp.concatenate([jnp.zeros_like(w_WB_B[:1]), w_WB_B])) / 2
