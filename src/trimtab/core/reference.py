"""References for a vehicle in the plane: circle, figure eight, and polynomials through positions.

A reference fits `core.interfaces.Reference`: `at(t)` returns the reference position and four derivatives. An
underactuated vehicle needs four derivatives, because its heading determines the direction of its thrust: the second
derivative determines the heading, the fourth the torque. References are pure functions and compile to C, so a law can
contain one in flight. Their time t (s) is 0 when the law starts. A reference does not depend on the vehicle that
follows it.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, quantity, record

DEGREE = 5
"""Degree of the polynomials. Position and four derivatives are continuous where two polynomials meet."""
REST_FACTOR = 1.875
"""Ratio of maximum to mean speed in a move from rest to rest by a polynomial of degree 5."""


@record
class ReferencePoint:
    """Point of a reference at one instant. Frames: W, (north, east). Source: docs page, References."""

    place: Any = quantity("m", "Reference position: north, east.", frame="W", shape=(2,))
    velocity: Any = quantity("m/s", "Reference velocity: first time derivative of the position.", frame="W", shape=(2,))
    acceleration: Any = quantity(
        "m/s^2", "Reference acceleration: second time derivative of the position.", frame="W", shape=(2,)
    )
    jerk: Any = quantity("m/s^3", "Reference jerk: third time derivative of the position.", frame="W", shape=(2,))
    snap: Any = quantity("m/s^4", "Reference snap: fourth time derivative of the position.", frame="W", shape=(2,))
    heading: Scalar = quantity(
        "rad", "Reference heading, for a vehicle whose motion does not determine the heading.", kind="angle", frame="W"
    )
    has_heading: Scalar = quantity("1", "True if the reference gives a heading.", kind="flag")


def retime(point: ReferencePoint, rates: tuple[Any, Any, Any, Any]) -> ReferencePoint:
    """Return the point of a reference as a function of time, by the chain rule, from a point as a function of theta.

    Args:
        point: point of the reference at theta.
        rates: first to fourth time derivative of theta.
    """
    a, b, c, d = rates
    p1, p2, p3, p4 = point.velocity, point.acceleration, point.jerk, point.snap
    return ReferencePoint(
        place=point.place,
        velocity=p1 * a,
        acceleration=p2 * a**2 + p1 * b,
        jerk=p3 * a**3 + 3 * p2 * a * b + p1 * c,
        snap=p4 * a**4 + 6 * p3 * a**2 * b + p2 * (3 * b**2 + 4 * a * c) + p1 * d,
        heading=point.heading,
        has_heading=point.has_heading,
    )


def _ease_in(t: Any, ease: Any) -> tuple[Any, tuple[Any, Any, Any, Any]]:
    """Return the parameter theta of a reference that starts from rest, and theta's derivatives. The rate of theta rises
    to 1 in `ease` (s).

    The rate is the polynomial of degree 7 whose first three derivatives vanish at both ends.
    """
    eased = ease > 0
    span = jnp.where(eased, ease, 1.0)
    x = jnp.where(eased, jnp.clip(t / span, 0.0, 1.0), 1.0)
    theta = span * x**5 * (7 + x * (-14 + x * (10 - 2.5 * x))) + jnp.maximum(t - span, 0.0)
    theta = jnp.where(eased, theta, t)
    rate = x**4 * (35 + x * (-84 + x * (70 - 20 * x)))
    slope = 140 * x**3 * (1 - x) ** 3 / span
    bend = 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x) / span**2
    last = 840 * x * (1 - x) * (1 - 5 * x + 5 * x**2) / span**3
    return theta, (rate, slope, bend, last)


def _harmonic_point(centre: Any, terms: Any, phase: Any, w: Any) -> ReferencePoint:
    """Return the point centre + sum of u sin(k phase + shift) over the terms (k, shift, u), with phase' = w."""
    derivatives = [centre, 0.0, 0.0, 0.0, 0.0]
    for k, shift, u in terms:
        s, c = jnp.sin(k * phase + shift), jnp.cos(k * phase + shift)
        for order, value in enumerate((s, c, -s, -c, s)):
            derivatives[order] = derivatives[order] + u * (value * (k * w) ** order)
    return ReferencePoint(*derivatives, heading=jnp.asarray(0.0), has_heading=jnp.asarray(False))


