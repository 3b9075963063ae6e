"""A single ultrasonic range as a function of place: value, slope and curvature, cone error included.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
5.5.4; Jazwinski, "Stochastic processes and filtering theory", 1970, section 9.3, for the use of the curvature.
"""

from typing import Any, NamedTuple

from trimtab.core.float64 import jnp
from trimtab.environment.ultrasonic_cone import LINEAR, QUADRATIC, range_ratio


class Predicted(NamedTuple):
    """A range as measured (m), its derivative by north and east (2,), and the second derivative (2, 2) in 1/m."""

    range: Any
    slope: Any
    curvature: Any


def predicted(beacon: Any, place: Any, down: Any, *, cone: bool) -> Predicted:
    """What a unit measures to a beacon, without noise.

        d / e(beta),  tan beta = |p - q| / h,  e = 1 without cone error

    The measured range is modelled rather than the measurement compensated: noise belongs to what was measured, and a
    range that noise made shorter than the height has a model but no compensation. The curvature is that of d.

    Args:
        beacon: north, east, down in W (3,).
        place: of the unit, north and east (2,).
        down: of the unit, in W.
        cone: whether ranges are too long off the axis.
    """
    away, height = place - beacon[:2], down - beacon[2]
    square = away @ away
    distance = jnp.sqrt(square + height * height)
    distance = jnp.where(distance > 0, distance, 1.0)
    g = away / distance
    curvature = (jnp.eye(2) - g[:, None] * g[None, :]) / distance
    if not cone:
        return Predicted(distance, g, curvature)
    aside = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    aside = jnp.where(square > 0, aside, 0.0)
    beta = jnp.arctan2(aside, height)
    e, rises = range_ratio(beta), 2 * QUADRATIC * beta + LINEAR
    direction = away / jnp.where(aside > 0, aside, 1.0)
    slope = g / e - direction * (rises * height / (e * e * distance))
    return Predicted(distance / e, slope, curvature)
