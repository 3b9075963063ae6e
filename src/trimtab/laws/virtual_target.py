"""Path following of a car at constant speed: the car steers towards a virtual target that moves along the path.

[1] is A. Micaelli, C. Samson, "Trajectory tracking for unicycle-type and two-steering-wheels mobile robots", INRIA
report 2097, 1993.
[2] is D. Soetanto, L. Lapierre, A. Pascoal, "Adaptive, non-singular path-following control of dynamic wheeled robots",
42nd IEEE Conference on Decision and Control, 2003, 1765-1770.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, part, quantity, record, tree_where
from trimtab.core.reference import Circle
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.vehicles.dubins_car import CarTurn, DubinsCar

SLOW = 0.05
"""Minimum speed (m/s) along a path. A lower speed of the path is raised to this value, so that the target moves."""
REST = 1e-12
"""Speed (m/s) along a path below which the path counts as at rest and has no direction."""
BEGIN = 0.02
"""Path parameter (s) at which the target starts."""
STEP = 0.02
"""Interval (s) of the path parameter at which the path's curvature is checked before a run."""


@record
class VirtualTargetState:
    """State of the law `VirtualTarget`: progress of the target along the path. Source: [2]."""

    progress: Scalar = quantity(
        "s",
        "Path parameter of the target: time argument of the path. It is negative before the path's beginning.",
        default=0.0,
    )
    tangent: Scalar = quantity("rad", "Direction of the path at the target.", kind="angle", frame="W", default=0.0)


@record
class VirtualTargetOutput:
    """Demand and signals of the law `VirtualTarget`. Source: [2]."""

    demand: CarTurn = part("Demanded turn rate.")
    cross_track: Scalar = quantity("m", "Cross-track error: distance of the car to the right of the target.")
    along_track: Scalar = quantity("m", "Along-track error: distance of the car ahead of the target.")
    heading_error: Scalar = quantity(
        "rad", "Heading error: heading minus the path's direction, wrapped to ±pi.", kind="angle"
    )
    lyapunov: Scalar = quantity("m^2", "Lyapunov function V of the law.")
    saturated: Scalar = quantity("1", "True if the law demands a tighter turn than the car can make.", kind="flag")
    north_reference: Scalar = quantity("m", "North coordinate of the target.", frame="W")
    east_reference: Scalar = quantity("m", "East coordinate of the target.", frame="W")
    progress: Scalar = quantity("s", "Path parameter of the target: time argument of the path.")


class _Tangent(NamedTuple):
    """Path at the target: position (2,) (m), heading (rad), curvature (1/m), pace (m/s), True if the path is at
    rest."""

    place: Any
    heading: Any
    curvature: Any
    pace: Any
    rests: Any