@record
class Circle:
    """A circle at constant speed, after a start from rest.

    Frames:  W; angles clockwise from north, seen from the centre.    Source:  elementary.
    """

    radius: Scalar = quantity("m", "Radius of the circle.", default=1.5, above=0)
    period: Scalar = quantity("s", "Time of one round at full speed.", default=20.0, above=0)
    north: Scalar = quantity("m", "North coordinate of the centre.", frame="W", default=0.0)
    east: Scalar = quantity("m", "East coordinate of the centre.", frame="W", default=0.0)
    start: Scalar = quantity("rad", "Angle on the circle at the start.", kind="angle", default=0.0)
    ease: Scalar = quantity("s", "Time from rest to full speed at the start.", default=8.0, low=0)
    clockwise: bool = option(
        "Direction of motion: True for clockwise, False for counter-clockwise.", default=True, choices=(True, False)
    )

    def at(self, t: Any) -> ReferencePoint:
        """Return the point of the reference at t (s)."""
        theta, rates = _ease_in(t, self.ease)
        w = 2 * np.pi / self.period * (1 if self.clockwise else -1)
        north, east = self.radius * np.array([1.0, 0.0]), self.radius * np.array([0.0, 1.0])
        phase = self.start + w * theta
        centre = jnp.stack([self.north, self.east])
        return retime(_harmonic_point(centre, ((1, np.pi / 2, north), (1, 0.0, east)), phase, w), rates)


@record
class FigureEight:
    """A figure eight, which passes its centre twice a period, after a start from rest at a tip.

        along = (length/2) cos(phase)      across = -(width/2) (sin(2 phase) + sin(4 phase)/40)

    The acceleration vanishes at the crossing and changes sign there. Because of the last term, the direction of the
    acceleration is constant at the crossing (direction' and direction'' are zero). So a vehicle that thrusts along the
    acceleration needs no torque there. The last term changes the width by 0.2 %.

    Frames:  W; `axis` clockwise from north; across is 90 degrees clockwise of it.    Source:  own derivation.
    """

    length: Scalar = quantity("m", "Length of the figure eight from tip to tip.", default=5.0, above=0)
    width: Scalar = quantity("m", "Width of the loops of the figure eight.", default=1.5, above=0)
    period: Scalar = quantity("s", "Time of one figure eight at full speed.", default=30.0, above=0)
    north: Scalar = quantity("m", "North coordinate of the centre.", frame="W", default=0.0)
    east: Scalar = quantity("m", "East coordinate of the centre.", frame="W", default=0.0)
    axis: Scalar = quantity("rad", "Direction of the tip at which the figure eight begins.", kind="angle", default=0.0)
    ease: Scalar = quantity("s", "Time from rest to full speed at the start.", default=8.0, low=0)

    def at(self, t: Any) -> ReferencePoint:
        """Return the point of the reference at t (s)."""
        theta, rates = _ease_in(t, self.ease)
        w = 2 * np.pi / self.period
        c, s = jnp.cos(self.axis), jnp.sin(self.axis)
        along, across = jnp.stack([c, s]) * self.length / 2, jnp.stack([-s, c]) * self.width / 2
        terms = ((1, 0.0, along), (2, 0.0, across), (4, 0.0, -across / 40))
        centre = jnp.stack([self.north, self.east])
        return retime(_harmonic_point(centre, terms, np.pi / 2 + w * theta, w), rates)


@record
class PiecewisePath:
    """A path of consecutive polynomials of degree 5, as created by `interpolate_path` and `pass_waypoints`.

    Piece k is valid from times[k] to times[k + 1]. In this piece, north, east and heading are the sum over i of
    coefficients[k, i] (t - times[k])^i. Before the first time, the path rests at its first point; after the last time,
    at its last point.

    Frames:  W.    Source:  C. de Boor, "A practical guide to splines", 1978.
    """

    times: Any = quantity(
        "s", "Start times of the pieces, and end time of the last piece, in rising order.", default=np.array([0.0, 1.0])
    )
    coefficients: Any = quantity(
        "m, rad",
        "Coefficients of each piece, lowest power first (pieces, 6, 3).",
        frame="W",
        default=np.zeros((1, DEGREE + 1, 3)),
    )
    has_heading: Scalar = quantity("1", "True if the path gives a heading.", kind="flag", default=False)

    def check(self) -> None:
        """Raise InputError if the path is not valid."""
        times, shape = np.asarray(self.times, np.float64), np.shape(self.coefficients)
        if times.ndim != 1 or shape != (len(times) - 1, DEGREE + 1, 3) or not (np.diff(times) > 0).all():
            problem = (
                "times must increase, with one time more than there are pieces in coefficients,"
                f" got {np.size(times)} times and coefficients of shape {shape}"
            )
            fix = "create the path with core.reference.interpolate_path or pass_waypoints"
            raise InputError("PiecewisePath.times", problem, fix=fix)

    def at(self, t: Any) -> ReferencePoint:
        """Return the point of the reference at t (s)."""
        times = jnp.asarray(self.times)
        piece = jnp.sum(t >= times[1:-1], dtype=np.int32)
        first = jnp.int32(0)
        c = lax.dynamic_slice(jnp.asarray(self.coefficients), (piece, first, first), (1, DEGREE + 1, 3))[0]
        begin = lax.dynamic_slice(times, (piece,), (1,))[0]
        x = jnp.clip(t, times[0], times[-1]) - begin
        values, moves = [], (t >= times[0]) & (t < times[-1])
        for order in range(5):
            value = jnp.zeros(3)
            for i in range(DEGREE, order - 1, -1):
                value = value * x + c[i] * float(np.prod(np.arange(i - order + 1, i + 1)))
            values.append(value if order == 0 else jnp.where(moves, value, 0.0))
        return ReferencePoint(*(v[:2] for v in values), heading=values[0][2], has_heading=self.has_heading)


