"""Planar hovercraft with a vectored fan at the tail."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Motion, PlanarForce


@record
class HovercraftState:
    """State of a vehicle on a floor: velocity in body axes, position and heading.

    Frames:  W north-east-down, B at the centre of mass.

    Source: [1] eq. 2.11, in velocities instead of momenta: PX = m u, PY = m v, Pi = J r.
    """

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B", default=0.0)
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B", default=0.0)
    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W", default=0.0)
    heading: Scalar = quantity(
        "rad", "Angle from north to the body's x axis, clockwise, not wrapped to one turn.", kind="angle", default=0.0
    )


def planar_rates(x: HovercraftState, ax: Any, ay: Any, turn: Any) -> HovercraftState:
    """Return the time derivative of the state x.

    ax, ay: acceleration of the centre of mass in W, resolved in B (m/s^2).    turn: yaw acceleration (rad/s^2).
    """
    c, s = jnp.cos(x.heading), jnp.sin(x.heading)
    return HovercraftState(
        surge_velocity=x.sway_velocity * x.yaw_rate + ax,
        sway_velocity=-x.surge_velocity * x.yaw_rate + ay,
        yaw_rate=turn,
        north=c * x.surge_velocity - s * x.sway_velocity,
        east=s * x.surge_velocity + c * x.sway_velocity,
        heading=x.yaw_rate,
    )


def planar_motion(t: Any, x: HovercraftState, ax: Any, ay: Any, turn: Any) -> Motion:
    """Return the motion of a vehicle on a level floor at time t (unit: 100 ns), from the vehicle's accelerations."""
    o = jnp.zeros_like(ax)
    stack = jnp.stack
    return Motion(
        t=t,
        p_WB=stack([x.north, x.east, o]),
        attitude=stack([o, o, x.heading]),
        v_WB_B=stack([x.surge_velocity, x.sway_velocity, o]),
        w_WB_B=stack([o, o, x.yaw_rate]),
        a_WB_B=stack([ax, ay, o]),
        alpha_WB_B=stack([o, o, turn]),
    )


@record
class Friction:
    """Friction of skirt and air: Coulomb, viscous and quadratic terms for force and torque.

    F = -(c0 tanh(|v|/v0) + c1 |v| + c2 |v|^2) v/|v|. The torque has the same form with the yaw rate.

    Not in:  the model of the thesis (Kulis 2006). Rotational friction explains three observations of the thesis (slow
             spin, sway bias and early stop), but contradicts the moment of inertia that the thesis measured (docs page,
             Errata).
    Source:  Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994), section 2, for the form.
    """

    force_coulomb: Scalar = quantity("N", "Coefficient c0: magnitude of the dry friction force.", default=0.0, low=0)
    force_viscous: Scalar = quantity("N s/m", "Coefficient c1: viscous drag per speed.", default=0.0, low=0)
    force_quadratic: Scalar = quantity(
        "N s^2/m^2", "Coefficient c2: quadratic drag per speed squared.", default=0.0, low=0
    )
    torque_coulomb: Scalar = quantity("N m", "Magnitude of the dry friction torque.", default=0.0, low=0)
    torque_viscous: Scalar = quantity("N m s", "Viscous friction torque per yaw rate.", default=0.0, low=0)
    torque_quadratic: Scalar = quantity(
        "N m s^2", "Quadratic friction torque per yaw rate squared.", default=0.0, low=0
    )
    slip_speed: Scalar = quantity(
        "m/s", "Speed v0 at which dry friction reaches 76 % of its full value.", default=0.01, above=0
    )
    slip_rate: Scalar = quantity(
        "rad/s", "Yaw rate at which the dry friction torque reaches 76 % of its full value.", default=0.01, above=0
    )

    def wrench(self, surge_velocity: Any, sway_velocity: Any, yaw_rate: Any) -> tuple[Any, Any, Any]:
        """Return the friction: force along x and y (N) and torque about z (N m), all in B."""
        speed2 = surge_velocity**2 + sway_velocity**2
        moving = speed2 > 0
        speed = jnp.sqrt(jnp.where(moving, speed2, 1.0))
        dry = self.force_coulomb * jnp.where(moving, jnp.tanh(speed / self.slip_speed) / speed, 1 / self.slip_speed)
        per_velocity = dry + self.force_viscous + self.force_quadratic * jnp.where(moving, speed, 0.0)
        torque = self.torque_coulomb * jnp.tanh(yaw_rate / self.slip_rate)
        torque = torque + (self.torque_viscous + self.torque_quadratic * jnp.abs(yaw_rate)) * yaw_rate
        return -per_velocity * surge_velocity, -per_velocity * sway_velocity, -torque


@record
class Hovercraft:
    """Planar hovercraft with a vectored fan at the tail. Sway has no actuator.

        u' =  v r + FX/m      v' = -u r + FY/m      r' = -d FY/J          [1, eq. 2.10, divided by m and J]
        north' = u cos psi - v sin psi    east' = u sin psi + v cos psi    psi' = r     [1, eq. 2.11]

    u, v and r are surge velocity, sway velocity and yaw rate, psi is the heading.

    Frames:  W north-east-down, B at the centre of mass, x forward, y starboard; the force acts at (-d, 0) in B.
    Valid:   level floor.    Not modelled: skirt contact, slope, the fan's gyroscopic moment.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             chapter 2. Differences from [1]: docs page, Errata.
    """

    mass: Scalar = quantity("kg", "Total mass with batteries.", default=2.6, above=0, source="[1] text, 5.7 lb")
    inertia: Scalar = quantity("kg m^2", "Moment of inertia about z.", default=0.096, above=0, source="[1] table 4.2")
    arm: Scalar = quantity(
        "m", "Distance d from the centre of mass to the rudder pivot.", default=0.32, above=0, source="[1] 12.6 in"
    )
    friction: Any = part("Friction of skirt and air. None: no friction, as in [1].", default=None, optional=Friction())

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def dynamics(self, t: Any, x: HovercraftState, u: PlanarForce) -> HovercraftState:
        """Return the time derivative of the state x (SI) under the force u at the rudder pivot."""
        return planar_rates(x, *self.accelerations(x, u))

    def accelerations(self, x: HovercraftState, u: PlanarForce) -> tuple[Any, Any, Any]:
        """Return the acceleration of the centre of mass in W, resolved in B (x, y, m/s^2), and the yaw acceleration
        (rad/s^2)."""
        FX, FY, torque = u.FX, u.FY, -self.arm * u.FY
        if self.friction is not None:
            dX, dY, dN = self.friction.wrench(x.surge_velocity, x.sway_velocity, x.yaw_rate)
            FX, FY, torque = FX + dX, FY + dY, torque + dN
        return FX / self.mass, FY / self.mass, torque / self.inertia

    def motion(self, t: Any, x: HovercraftState, u: PlanarForce) -> Motion:
        """Return the motion of the vehicle at time t (unit: 100 ns), for sensors."""
        return planar_motion(t, x, *self.accelerations(x, u))

    @property
    def percussion_arm(self) -> Any:
        """Return the distance a = J/(m d) (m) from the centre of mass forward to the point that FY does not
        accelerate."""
        return self.inertia / (self.mass * self.arm)

    def energy(self, x: HovercraftState) -> Any:
        """Return the kinetic energy (J), which is V in [1, eq. 2.17]."""
        return self.mass * (x.surge_velocity**2 + x.sway_velocity**2) / 2 + self.inertia * x.yaw_rate**2 / 2
