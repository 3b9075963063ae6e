"""Dubins' car, which drives forward at constant speed with a minimum turning radius. A vehicle for tutorials.

[1] is L. E. Dubins, "On curves of minimal length with a constraint on average curvature, and with prescribed initial
and terminal positions and tangents", American Journal of Mathematics 79 (1957) 497-516.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.signals import Motion


@record
class DubinsCarState:
    """State of the car: position and heading. Source: [1]."""

    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W", default=0.0)
    heading: Scalar = quantity(
        "rad", "Heading from north, clockwise, not wrapped to one turn.", kind="angle", default=0.0
    )


@record
class CarTurn:
    """Steering input of the car. Frames: clockwise seen from above, to the right. Source: [1]."""

    turn_rate: Scalar = quantity("rad/s", "Rate of turn, positive to the right.")


@record
class DubinsCar:
    """Point that moves at constant speed in the direction of its heading.

        north' = V cos psi     east' = V sin psi     psi' = r,   |r| <= V/R

    psi is the heading and r the commanded turn rate.

    Frames:  W north, east; B forward, right, down.
    Valid:   any turn rate; rates beyond V/R are limited to V/R. Not modelled: slip, steering lag, reverse driving, with
             which other paths are shortest (Reeds and Shepp, 1990).
    Source:  [1]; speed and radius are our own choice.
    """

    speed: Scalar = quantity("m/s", "Speed V of the car.", default=1.0, above=0)
    radius: Scalar = quantity("m", "Minimum turning radius R.", default=0.8, above=0)

    MAV_TYPE: ClassVar[str] = "GROUND_ROVER"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def limit(self, turn_rate: Any) -> Any:
        """Return the turn rate of the car (rad/s): the commanded rate, limited to V/R."""
        most = self.speed / self.radius
        return jnp.clip(turn_rate, -most, most)

    def dynamics(self, t: Any, x: DubinsCarState, u: CarTurn) -> DubinsCarState:
        """Return the time derivative of the state x under the turn rate u."""
        return DubinsCarState(
            self.speed * jnp.cos(x.heading), self.speed * jnp.sin(x.heading), self.limit(u.turn_rate) + 0.0 * x.heading
        )

    def motion(self, t: Any, x: DubinsCarState, u: CarTurn) -> Motion:
        """Return the motion of the car at time t (unit: 100 ns), for sensors."""
        rate, zero = self.limit(u.turn_rate), 0.0 * x.heading
        nothing = jnp.stack([zero, zero, zero])
        return Motion(
            t,
            p_WB=jnp.stack([x.north, x.east, zero]),
            attitude=jnp.stack([zero, zero, x.heading]),
            v_WB_B=jnp.stack([self.speed + zero, zero, zero]),
            w_WB_B=jnp.stack([zero, zero, rate + zero]),
            a_WB_B=jnp.stack([zero, self.speed * rate + zero, zero]),
            alpha_WB_B=nothing,
        )