def interpolate_path(times: Any, places: Any, headings: Any = None, *, rests: bool = False) -> PiecewisePath:
    """Return the spline of degree 5 through positions at times.

    Args:
        times: times (s) in rising order (n,), at least six, or two if the path rests at its ends.
        places: positions (m), north and east in W (n, 2).
        headings: headings (rad), unwrapped (n,), or None.
        rests: True if velocity and acceleration vanish at both ends.

    Raises:
        InputError: if there are too few positions, or the times do not increase.
    """
    from scipy.interpolate import make_interp_spline  # imported here: only used before a run

    t, x = np.asarray(times, np.float64), np.asarray(places, np.float64)
    fewest = 2 if rests else DEGREE + 1
    if t.ndim != 1 or x.shape != (len(t), 2) or len(t) < fewest or not (np.diff(t) > 0).all():
        problem = f"{np.size(t)} times and {len(x)} positions do not determine a smooth path"
        fix = f"give at least {fewest} positions, each with a time, in rising order of time"
        raise InputError("path", problem, fix=fix)
    angles = np.zeros(len(t)) if headings is None else np.asarray(headings, np.float64)
    still: Any = [(1, np.zeros(3)), (2, np.zeros(3))]
    ends = (still, still) if rests else None
    spline: Any = make_interp_spline(t, np.column_stack([x, angles]), k=DEGREE, bc_type=ends)
    knots = np.unique(spline.t)
    pieces = [spline(knots[:-1], i) / math.factorial(i) for i in range(DEGREE + 1)]
    return PiecewisePath(knots, np.stack(pieces, axis=1), headings is not None)


def pass_waypoints(places: Any, speeds: Any) -> PiecewisePath:
    """Return a smooth path through positions that begins and ends at rest.

    Args:
        places: positions (m), north and east in W (n, 2).
        speeds: mean speed (m/s) of each leg (n - 1,), or one speed for all legs. The first and the last leg take
            longer, because they begin or end at rest.

    Raises:
        InputError: if there are fewer than two positions, two consecutive positions are equal, or a speed is not above
            0.
    """
    x = np.asarray(places, np.float64)
    if x.ndim != 2 or x.shape[1] != 2 or len(x) < 2:
        raise InputError("waypoints", "a path needs at least two way-points", fix="write e.g. waypoints(0 0, 3 0, 3 3)")
    legs = np.hypot(*np.diff(x, axis=0).T)
    v = np.broadcast_to(np.asarray(speeds, np.float64), legs.shape)
    if not (legs > 0).all():
        k = int(np.argmin(legs))
        problem = f"way-points {k + 1} and {k + 2} are the same position, {x[k, 0]:g} {x[k, 1]:g}"
        raise InputError("waypoints", problem, fix="remove one of the two way-points")
    if not (v > 0).all():
        raise InputError(
            "waypoints", f"a speed must be above 0, got {v.min():g} m/s", fix="give a positive speed, e.g. speed=0.4"
        )
    factor = np.ones(len(legs))
    factor[0], factor[-1] = (REST_FACTOR + 1) / 2, (REST_FACTOR + 1) / 2
    if len(legs) == 1:
        factor[0] = REST_FACTOR
    return interpolate_path(np.append(0.0, np.cumsum(factor * legs / v)), x, rests=True)
