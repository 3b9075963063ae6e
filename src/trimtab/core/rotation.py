"""Rotations in the plane and in space.

Conventions: right-handed frames, z down; R_WB transforms body components to world components, v_W = R_WB v_B. Euler
angles are roll, pitch, yaw about x, y, z in the order yaw, pitch, roll (3-2-1).

Source: Diebel, "Representing attitude", Stanford 2006; Stevens, Lewis, Johnson, "Aircraft control and simulation", 1.3.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar

DEG = np.pi / 180
"""One degree (rad)."""

STEEP = 0.99
"""Sine of the pitch above which a rotation counts as near the vertical."""


def wrap(angle: Scalar) -> Scalar:
    """Return an angle (rad) wrapped to [-pi, pi)."""
    return angle - 2 * np.pi * jnp.floor((angle + np.pi) / (2 * np.pi))


def wrap_positive(angle: Scalar) -> Scalar:
    """Return an angle (rad) wrapped to [0, 2 pi)."""
    wrapped = angle - 2 * np.pi * jnp.floor(angle / (2 * np.pi))
    return jnp.where(wrapped < 2 * np.pi, wrapped, 0.0)  # a tiny negative angle rounds up to a full turn


def planar(heading: Scalar) -> Any:
    """Return R_WB (2, 2) of a heading (rad): body to world components in the horizontal plane."""
    c, s = jnp.cos(heading), jnp.sin(heading)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def from_euler(roll: Scalar, pitch: Scalar, yaw: Scalar) -> Any:
    """Return R_WB (3, 3) of roll, pitch, yaw (rad), order 3-2-1; defined for every angle."""
    cr, sr, cp, sp, cy, sy = (g(a) for a in (roll, pitch, yaw) for g in (jnp.cos, jnp.sin))
    return jnp.stack(
        [
            jnp.stack([cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy]),
            jnp.stack([cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy]),
            jnp.stack([-sp, sr * cp, cr * cp]),
        ]
    )


def to_euler(R_WB: Any) -> Any:
    """Return roll, pitch, yaw (3,) (rad) of a rotation (3, 3).

    Near the vertical, pitch and yaw are computed after removing the roll, so that the three angles reproduce the
    rotation in any precision. At pitch ±90° roll and yaw are not unique: only their sum or difference is.
    """
    steep = jnp.abs(R_WB[2, 0]) > STEEP
    roll = jnp.arctan2(R_WB[2, 1], R_WB[2, 2])
    c, s = jnp.cos(roll), jnp.sin(roll)
    near = jnp.arctan2(-R_WB[2, 0], c * R_WB[2, 2] + s * R_WB[2, 1])
    pitch = jnp.where(steep, near, -jnp.arcsin(jnp.clip(R_WB[2, 0], -1, 1)))
    turned = jnp.arctan2(s * R_WB[0, 2] - c * R_WB[0, 1], c * R_WB[1, 1] - s * R_WB[1, 2])
    yaw = jnp.where(steep, turned, jnp.arctan2(R_WB[1, 0], R_WB[0, 0]))
    return jnp.stack([roll, pitch, yaw])


def cross_matrix(v: Any) -> Any:
    """Return [v ×] (3, 3), so that cross_matrix(v) @ w = v × w."""
    o = jnp.zeros_like(v[0])
    return jnp.stack([jnp.stack([o, -v[2], v[1]]), jnp.stack([v[2], o, -v[0]]), jnp.stack([-v[1], v[0], o])])


def from_rotation_vector(v: Any) -> Any:
    """Return R (3, 3) that rotates by |v| (rad) about v: Rodrigues' formula, or its series near zero."""
    a2 = v @ v
    small = a2 < 1e-8
    a = jnp.sqrt(jnp.where(small, 1.0, a2))
    p = jnp.where(small, 1 - a2 / 6, jnp.sin(a) / a)
    q = jnp.where(small, 0.5 - a2 / 24, (1 - jnp.cos(a)) / (a * a))
    U = cross_matrix(v)
    return jnp.eye(3) + p * U + q * (U @ U)


def rotate_by_vector(R_WB: Any, turn: Any) -> Any:
    """Return R_WB (3, 3) after a step with the rotation vector `turn` (3,), the integral of w_WB_B over the step (rad).

    With v = -turn, E = I + sin|v|/|v| [v×] + (1 - cos|v|)/|v|² [v×]² advances the transpose, R_BW(k) = E R_BW(k-1), so
    that R_WB(k) = R_WB(k-1) Eᵀ. The result is exact if the axis of rotation is constant over the step.

    Source: [1] eq. 3.4, corrected (docs page, Errata); [1] Z. Kulis, "Feedback control of a hovercraft over a wireless
    link", University of Maryland, 2006.
    """
    return R_WB @ from_rotation_vector(-turn).T
