"""Rudder: the servo's pulse width, the rudder angle, and the direction of the resulting force.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import DEG

_HORN = 72 * DEG
_ANGLES = 35 * DEG * np.sin(_HORN * np.linspace(-1.0, 1.0, 21)) / np.sin(_HORN)


@record
class RudderGeometry:
    """Relation between the rudder angle and the direction of the force.

        theta = -ratio psi + offset        [1, eq. 4.3]
        FX = f cos psi    FY = -f sin psi  [1, chapter 4]

    Frames:  theta (rudder) and psi (force) are measured from the body's x axis; f is signed, negative in reverse.
    Source:  [1] eq. 4.3.
    """

    ratio: Scalar = quantity("1", "Ratio of rudder angle to force angle.", default=1.40, above=0, source="[1] eq. 4.3")
    offset: Scalar = quantity(
        "rad",
        "Rudder angle at which the force points along the body's x axis.",
        default=0.566 * DEG,
        source="[1] eq. 4.3",
    )

    def rudder_angle(self, force_angle: Any) -> Any:
        """Return the rudder angle theta (rad) that turns the force by psi (rad)."""
        return self.offset - self.ratio * force_angle

    def force_angle(self, rudder_angle: Any) -> Any:
        """Return the force angle psi (rad) of a rudder at theta (rad)."""
        return (self.offset - rudder_angle) / self.ratio


@record
class RudderServo:
    """Rudder servo: conversion between pulse width and rudder angle, by a measured table of 21 points.

    The conversion is linear between the points. Beyond the ends of the table the last segment is extended, so the
    conversion has an inverse. `limit_angle` applies the stops.

    Frames:  angle theta from the body's x axis.    Not modelled: slew rate, backlash, load.
    Source:  [1] figure 4.2 (21 points, 1.00 to 2.00 ms, linear interpolation). [1] has a plot only; the values are
             reconstructed as 35 deg sin(72 deg x)/sin(72 deg), x = (pulse - 1.5 ms)/0.5 ms: docs page, Errata.
    """

    angles: Any = quantity(
        "rad", "Rudder angle at each pulse width.", default=_ANGLES, kind="angle", shape=(21,), source="[1] fig. 4.2"
    )
    pulse_start: Scalar = quantity("s", "Pulse width of the table's first point.", default=1.0e-3, above=0)
    pulse_step: Scalar = quantity("s", "Step of the pulse width between the table's points.", default=50e-6, above=0)
    neutral_pulse: Scalar = quantity("s", "Neutral pulse width, sent without a command.", default=1.5e-3, above=0)
    angle_min: Scalar = quantity("rad", "Rudder angle at the lower stop, from plots in [1].", default=-35 * DEG)
    angle_max: Scalar = quantity("rad", "Rudder angle at the upper stop, from plots in [1].", default=30 * DEG)

    def check(self) -> None:
        """Raise InputError for a table that cannot be inverted, and for stops beyond the table."""
        angles = np.asarray(self.angles)
        if not (np.diff(angles) > 0).all():
            k = int(np.argmin(np.diff(angles)))
            problem = (
                f"the angles must increase with the pulse width, got angles[{k}]={angles[k]:.6g}, "
                f"angles[{k + 1}]={angles[k + 1]:.6g}"
            )
            raise InputError("angles", problem, fix="sort the points and remove repeated points")
        low, high = float(self.angle_min), float(self.angle_max)
        if not angles[0] - 1e-9 <= low < high <= angles[-1] + 1e-9:
            problem = f"the stops {low:.6g} and {high:.6g} rad must increase and lie within the table, "
            problem += f"{angles[0]:.6g} to {angles[-1]:.6g} rad"
            raise InputError("angle_min, angle_max", problem, fix="move the stops or measure a wider table")

    def angle(self, pulse: Any) -> Any:
        """Return the rudder angle (rad) at a scalar pulse width (s). Use vmap for arrays."""
        position = (pulse - self.pulse_start) / self.pulse_step
        index = jnp.clip(jnp.floor(position), 0, len(self.angles) - 2)
        a, b = _pair(self.angles, index)
        return a + (position - index) * (b - a)

    def pulse(self, angle: Any) -> Any:
        """Return the pulse width (s) at a scalar rudder angle (rad), the inverse of `angle`. Use vmap for arrays."""
        index = jnp.sum(angle >= jnp.asarray(self.angles)[1:-1])
        a, b = _pair(self.angles, index)
        return self.pulse_start + self.pulse_step * (index + (angle - a) / (b - a))

    def limit_angle(self, angle: Any) -> Any:
        """Return the angle (rad) limited to the stops."""
        return jnp.clip(angle, self.angle_min, self.angle_max)

    def is_at_stop(self, angle: Any) -> Any:
        """Return True if a rudder angle (rad) is within 1e-6 rad of a stop, or beyond."""
        return (angle <= self.angle_min + 1e-6) | (angle >= self.angle_max - 1e-6)


def _pair(table: Any, index: Any) -> tuple[Any, Any]:
    two = lax.dynamic_slice(table, (index.astype(np.uint32),), (2,))
    return two[0], two[1]
