"""Heading from a measured magnetic field: flight code, used by whoever holds a magnetometer's sample.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
eqs. 3.43-3.44, with the arc cosine replaced (docs page, Errata).
"""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.core.rotation import from_euler


def levelled(field_B: Any, roll: Any, pitch: Any) -> Any:
    """A field (3,) in the body, turned by roll and pitch (rad) into the level frame that has the body's heading."""
    return from_euler(roll, pitch, jnp.zeros_like(pitch)) @ field_B


def magnetic_heading(field_B: Any, field_W: Any, roll: Any = 0.0, pitch: Any = 0.0) -> Any:
    """True heading (rad, in [-pi, pi]) from the measured field (3,) in B and the known field (3,) in north-east-down.

    Both are projected on the horizontal plane; the heading is the angle from the measured to the known projection,

        psi = atan2((b × w)_z, b · w),

    which is exact at every angle, where an arc cosine of b · w loses half its digits near 0 and pi. Where a projection
    vanishes (a magnetic pole, a dead sensor) it is 0: look at `strength_ratio`.
    """
    b, w = levelled(field_B, jnp.asarray(roll), jnp.asarray(pitch)), field_W
    return jnp.arctan2(b[0] * w[1] - b[1] * w[0], b[0] * w[0] + b[1] * w[1])


def strength_ratio(field_B: Any, field_W: Any) -> Any:
    """Strength of the measured field over the known one: not 1 beside a motor or over steel, 0 for a dead sensor."""
    return jnp.sqrt((field_B @ field_B) / (field_W @ field_W))
