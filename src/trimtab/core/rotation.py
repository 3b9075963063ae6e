"""Rotations in the plane and in space.

Conventions: right-handed frames, z down; R_WB takes body components to world components, v_W = R_WB v_B. Quaternions
are (w, x, y, z), unit, q_WB the same rotation as R_WB, and q and -q are equal. Euler angles are roll, pitch, yaw
about x, y, z in the order yaw, pitch, roll (3-2-1).

Source: Diebel, "Representing attitude", Stanford 2006; Stevens, Lewis, Johnson, "Aircraft control and simulation", 1.3.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar


def wrap(angle: Scalar) -> Scalar:
    """An angle (rad) as its equal in [-pi, pi)."""
    return angle - 2 * np.pi * jnp.floor((angle + np.pi) / (2 * np.pi))


def wrap_positive(angle: Scalar) -> Scalar:
    """An angle (rad) as its equal in [0, 2 pi)."""
    wrapped = angle - 2 * np.pi * jnp.floor(angle / (2 * np.pi))
    return jnp.where(wrapped < 2 * np.pi, wrapped, 0.0)  # a tiny negative angle rounds up to a full turn


def planar(heading: Scalar) -> Any:
    """R_WB (2, 2) of a heading (rad): body to world components in the horizontal plane."""
    c, s = jnp.cos(heading), jnp.sin(heading)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def from_euler(roll: Scalar, pitch: Scalar, yaw: Scalar) -> Any:
    """R_WB (3, 3) of roll, pitch, yaw (rad), order 3-2-1; defined for every angle."""
    cr, sr, cp, sp, cy, sy = (g(a) for a in (roll, pitch, yaw) for g in (jnp.cos, jnp.sin))
    return jnp.stack(
        [
            jnp.stack([cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy]),
            jnp.stack([cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy]),
            jnp.stack([-sp, sr * cp, cr * cp]),
        ]
    )


def to_euler(R_WB: Any) -> Any:
    """Roll, pitch, yaw (3,) of a rotation (3, 3). At pitch ±90° roll and yaw are not unique: roll is given as 0."""
    pitch = -jnp.arcsin(jnp.clip(R_WB[2, 0], -1, 1))
    singular = jnp.abs(R_WB[2, 0]) > 1 - 1e-12
    roll = jnp.where(singular, 0.0, jnp.arctan2(R_WB[2, 1], R_WB[2, 2]))
    yaw = jnp.where(singular, jnp.arctan2(-R_WB[0, 1], R_WB[1, 1]), jnp.arctan2(R_WB[1, 0], R_WB[0, 0]))
    return jnp.stack([roll, pitch, yaw])


def cross_matrix(v: Any) -> Any:
    """[v ×] (3, 3), so that cross_matrix(v) @ w = v × w."""
    o = jnp.zeros_like(v[0])
    return jnp.stack([jnp.stack([o, -v[2], v[1]]), jnp.stack([v[2], o, -v[0]]), jnp.stack([-v[1], v[0], o])])


def from_rotation_vector(v: Any) -> Any:
    """R (3, 3) that turns by |v| (rad) about v: Rodrigues' formula, with its series near zero."""
    a2 = v @ v
    small = a2 < 1e-8
    a = jnp.sqrt(jnp.where(small, 1.0, a2))
    p = jnp.where(small, 1 - a2 / 6, jnp.sin(a) / a)
    q = jnp.where(small, 0.5 - a2 / 24, (1 - jnp.cos(a)) / (a * a))
    U = cross_matrix(v)
    return jnp.eye(3) + p * U + q * (U @ U)


def quaternion_product(p: Any, q: Any) -> Any:
    """p q (4,): the rotation q followed by p, R(p q) = R(p) R(q)."""
    w = p[0] * q[0] - p[1:] @ q[1:]
    return jnp.concatenate([w[None], p[0] * q[1:] + q[0] * p[1:] + jnp.cross(p[1:], q[1:])])


def quaternion_inverse(q: Any) -> Any:
    """The conjugate (4,) of a unit quaternion."""
    return q * jnp.array([1.0, -1.0, -1.0, -1.0])


def quaternion_from_rotation_vector(v: Any) -> Any:
    """Unit quaternion (4,) that turns by |v| (rad) about v, with its series near zero."""
    a2 = v @ v
    small = a2 < 1e-8
    a = jnp.sqrt(jnp.where(small, 1.0, a2))
    w = jnp.where(small, 1 - a2 / 8, jnp.cos(a / 2))
    return jnp.concatenate([w[None], jnp.where(small, 0.5 - a2 / 48, jnp.sin(a / 2) / a) * v])


def quaternion_to_rotation_vector(q: Any) -> Any:
    """Rotation vector (3,), |v| in [0, pi], of a unit quaternion (4,)."""
    q = jnp.where(q[0] < 0, -q, q)
    s2 = q[1:] @ q[1:]
    small = s2 < 1e-12
    s = jnp.sqrt(jnp.where(small, 1.0, s2))
    return jnp.where(small, 2.0, 2 * jnp.arctan2(s, q[0]) / s) * q[1:]


