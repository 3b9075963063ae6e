"""Planar hovercraft with one propeller that pushes forward only, and rudders in its stream, as sold by model shops.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Motion, PlanarForce
from trimtab.vehicles.hovercraft import Friction, HovercraftState, planar_motion, planar_rates


@record
class RudderThrottle:
    """Command of a propeller and of the rudders in its stream. Source: this module."""

    throttle: Scalar = quantity("1", "Throttle of the propeller, from 0 (at rest) to 1.", default=0.0, low=0, high=1)
    rudder: Scalar = quantity(
        "rad",
        "Angle of the rudders; a positive angle turns the nose to starboard.",
        kind="angle",
        default=0.0,
        low=-1.2,
        high=1.2,
    )


@record
class RudderHovercraft:
    """Planar hovercraft with one propeller that pushes forward only, and rudders in its stream. Sway has no actuator.

        T = a c + b c^2, c = throttle limited to [0, 1]       psi = deflection rudder
        FX = T cos psi      FY = -T sin psi      N = -arm FY - offset FX
        u' = v r + (FX + DX)/m     v' = -u r + (FY + DY)/m     r' = (N + DN)/J     pose as in `hovercraft.Hovercraft`

    T is the thrust. The rudders turn the stream of the propeller by the angle psi. (DX, DY, DN) is the friction. The
    craft cannot brake with its nose forward, and it cannot turn without a push forward, because rudders have no effect
    without a stream.

    Frames:  W north-east-down, B at the centre of mass, x forward, y starboard; the force acts at (-arm, offset) in B.
    Valid:   level floor, rudder angles without stall (up to about 0.6 rad).
    Not modelled: lag of motor and servo (see ActuatorBank), inflow of the propeller, torque of the propeller, loss of
             thrust as the battery empties.
    Source:  [1] eq. 2.10 for the motion and eq. 4.3 for the deflection of the stream, which [1] measured as 1/1.40 of
             the rudder angle. Defaults: our choice, a foam craft of 40 cm with an 8-inch propeller. Measure your own
             with `trimtab calibrate` and `trimtab identify`.
    """

    mass: Scalar = quantity("kg", "Total mass with battery.", default=0.75, above=0)
    inertia: Scalar = quantity("kg m^2", "Moment of inertia about z.", default=0.012, above=0)
    arm: Scalar = quantity("m", "Distance from the centre of mass back to the rudders.", default=0.2, above=0)
    offset: Scalar = quantity(
        "m",
        "Distance of the propeller's axis to starboard of the centre of mass. It turns the craft to port.",
        default=0.0,
    )
    thrust_linear: Scalar = quantity("N", "Coefficient a of the thrust: thrust per throttle.", default=0.3, low=0)
    thrust_quadratic: Scalar = quantity(
        "N", "Coefficient b of the thrust: thrust per throttle squared.", default=1.3, low=0
    )
    deflection: Scalar = quantity(
        "1", "Angle by which the stream turns, per rudder angle.", default=0.7, above=0, source="[1] eq. 4.3"
    )
    friction: Friction = part(
        "Friction of skirt and air.",
        default=Friction(
            force_coulomb=0.02,
            force_viscous=0.15,
            force_quadratic=0.05,
            torque_coulomb=0.001,
            torque_viscous=0.004,
            slip_speed=0.02,
            slip_rate=0.05,
        ),
    )

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def thrust(self, throttle: Any) -> Any:
        """Return the thrust (N) at a throttle, which is limited to [0, 1]."""
        c = jnp.clip(throttle, 0.0, 1.0)
        return (self.thrust_linear + self.thrust_quadratic * c) * c

    def force(self, u: RudderThrottle) -> PlanarForce:
        """Return the force (N, in B) of the propeller's stream behind the rudders."""
        T, psi = self.thrust(u.throttle), self.deflection * u.rudder
        return PlanarForce(FX=T * jnp.cos(psi), FY=-T * jnp.sin(psi))

    def accelerations(self, x: HovercraftState, u: RudderThrottle) -> tuple[Any, Any, Any]:
        """Return the acceleration of the centre of mass in W, resolved in B (x, y, m/s^2), and the yaw acceleration
        (rad/s^2)."""
        f = self.force(u)
        DX, DY, DN = self.friction.wrench(x.surge_velocity, x.sway_velocity, x.yaw_rate)
        N = -self.arm * f.FY - self.offset * f.FX
        return (f.FX + DX) / self.mass, (f.FY + DY) / self.mass, (N + DN) / self.inertia

    def dynamics(self, t: Any, x: HovercraftState, u: RudderThrottle) -> HovercraftState:
        """Return the time derivative of the state x (SI) under the input u."""
        return planar_rates(x, *self.accelerations(x, u))

    def motion(self, t: Any, x: HovercraftState, u: RudderThrottle) -> Motion:
        """Return the motion of the vehicle at time t (unit: 100 ns), for sensors."""
        return planar_motion(t, x, *self.accelerations(x, u))
