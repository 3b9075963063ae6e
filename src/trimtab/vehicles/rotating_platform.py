"""Motor-driven rotating platform with an arm, with which the thesis (Kulis 2006) tested navigation."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import from_euler, from_rotation_vector, to_euler, wrap
from trimtab.core.signals import Motion

QUARTER = jnp.pi / 2
"""Angle from the direction of the arm to the body's x axis (rad)."""


@record
class PlatformDrive:
    """Command of the platform's motor. Source: this module."""

    rate: Scalar = quantity("rad/s", "Commanded rate of turn, clockwise from above.")


@record
class PlatformState:
    """State of the platform: heading, rate, and the motion of the body at the arm's end that follows from both.

    Only heading and yaw_rate determine the motion. The other fields are integrated too, so that a log contains the true
    value of every navigation estimate. `RotatingPlatform.rest_state` returns a consistent state. Source: this module.
    """

    heading: Scalar = quantity(
        "rad", "Heading of the body: direction of the arm plus a quarter turn, not wrapped to one turn.", kind="angle"
    )
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn W, clockwise from above.", frame="B")
    surge_velocity: Scalar = quantity(
        "m/s", "Velocity along the body's x axis: length of the arm times rate of turn.", frame="B"
    )
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis; always 0.", frame="B")
    north: Scalar = quantity("m", "Position of the body along the world's x axis.", frame="W")
    east: Scalar = quantity("m", "Position of the body along the world's y axis.", frame="W")


@record
class RotatingPlatform:
    """Platform on a vertical axis, turned by a motor. Its rate follows the command with a first-order lag.

        W' = (rate - W)/tau        al' = W        psi = al + pi/2        p = T R (cos al, sin al, 0)
        v_B = (R W, 0, 0)          a_B = (R W', R W^2, 0)

    al is the arm's direction, R its length, and T the rotation that tilts the axis. The tilt is fixed in the world, so
    the component of gravity in the platform's plane rotates in the body once per revolution. An accelerometer bias has
    no such effect, because it is constant in the body.

    Frames:  W north-east-down, origin on the axis; B at the arm's end, x tangential, y inward, z along the axis.
    Not modelled: backlash, elasticity, the motor's torque limit.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.2.1. Reconstructed: time constant and tilt, see docs Errata.
    """

    arm: Scalar = quantity(
        "m",
        "Length of the arm from the axis to the body; 0: the body is on the axis.",
        default=0.3048,
        low=0,
        source="[1] 12 in",
    )
    time_constant: Scalar = quantity(
        "s", "Time constant of the lag from the commanded rate to the actual rate.", default=0.1, above=0
    )
    tilt: Scalar = quantity("rad", "Angle of the spin axis from the vertical.", default=0.0, low=0, high=0.5)
    lean: Scalar = quantity(
        "rad", "Direction from north in which the upper end of the spin axis is tilted.", default=0.0, kind="angle"
    )

    MAV_TYPE: ClassVar[str] = "GENERIC"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def dynamics(self, t: Any, x: PlatformState, u: PlatformDrive) -> PlatformState:
        """Return the time derivative of the state x (SI) under the commanded rate."""
        acceleration = (u.rate - x.yaw_rate) / self.time_constant
        velocity = self._lean_rotation() @ (
            self.arm * x.yaw_rate * jnp.stack([jnp.cos(x.heading), jnp.sin(x.heading), 0.0])
        )
        return PlatformState(
            heading=x.yaw_rate,
            yaw_rate=acceleration,
            surge_velocity=self.arm * acceleration,
            sway_velocity=jnp.zeros_like(acceleration),
            north=velocity[0],
            east=velocity[1],
        )

    def motion(self, t: Any, x: PlatformState, u: PlatformDrive) -> Motion:
        """Return the motion of the arm's end at time t (unit: 100 ns), for sensors, from heading, rate and command."""
        angle = x.heading - QUARTER
        acceleration = (u.rate - x.yaw_rate) / self.time_constant
        o = jnp.zeros_like(acceleration)
        T = self._lean_rotation()
        attitude = to_euler(T @ from_euler(o, o, x.heading))
        yaw = x.heading + wrap(attitude[2] - x.heading)
        return Motion(
            t=t,
            p_WB=T @ (self.arm * jnp.stack([jnp.cos(angle), jnp.sin(angle), o])),
            attitude=jnp.stack([attitude[0], attitude[1], yaw]),
            v_WB_B=jnp.stack([self.arm * x.yaw_rate, o, o]),
            w_WB_B=jnp.stack([o, o, x.yaw_rate]),
            a_WB_B=jnp.stack([self.arm * acceleration, self.arm * x.yaw_rate**2, o]),
            alpha_WB_B=jnp.stack([o, o, acceleration]),
        )

    def rest_state(self, heading: float = 0.0) -> PlatformState:
        """Return the state at rest at a heading (rad)."""
        place = self._lean_rotation() @ (self.arm * jnp.stack([jnp.sin(heading), -jnp.cos(heading), 0.0]))
        return PlatformState(heading, 0.0, 0.0, 0.0, place[0], place[1])

    def _lean_rotation(self) -> Any:
        """Return the rotation T (3, 3) from the upright to the tilted platform."""
        turn = self.tilt * jnp.stack([jnp.sin(self.lean), -jnp.cos(self.lean), jnp.zeros_like(self.lean * 1.0)])
        return from_rotation_vector(turn)