def quaternion_to_matrix(q: Any) -> Any:
    """R (3, 3) of a unit quaternion (4,)."""
    U = cross_matrix(q[1:])
    return jnp.eye(3) + 2 * q[0] * U + 2 * (U @ U)


def rotate_by_vector(R_WB: Any, turn: Any) -> Any:
    """R_WB (3, 3) after a turn by the vector `turn` (3,), the integral of w_WB_B over the step (rad).

    With v = -turn, E = I + sin|v|/|v| [v×] + (1 - cos|v|)/|v|² [v×]² carries the transpose, R_BW(k) = E R_BW(k-1), so
    R_WB(k) = R_WB(k-1) Eᵀ. Exact while the axis stands still over the step.

    Source: [1] eq. 3.4, corrected (docs page, Errata); [1] Z. Kulis, "Feedback control of a hovercraft over a wireless
    link", University of Maryland, 2006.
    """
    return R_WB @ from_rotation_vector(-turn).T


def orthonormalise(R: Any) -> Any:
    """A nearly orthonormal (3, 3) brought closer, R (3 I - Rᵀ R)/2: the error of Rᵀ R is squared.

    Source: Björck and Bowie, SIAM J. Numer. Anal. 8 (1971), one iteration.
    """
    return R @ (3 * jnp.eye(3) - R.T @ R) / 2


def is_vertical(R_WB: Any, margin: float = 0.01) -> Any:
    """Whether pitch is within `margin` (rad) of ±90°, where roll and yaw are not told apart: a flag."""
    return R_WB[0, 0] ** 2 + R_WB[1, 0] ** 2 < np.sin(margin) ** 2


def euler_rates(roll: Scalar, pitch: Scalar, w_WB_B: Any, margin: float = 0.01) -> tuple[Any, Any]:
    """Rates of roll, pitch, yaw (3,) (rad/s) at an angular velocity (3,), and whether they are singular (a flag).

    Within `margin` (rad) of pitch ±90° the rates of roll and yaw grow without bound: there they are held at the value
    that they have at the margin, finite, and flagged.

    Source: Stevens, Lewis, Johnson, "Aircraft control and simulation", eq. 1.4-4.
    """
    sr, cr, cp = jnp.sin(roll), jnp.cos(roll), jnp.cos(pitch)
    limit = np.sin(margin)
    singular = jnp.abs(cp) < limit
    divisor = jnp.where(singular, jnp.where(cp < 0, -limit, limit), cp)
    yaw_rate = (sr * w_WB_B[1] + cr * w_WB_B[2]) / divisor
    pitch_rate = cr * w_WB_B[1] - sr * w_WB_B[2]
    return jnp.stack([w_WB_B[0] + jnp.sin(pitch) * yaw_rate, pitch_rate, yaw_rate]), singular


def normalise_quaternion(q: Any) -> Any:
    """A quaternion (4,) scaled to unit length; (1, 0, 0, 0) where it is zero."""
    n2 = q @ q
    alive = n2 > 0
    return jnp.where(alive, q / jnp.sqrt(jnp.where(alive, n2, 1.0)), jnp.array([1.0, 0.0, 0.0, 0.0]))


def rotate_quaternion_by_vector(q_WB: Any, turn: Any) -> Any:
    """q_WB (4,) after a turn by the vector `turn` (3,), the integral of w_WB_B over the step (rad); unit length."""
    return normalise_quaternion(quaternion_product(q_WB, quaternion_from_rotation_vector(turn)))


def quaternion_from_euler(roll: Scalar, pitch: Scalar, yaw: Scalar) -> Any:
    """Unit quaternion q_WB (4,) of roll, pitch, yaw (rad), order 3-2-1; defined for every angle."""
    cr, sr, cp, sp, cy, sy = (g(a / 2) for a in (roll, pitch, yaw) for g in (jnp.cos, jnp.sin))
    return jnp.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def quaternion_from_matrix(R: Any) -> Any:
    """Unit quaternion (4,), w >= 0, of a rotation (3, 3).

    Source: Shepperd, J. Guidance and Control 1 (1978): the largest of four squares is divided by, so never by zero.
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    d = [1 + 2 * R[i, i] - trace for i in range(3)]
    q = jnp.stack([1 + trace, x, y, z])
    largest = 1 + trace
    for i, row in enumerate(([x, d[0], xy, xz], [y, xy, d[1], yz], [z, xz, yz, d[2]])):
        better = d[i] > largest
        q = jnp.where(better, jnp.stack(row), q)
        largest = jnp.where(better, d[i], largest)
    q = q / (2 * jnp.sqrt(largest))
    return jnp.where(q[0] < 0, -q, q)


def rotate_vector(q_WB: Any, v_B: Any) -> Any:
    """v_W (3,) = R(q_WB) v_B, without making the matrix; q unit."""
    t = 2 * jnp.cross(q_WB[1:], v_B)
    return v_B + q_WB[0] * t + jnp.cross(q_WB[1:], t)
