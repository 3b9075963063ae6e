"""Body carried along a closed path in the air. All derivatives of its motion are known, for tests of navigation."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import to_euler, wrap
from trimtab.core.signals import Motion
from trimtab.environment.geodetic import STANDARD
from trimtab.vehicles.rotating_platform import PlatformDrive

MIDDLE = -jnp.pi / 2
"""Yaw (rad) about which the yaw angle is unwrapped. It is the middle of the path's range of yaw, which is less than a
full turn."""


@record
class ClosedPathState:
    """State of a body on a closed path: angle along the path, its rate, and the motion that follows from both.

    Only angle and rate determine the motion. The other fields are integrated too, so that a log contains the true value
    of every navigation estimate. `ClosedPath.at` returns a consistent state. Source: this module.
    """

    angle: Scalar = quantity("rad", "Angle along the path, unwrapped. One lap is a full turn.", kind="angle")
    rate: Scalar = quantity("rad/s", "Rate of the angle along the path.")
    position: Any = quantity("m", "Position: north, east, down.", frame="W", shape=(3,))
    velocity: Any = quantity("m/s", "Velocity: north, east, down.", frame="W", shape=(3,))
    attitude: Any = quantity("1", "Attitude: quaternion q_WB, scalar first.", frame="WB", shape=(4,))


@record
class ClosedPath:
    """Figure of eight that climbs and descends, flown like an aircraft: nose along the path, banked without sideslip.

        p = (length sin al, width sin 2 al, -height - climb sin al)
        x_B along p',   z_B opposite to the component of f = p'' W^2 - g normal to x_B,   W the `coordinated` rate
        al'' = (rate - al')/tau

    Position and attitude are functions of the angle alone, so velocity, acceleration, angular velocity and angular
    acceleration are exact derivatives at any rate. At a rate other than `coordinated` the body sideslips.

    Frames:  W north-east-down, B forward, starboard, down, at the body's centre of mass.
    Not modelled: air, thrust, the vehicle's dynamics. The path prescribes the motion.
    Valid:   length > 0; the path never points straight down or up.
    Source:  turns without sideslip: Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd ed., section 3.6.
    """

    length: Scalar = quantity("m", "Half of the path's extent from south to north.", default=60.0, above=0)
    width: Scalar = quantity("m", "Half of the path's extent from west to east.", default=20.0, low=0)
    climb: Scalar = quantity("m", "Half of the path's extent in height.", default=8.0, low=0)
    height: Scalar = quantity("m", "Height of the centre of the path.", default=50.0)
    coordinated: Scalar = quantity(
        "rad/s",
        "Rate of the path angle at which the body flies coordinated turns, i.e. without sideslip.",
        default=0.3,
        low=0,
    )
    time_constant: Scalar = quantity(
        "s", "Time constant of the lag from the commanded rate to the actual rate.", default=0.5, above=0
    )

    MAV_TYPE: ClassVar[str] = "FIXED_WING"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def place(self, angle: Any) -> Any:
        """Return the position p (3,) (m, in W) at a path angle (rad)."""
        return jnp.stack(
            [
                self.length * jnp.sin(angle),
                self.width * jnp.sin(2 * angle),
                -self.height - self.climb * jnp.sin(angle),
            ]
        )

    def tangent(self, angle: Any) -> Any:
        """Return p' (3,) (m/rad, in W), the derivative of the position with respect to the path angle."""
        c, c2 = jnp.cos(angle), jnp.cos(2 * angle)
        return jnp.stack([self.length * c, 2 * self.width * c2, -self.climb * c])

    def curvature(self, angle: Any) -> Any:
        """Return p'' (3,) (m/rad², in W), the second derivative of the position with respect to the path angle."""
        s, s2 = jnp.sin(angle), jnp.sin(2 * angle)
        return jnp.stack([-self.length * s, -4 * self.width * s2, self.climb * s])

    def rotation(self, angle: Any) -> Any:
        """Return the attitude R_WB (3, 3) at a path angle (rad)."""
        along = self.tangent(angle)
        x = along / jnp.sqrt(along @ along)
        force = self.curvature(angle) * self.coordinated**2 - jnp.array([0.0, 0.0, STANDARD])
        across = force - (force @ x) * x
        z = -across / jnp.sqrt(across @ across)
        return jnp.stack([x, jnp.cross(z, x), z], axis=1)

    def turn(self, angle: Any) -> Any:
        """Return the angular velocity of the body (3,) in B per unit rate of the path angle."""
        R, dR = jax.jvp(self.rotation, (angle,), (jnp.ones_like(angle),))
        S = R.T @ dR
        return jnp.stack([S[2, 1], S[0, 2], S[1, 0]])

    def dynamics(self, t: Any, x: ClosedPathState, u: PlatformDrive) -> ClosedPathState:
        """Return the time derivative of the state x (SI) under the commanded rate."""
        acceleration = (u.rate - x.rate) / self.time_constant
        along = self.tangent(x.angle)
        return ClosedPathState(
            angle=x.rate,
            rate=acceleration,
            position=along * x.rate,
            velocity=self.curvature(x.angle) * x.rate**2 + along * acceleration,
            attitude=quaternion.rate(x.attitude, self.turn(x.angle) * x.rate),
        )

    def motion(self, t: Any, x: ClosedPathState, u: PlatformDrive) -> Motion:
        """Return the motion of the body at time t (unit: 100 ns), for sensors, from angle, rate and command."""
        acceleration = (u.rate - x.rate) / self.time_constant
        R_WB, along = self.rotation(x.angle), self.tangent(x.angle)
        turn, change = jax.jvp(self.turn, (x.angle,), (jnp.ones_like(x.angle),))
        roll, pitch, yaw = to_euler(R_WB)
        return Motion(
            t=t,
            p_WB=self.place(x.angle),
            attitude=jnp.stack([roll, pitch, MIDDLE + wrap(yaw - MIDDLE)]),
            v_WB_B=R_WB.T @ along * x.rate,
            w_WB_B=turn * x.rate,
            a_WB_B=R_WB.T @ (self.curvature(x.angle) * x.rate**2 + along * acceleration),
            alpha_WB_B=change * x.rate**2 + turn * acceleration,
        )

    def at(self, angle: float, rate: float) -> ClosedPathState:
        """Return the state at a path angle (rad) and a rate of this angle (rad/s)."""
        a = jnp.asarray(angle, float)
        q = quaternion.from_matrix(self.rotation(a))
        return ClosedPathState(a, jnp.asarray(rate, float), self.place(a), self.tangent(a) * rate, q)