@record
class VirtualTarget:
    """Law that follows a path in position, not in time: a virtual target moves along the path with the car's progress.

        s' = V cos q + k1 a                                  speed of the target
        r = kappa s' - g e V sin(q)/q - k2 q                 turn rate of the car

    a and e: distances of the car ahead of the target and to the right of it, in the direction of the path; q: the car's
    heading minus the path's direction; kappa: the path's curvature, positive to the right.

    Stable: V = (a^2 + e^2)/2 + q^2/(2 g) has V' = -k1 a^2 - k2 q^2/g for any path and any start, while the turn rate is
    not limited. On a straight path, linearised: e'' + k2 e' + g V^2 e = 0.

    Frames:  W; angles clockwise.    Valid: paths with bends wider than the car's minimum turn radius, as
             `check_duration` checks.
    Source:  [2], without its approach angle; the turn rate is that of [1], where the target is the nearest point.
    """

    reads: ClassVar[tuple[str, ...]] = ("north", "east", "heading")

    reference: Any = part("Path that the car follows.", default=Circle(ease=0.0))
    craft: DubinsCar = part("Model of the car used by the law.", default=DubinsCar())
    k1: Scalar = quantity("1/s", "Gain k1: rate at which the along-track error decays.", default=2.0, above=0)
    k2: Scalar = quantity("1/s", "Gain k2: turn rate per heading error.", default=2.5, above=0)
    g: Scalar = quantity("1/m^2", "Gain g: turn rate per cross-track error and speed.", default=2.5, above=0)

    def check_duration(self, seconds: float) -> None:
        """Raise InputError if the path bends more tightly than the car can within a run of this length."""
        t = np.arange(0.0, seconds + STEP, STEP)
        bend = np.abs(np.asarray(jax.vmap(lambda t: self._tangent(t, 0.0).curvature)(t)))
        k = int(bend.argmax())
        if bend[k] * float(self.craft.radius) > 1 + 1e-9:
            problem = (
                f"the car cannot follow the path: its radius at {t[k]:.1f} s is {1 / bend[k]:.2f} m,"
                f" and the car's minimum turn radius is {float(self.craft.radius):g} m"
            )
            fix = f"give a path with wider bends, e.g. {argument('reference', 'circle(radius=2, period=13 s)')}"
            raise InputError("reference", problem, fix=fix)

    def init(self, key: Any) -> VirtualTargetState:
        """Return the initial state, with the target at the beginning of the path."""
        return VirtualTargetState(progress=BEGIN)

    def step(
        self, t: Any, state: VirtualTargetState, estimate: Estimate
    ) -> tuple[VirtualTargetState, VirtualTargetOutput]:
        """Return the demanded turn rate at time t (unit: 100 ns). The target rests while the estimate is not valid."""
        x, V = estimate.state, self.craft.speed
        target = self._tangent(state.progress, state.tangent)
        c, s = jnp.cos(target.heading), jnp.sin(target.heading)
        north, east = x.north - target.place[0], x.east - target.place[1]
        ahead, across, q = c * north + s * east, c * east - s * north, wrap(x.heading - target.heading)
        along = jnp.where(target.rests, 0.0, ahead)
        run = jnp.where(target.rests, V, V * jnp.cos(q) + self.k1 * along)
        wanted = target.curvature * run - self.g * across * V * _sine_ratio(q) - self.k2 * q
        turn = self.craft.limit(wanted)
        output = VirtualTargetOutput(
            demand=CarTurn(turn),
            cross_track=across,
            along_track=along,
            heading_error=q,
            lyapunov=(along**2 + across**2) / 2 + q**2 / (2 * self.g),
            saturated=turn != wanted,
            north_reference=target.place[0] + (ahead - along) * c,
            east_reference=target.place[1] + (ahead - along) * s,
            progress=state.progress,
        )
        new = VirtualTargetState(state.progress + estimate.dt * run / target.pace, target.heading)
        return tree_where(estimate.valid, new, state), output

    def _tangent(self, progress: Any, heading: Any) -> _Tangent:
        """Return the path at a path parameter (s). heading: direction (rad) to use where the path is at rest.

        Before its beginning the path is extended in a straight line. The path is evaluated from `BEGIN` on, where a
        path that starts from rest has a direction.
        """
        at = jnp.maximum(progress, BEGIN)
        point = self.reference.at(at)
        v, a = point.velocity, point.acceleration
        pace = jnp.sqrt(v[0] ** 2 + v[1] ** 2)
        rests = pace < REST
        heading = jnp.where(rests, heading, jnp.arctan2(v[1], v[0]))
        bend = jnp.where(progress < BEGIN, 0.0, (v[0] * a[1] - v[1] * a[0]) / jnp.maximum(pace, SLOW) ** 3)
        pace = jnp.maximum(pace, SLOW)
        before = pace * (progress - at)
        place = point.place + before * jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return _Tangent(place, heading, bend, pace, rests)


def _sine_ratio(q: Any) -> Any:
    """Return sin(q)/q for q (rad); 1 where q is zero."""
    small = jnp.abs(q) < 1e-4
    return jnp.where(small, 1 - q**2 / 6, jnp.sin(q) / jnp.where(small, 1.0, q))
