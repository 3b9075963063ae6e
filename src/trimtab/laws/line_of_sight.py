"""Path following by line of sight with integral action against currents, for vessels that cannot move sideways.

[1] is E. Børhaug, A. Pavlov, K. Y. Pettersen, "Integral LOS control for path following of underactuated marine surface
vessels in the presence of constant ocean currents", 47th IEEE Conference on Decision and Control, 2008, 4984-4991.
[2] is T. I. Fossen, M. Breivik, R. Skjetne, "Line-of-sight path following of underactuated marine craft", IFAC
Proceedings 36 (2003) 211-216.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record, tree_where
from trimtab.core.reference import Circle
from trimtab.core.signals import Estimate
from trimtab.laws.steering import Steering, SteeringState
from trimtab.vehicles.surface_vessel import VesselControls

SLOW = 0.05
"""Lower bound (m/s) of the speed of the path's point, by which the vessel's speed along the path is divided."""


@record
class LineOfSightState:
    """State of the law `LineOfSight`: path parameter, path direction, integrals, autopilot. Source: [1], [2]."""

    progress: Scalar = quantity(
        "s", "Path parameter theta of the path's point, which moves with the vessel: time argument of the path."
    )
    tangent: Scalar = quantity("rad", "Direction chi of the path at the path's point.", kind="angle", frame="W")
    integral: Scalar = quantity("m", "Integral of the cross-track error, as in [1].")
    speed_integral: Scalar = quantity("m", "Integral of the speed error.")
    steering: SteeringState = part("State of the heading autopilot.")


@record
class LineOfSightOutput:
    """Demand and signals of the law `LineOfSight`. Source: [1], [2]."""

    demand: VesselControls = part("Demanded rudder angle and shaft speeds.")
    cross_track: Scalar = quantity("m", "Cross-track error: distance of the vessel to starboard of the path.")
    along_track: Scalar = quantity("m", "Along-track error: distance of the vessel ahead of the path's point.")
    tangent: Scalar = quantity("rad", "Direction chi of the path at the path's point.", kind="angle", frame="W")
    heading_command: Scalar = quantity(
        "rad", "Heading commanded by the line-of-sight guidance.", kind="angle", frame="W"
    )
    heading_reference: Scalar = quantity("rad", "Heading of the autopilot's reference model.", kind="angle", frame="W")
    yaw_rate_reference: Scalar = quantity("rad/s", "Yaw rate of the autopilot's reference model.")
    integral: Scalar = quantity("m", "Integral I of the cross-track error, as in [1].")
    north_reference: Scalar = quantity("m", "North coordinate of the path's point.", frame="W")
    east_reference: Scalar = quantity("m", "East coordinate of the path's point.", frame="W")
    progress: Scalar = quantity(
        "s", "Path parameter theta of the path's point, which moves with the vessel: time argument of the path."
    )


@record
class LineOfSight:
    """Law that steers towards a point ahead on the path, and finds the crab angle against a current by integration.

        psi_c = chi - atan((e + s I)/D)        I' = D e/(D^2 + (e + s I)^2)                          [1]
        D = near + (far - near) exp(-(e/width)^2)
        theta' = (velocity along the path + g a)/(speed of the path's point)                         [2]

    psi_c is the commanded heading and D the lookahead distance. The path's point is the path at the path parameter
    theta, and chi is the path's direction there. e and a are the distances of the vessel to starboard of this point and
    ahead of it. The vessel follows the path at its own speed: the path gives the position, not the time. chi is the
    direction of the chord between theta - chord/2 and theta + chord/2. So the vessel starts to turn before a corner,
    and a path at rest still has a direction. Beyond its end the path is extended in a straight line.

    Shafts: n = n_u u_d + kp (u_d - u) + ki integral of (u_d - u), between 0 and the limit.

    Stable:  on a straight path, if heading and speed are as commanded and the current is slower than the vessel: e and
             I converge for any lookahead D, and any s between 0 and the speed over the ground [1, theorem 1].
    Valid:   curves with a radius larger than the vessel's turning radius and than D.
    Source:  [1]; theta as in [2]; D as in A. M. Lekkas, T. I. Fossen, "A time-varying lookahead distance guidance law
             for path following", IFAC Proceedings 45 (2012) 398-403, with their exponential of e^2.
    """

    reads: ClassVar[tuple[str, ...]] = ("surge_velocity", "sway_velocity", "yaw_rate", "heading", "north", "east")

    reference: Any = part("Path that the vessel follows.", default=Circle(radius=5.0, period=60.0))
    speed: Scalar = quantity("m/s", "Commanded forward speed u_d over the ground.", default=0.58, above=0)
    far: Scalar = quantity("m", "Lookahead distance D for a vessel on the path.", default=3.0, above=0)
    near: Scalar = quantity("m", "Lookahead distance D for a vessel far from the path.", default=2.0, above=0)
    width: Scalar = quantity(
        "m", "Cross-track error at which 63 % of the change from far to near is reached.", default=2.0, above=0
    )
    integral_gain: Scalar = quantity("m/s", "Integral gain s; 0 means no integral action.", default=0.1, low=0)
    along_gain: Scalar = quantity("1/s", "Gain g: rate at which the along-track error decays.", default=1.0, low=0)
    chord: Scalar = quantity(
        "s", "Interval of the path parameter over which the path's direction is computed.", default=6.0, above=0
    )
    shaft_per_speed: Scalar = quantity(
        "rad/m", "Feedforward gain n_u: shaft speed per commanded speed.", default=180.0, low=0
    )
    speed_gain: Scalar = quantity("rad/m", "Proportional gain kp: shaft speed per speed error.", default=150.0, low=0)
    speed_integral_gain: Scalar = quantity(
        "rad/(m s)", "Integral gain ki: shaft speed per integral of the speed error.", default=40.0, low=0
    )
    shaft_limit: Scalar = quantity("rad/s", "Maximum commanded shaft speed.", default=209.0, above=0)
    steering: Steering = part("Heading autopilot.", default=Steering())

    def init(self, key: Any) -> LineOfSightState:
        """Return the initial state, at the beginning of the path."""
        zero = jnp.asarray(0.0)
        return LineOfSightState(zero, zero, zero, zero, self.steering.init())

    def step(self, t: Any, state: LineOfSightState, estimate: Estimate) -> tuple[LineOfSightState, LineOfSightOutput]:
        """Return the demand at time t (unit: 100 ns). Demand and state are held while the estimate is not valid."""
        x, dt = estimate.state, estimate.dt
        point, chord = self._path(state.progress)
        way = jnp.sqrt(chord @ chord + 1e-18)
        tangent = jnp.where(way > 1e-6, jnp.arctan2(chord[1], chord[0]), state.tangent)
        c, s = jnp.cos(tangent), jnp.sin(tangent)
        north, east = x.north - point[0], x.east - point[1]
        along, across = c * north + s * east, c * east - s * north
        asked, rate = self._guide(tangent, across, state.integral)
        steering, rudder = self.steering.steer(
            state.steering, asked, x.heading, x.yaw_rate, jnp.abs(x.surge_velocity), dt
        )
        shaft, speed_integral = self._drive(state.speed_integral, x.surge_velocity, dt)
        ahead = x.heading - tangent
        velocity = x.surge_velocity * jnp.cos(ahead) - x.sway_velocity * jnp.sin(ahead)
        pace = jnp.maximum(way / self.chord, SLOW)
        ran = jnp.clip((velocity + self.along_gain * along) / pace, 0.0, 20.0)
        new = LineOfSightState(state.progress + dt * ran, tangent, state.integral + dt * rate, speed_integral, steering)
        output = LineOfSightOutput(
            demand=VesselControls(rudder, shaft),
            cross_track=across,
            along_track=along,
            tangent=tangent,
            heading_command=asked,
            heading_reference=steering.heading,
            yaw_rate_reference=steering.yaw_rate,
            integral=state.integral,
            north_reference=point[0],
            east_reference=point[1],
            progress=state.progress,
        )
        return tree_where(estimate.valid, new, state), output

    def _path(self, progress: Any) -> tuple[Any, Any]:
        """Return the path's point (2,) (m) at the path parameter, and the chord about this point (2,) (m)."""
        half = self.chord / 2
        after, before = self.reference.at(progress + half), self.reference.at(jnp.maximum(progress - half, 0.0))
        return self.reference.at(progress).place, after.place - before.place

    def _guide(self, tangent: Any, e: Any, integral: Any) -> tuple[Any, Any]:
        """Return the commanded heading (rad), and the rate I' of the integral of the cross-track error."""
        lookahead = self.near + (self.far - self.near) * jnp.exp(-((e / self.width) ** 2))
        off = e + self.integral_gain * integral
        return tangent - jnp.arctan2(off, lookahead), lookahead * e / (lookahead**2 + off**2)

    def _drive(self, integral: Any, surge: Any, dt: Any) -> tuple[Any, Any]:
        """Return the shaft speed (rad/s) and the integral of the speed error (m), held at the limits of the shaft."""
        e = self.speed - surge
        asked = self.shaft_per_speed * self.speed + self.speed_gain * e + self.speed_integral_gain * integral
        shaft = jnp.clip(asked, 0.0, self.shaft_limit)
        return shaft, integral + jnp.where(asked == shaft, dt * e, 0.0)
