"""Mariner, a cargo ship of 161 m, in surge, sway and yaw: a standard model in textbooks on ship steering.

[1] is M. S. Chislett, J. Strøm-Tejsen, "Planar motion mechanism tests and full-scale steering and manoeuvring
predictions for a Mariner class vessel", Hydro- and Aerodynamics Laboratory, report Hy-5, Lyngby 1965, in the form of
T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control".
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import DEG
from trimtab.core.signals import Motion

SURGE = (-184, -110, -215, -899, 18, -95, -190, 798, 93, 93)
"""1e5 times the coefficients of the surge force X for u, u^2, u^3, v^2, r^2, d^2, u d^2, r v, v d, u v d. d is the
rudder angle."""
SWAY = (-1160, -499, -8078, 15356, -1160, -499, 278, -90, 556, 278, -4, 1190, -4, -8, -4)
"""1e5 times the coefficients of the sway force Y for v, r, v^3, v^2 r, u v, u r, d, d^3, u d, u^2 d, v d^2, v^2 d, 1,
u, u^2. d is the rudder angle."""
YAW = (-264, -166, 1636, -5483, -264, -166, -139, 45, -278, -139, 13, -489, 3, 6, 3)
"""1e5 times the coefficients of the yaw moment N, for the same terms as in SWAY."""


@record
class MarinerControls:
    """Command of the steering gear. Source: [1]."""

    rudder: Scalar = quantity(
        "rad",
        "Commanded rudder angle; positive pushes the stern to starboard, so the ship turns to port.",
        kind="angle",
    )


@record
class MarinerState:
    """State of the ship: velocity over the ground and position of the point amidships, heading, rudder angle.

    Source:  [1].
    """

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B", default=7.7175)
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B", default=0.0)
    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W", default=0.0)
    heading: Scalar = quantity(
        "rad", "Angle from north to the body's x axis, clockwise, not wrapped to one turn.", kind="angle", default=0.0
    )
    rudder: Scalar = quantity("rad", "Rudder angle.", kind="angle", default=0.0)


@record
class Mariner:
    """Mariner near its service speed with constant propulsion. Only the rudder is controlled.

        (m - Xu') u' = X        (m - Yv') v' + (m xg - Yr') r' = Y        (m xg - Nv') v' + (Iz - Nr') r' = N
        rudder' = limit(rudder_c - rudder, rate)

    X, Y and N are polynomials of third degree in the velocities and the rudder angle d. Velocities are divided by the
    speed U, the yaw rate by U/L, forces by rho L^2 U^2/2 and moments by rho L^3 U^2/2. u is the surge velocity minus
    the service speed. The polynomials include the inertial forces of turning.

    Frames:  W north-east-down; B amidships, x forward, y starboard. `motion` describes the centre of mass.
    Valid:   near its service speed, rudder to 40 degrees, deep and still water. Not modelled: the screw's speed, waves,
             wind, roll.
    Source:  [1]; the values of the coefficients as in Fossen's toolbox MSS.
    """

    length: Scalar = quantity("m", "Length between perpendiculars.", default=160.93, above=0, source="[1]")
    service_speed: Scalar = quantity("m/s", "Service speed, 15 knots.", default=7.7175, above=0, source="[1]")
    mass: Scalar = quantity("1", "Mass m, in units of rho L^3/2.", default=798e-5, above=0, source="[1]")
    inertia: Scalar = quantity(
        "1", "Moment of inertia Iz, in units of rho L^5/2.", default=39.2e-5, above=0, source="[1]"
    )
    centre: Scalar = quantity(
        "1", "Distance of the centre of mass ahead of amidships (ship lengths).", default=-0.023, source="[1]"
    )
    added_surge: Scalar = quantity("1", "Added mass in surge: -Xu'.", default=42e-5, source="[1]")
    added_sway: Any = quantity(
        "1", "Added mass terms of the sway force: -Yv', -Yr'.", default=(748e-5, 9.354e-5), shape=(2,), source="[1]"
    )
    added_yaw: Any = quantity(
        "1", "Added mass terms of the yaw moment: -Nv', -Nr'.", default=(-4.646e-5, 43.8e-5), shape=(2,), source="[1]"
    )
    surge: Any = quantity(
        "1",
        "Coefficients of the surge force X, in the order of the constant SURGE.",
        default=1e-5 * np.array(SURGE),
        shape=(10,),
        source="[1]",
    )
    sway: Any = quantity(
        "1",
        "Coefficients of the sway force Y, in the order of the constant SWAY.",
        default=1e-5 * np.array(SWAY),
        shape=(15,),
        source="[1]",
    )
    yaw: Any = quantity(
        "1",
        "Coefficients of the yaw moment N, in the order of the constant YAW.",
        default=1e-5 * np.array(YAW),
        shape=(15,),
        source="[1]",
    )
    rudder_limit: Scalar = quantity("rad", "Maximum rudder angle.", default=40 * DEG, above=0, source="[1]")
    rudder_rate: Scalar = quantity("rad/s", "Maximum rate of the rudder.", default=5 * DEG, above=0, source="[1]")
    rudder_lag: Scalar = quantity("s", "Time constant of the steering gear.", default=1.0, above=0)

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def input_limits(self) -> dict[str, tuple[Any, Any]]:
        """Return the limits of the rudder angle (rad)."""
        return {"rudder": (-self.rudder_limit, self.rudder_limit)}

    def accelerations(self, x: MarinerState) -> tuple[Any, Any, Any]:
        """Return the time derivatives of surge and sway velocity (m/s^2) and of the yaw rate (rad/s^2)."""
        L, d = self.length, x.rudder
        U = jnp.sqrt(x.surge_velocity**2 + x.sway_velocity**2)
        u, v, r = (x.surge_velocity - self.service_speed) / U, x.sway_velocity / U, x.yaw_rate * L / U
        along = (u, u**2, u**3, v**2, r**2, d**2, u * d**2, r * v, v * d, u * v * d)
        across = (v, r, v**3, v**2 * r, u * v, u * r, d, d**3, u * d, u**2 * d, v * d**2, v**2 * d, u * 0 + 1, u, u**2)
        X = jnp.asarray(self.surge) @ jnp.stack(along)
        Y, N = (jnp.asarray(a) @ jnp.stack(across) for a in (self.sway, self.yaw))
        (yv, yr), (nv, nr) = self.added_sway, self.added_yaw
        m22, m23 = self.mass + yv, self.mass * self.centre + yr
        m32, m33 = self.mass * self.centre + nv, self.inertia + nr
        determinant, scale = m22 * m33 - m23 * m32, U**2 / L
        dv, dr = (m33 * Y - m23 * N) / determinant, (m22 * N - m32 * Y) / determinant
        return scale * X / (self.mass + self.added_surge), scale * dv, scale / L * dr

    def dynamics(self, t: Any, x: MarinerState, u: MarinerControls) -> MarinerState:
        """Return the time derivative of the state x (SI) under a command to the steering gear."""
        du, dv, dr = self.accelerations(x)
        c, s = jnp.cos(x.heading), jnp.sin(x.heading)
        asked = jnp.clip(u.rudder, -self.rudder_limit, self.rudder_limit)
        return MarinerState(
            surge_velocity=du,
            sway_velocity=dv,
            yaw_rate=dr,
            north=c * x.surge_velocity - s * x.sway_velocity,
            east=s * x.surge_velocity + c * x.sway_velocity,
            heading=x.yaw_rate,
            rudder=jnp.clip((asked - x.rudder) / self.rudder_lag, -self.rudder_rate, self.rudder_rate),
        )

    def motion(self, t: Any, x: MarinerState, u: MarinerControls) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors."""
        du, dv, dr = self.accelerations(x)
        arm, r, o = self.centre * self.length, x.yaw_rate, jnp.zeros_like(du)
        stack = jnp.stack
        return Motion(
            t=t,
            p_WB=stack([x.north + arm * jnp.cos(x.heading), x.east + arm * jnp.sin(x.heading), o]),
            attitude=stack([o, o, x.heading]),
            v_WB_B=stack([x.surge_velocity, x.sway_velocity + arm * r, o]),
            w_WB_B=stack([o, o, r]),
            a_WB_B=stack([du - r * x.sway_velocity - arm * r**2, dv + r * x.surge_velocity + arm * dr, o]),
            alpha_WB_B=stack([o, o, dr]),
        )
