"""Underactuated surface vessel in three degrees of freedom, with propellers and rudders aft and no lateral thruster.

[1] is R. Skjetne, Ø. N. Smogeli, T. I. Fossen, "A nonlinear ship manoeuvering model: identification and adaptive
control with experiments for a model ship", Modeling, Identification and Control 25 (2004) 3-27.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.rotation import DEG
from trimtab.core.signals import Motion
from trimtab.environment.current import Current
from trimtab.environment.wind import Wind

TURN = 2 * np.pi
"""Angle of one turn of a shaft (rad)."""
TABLE_1, TABLE_2, TABLE_4 = "[1] table 1", "[1] table 2", "[1] table 4"
AIR = 1.225
"""Density of air (kg/m^3)."""


@record
class VesselControls:
    """Command for rudders and propellers. Source: [1] section 2."""

    rudder: Scalar = quantity(
        "rad", "Commanded angle of both rudders; positive pushes the stern to starboard.", kind="angle"
    )
    shaft_speed: Scalar = quantity("rad/s", "Commanded speed of both propellers; positive drives ahead.")


@record
class VesselState:
    """State of the vessel: velocity over ground of the centre of mass, pose, rudder angle, propeller speed.

    Source:  [1] section 2.
    """

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B", default=0.0)
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B", default=0.0)
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B", default=0.0)
    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W", default=0.0)
    heading: Scalar = quantity(
        "rad", "Angle from north to the body's x axis, clockwise, not wrapped to one turn.", kind="angle", default=0.0
    )
    rudder: Scalar = quantity("rad", "Angle of both rudders.", kind="angle", default=0.0)
    shaft_speed: Scalar = quantity("rad/s", "Speed of both propellers.", default=0.0)


@record
class HullDamping:
    """Damping forces of the water on a moving hull, about the reference point amidships: -D(nu) nu.

        X = Xu u + Xuu |u| u + Xuuu u^3
        Y = (Yv + Yvv |v| + Yrv |r|) v + (Yr + Yvr |v| + Yrr |r|) r        N has the same form

    Frames:  B; velocities through the water.
    Valid:   up to about 1 m/s for the default values, which are from towing tests and adaptive identification.
    Source:  [1] tables 2 and 4, in SNAME notation.
    """

    Xu: Scalar = quantity(
        "kg/s", "Damping of the hull: coefficient of the surge force per u.", default=-0.72253, source=TABLE_2
    )
    Xuu: Scalar = quantity(
        "kg/m", "Damping of the hull: coefficient of the surge force per |u| u.", default=-1.32742, source=TABLE_2
    )
    Xuuu: Scalar = quantity(
        "kg s/m^2", "Damping of the hull: coefficient of the surge force per u^3.", default=-5.86643, source=TABLE_2
    )
    Yv: Scalar = quantity(
        "kg/s", "Damping of the hull: coefficient of the sway force per v.", default=-0.88965, source=TABLE_2
    )
    Yvv: Scalar = quantity(
        "kg/m", "Damping of the hull: coefficient of the sway force per |v| v.", default=-36.47287, source=TABLE_2
    )
    Yrv: Scalar = quantity(
        "kg", "Damping of the hull: coefficient of the sway force per |r| v.", default=-0.805, source=TABLE_4
    )
    Yr: Scalar = quantity(
        "kg m/s", "Damping of the hull: coefficient of the sway force per r.", default=-7.250, source=TABLE_4
    )
    Yvr: Scalar = quantity(
        "kg", "Damping of the hull: coefficient of the sway force per |v| r.", default=-0.845, source=TABLE_4
    )
    Yrr: Scalar = quantity(
        "kg m", "Damping of the hull: coefficient of the sway force per |r| r.", default=-3.450, source=TABLE_4
    )
    Nv: Scalar = quantity(
        "kg m/s", "Damping of the hull: coefficient of the yaw moment per v.", default=0.03130, source=TABLE_2
    )
    Nvv: Scalar = quantity(
        "kg", "Damping of the hull: coefficient of the yaw moment per |v| v.", default=3.95645, source=TABLE_2
    )
    Nrv: Scalar = quantity(
        "kg m", "Damping of the hull: coefficient of the yaw moment per |r| v.", default=0.130, source=TABLE_4
    )
    Nr: Scalar = quantity(
        "kg m^2/s", "Damping of the hull: coefficient of the yaw moment per r.", default=-1.900, source=TABLE_4
    )
    Nvr: Scalar = quantity(
        "kg m", "Damping of the hull: coefficient of the yaw moment per |v| r.", default=0.080, source=TABLE_4
    )
    Nrr: Scalar = quantity(
        "kg m^2", "Damping of the hull: coefficient of the yaw moment per |r| r.", default=-0.750, source=TABLE_4
    )

    def wrench(self, u: Any, v: Any, r: Any) -> tuple[Any, Any, Any]:
        """Return X, Y (N) and N (N m) at velocities through the water (m/s, rad/s)."""
        av, ar = jnp.abs(v), jnp.abs(r)
        X = (self.Xu + self.Xuu * jnp.abs(u) + self.Xuuu * u**2) * u
        Y = (self.Yv + self.Yvv * av + self.Yrv * ar) * v + (self.Yr + self.Yvr * av + self.Yrr * ar) * r
        N = (self.Nv + self.Nvv * av + self.Nrv * ar) * v + (self.Nr + self.Nvr * av + self.Nrr * ar) * r
        return X, Y, N


@record
class TwinScrew:
    """Two propellers side by side with equal speed, each with a rudder in its slipstream.

        T = Tnn |n| n - Tnu |n| u        n in turns per second; other coefficients astern; T never opposes n
        U = u + k (sqrt(8 T/(pi rho d^2) + u^2) - u)      flow past the rudder; U = u where u < 0
        L = (Ld delta - Ldd |delta| delta) |U| U          other coefficients where U < 0

    Not modelled: drag of the rudders; the bow thruster of [1], which is off.
    Source:  [1]; thrust coefficients of its table 2. Reconstructed: the propeller's diameter and k, from public
             programs of [1].
    """

    ahead_thrust: Scalar = quantity(
        "N s^2", "Thrust coefficient Tnn of one propeller running ahead.", default=3.65034e-3, above=0, source=TABLE_2
    )
    ahead_inflow: Scalar = quantity(
        "N s^2/m", "Inflow coefficient Tnu of one propeller running ahead.", default=1.52468e-4, low=0, source=TABLE_2
    )
    astern_thrust: Scalar = quantity(
        "N s^2", "Thrust coefficient Tnn of one propeller running astern.", default=5.10256e-3, above=0, source=TABLE_2
    )
    astern_inflow: Scalar = quantity(
        "N s^2/m", "Inflow coefficient Tnu of one propeller running astern.", default=4.55822e-2, low=0, source=TABLE_2
    )
    ahead_lift: Scalar = quantity(
        "kg/m", "Lift coefficient Ld of one rudder in flow from ahead.", default=6.43306, source="[1]"
    )
    ahead_stall: Scalar = quantity(
        "kg/m", "Stall coefficient Ldd of one rudder in flow from ahead.", default=5.83594, source="[1]"
    )
    astern_lift: Scalar = quantity(
        "kg/m", "Lift coefficient Ld of one rudder in flow from astern.", default=3.19573, source="[1]"
    )
    astern_stall: Scalar = quantity(
        "kg/m", "Stall coefficient Ldd of one rudder in flow from astern.", default=2.34356, source="[1]"
    )
    rudder_arm: Scalar = quantity(
        "m", "Distance of the rudders aft of the reference point amidships.", default=0.549, above=0, source=TABLE_1
    )
    diameter: Scalar = quantity("m", "Diameter of a propeller.", default=0.06, above=0)
    induced: Scalar = quantity(
        "1",
        "Factor k: fraction of the extra speed of a propeller's slipstream that acts on its rudder.",
        default=0.5,
        low=0,
        high=1,
    )
    density: Scalar = quantity("kg/m^3", "Density of the water.", default=1014.0, above=0)

    def thrust(self, shaft_speed: Any, u: Any) -> Any:
        """Return the thrust of one propeller (N) at a shaft speed (rad/s) and a velocity through the water (m/s)."""
        n = shaft_speed / TURN
        ahead = jnp.abs(n) * (self.ahead_thrust * n - self.ahead_inflow * u)
        astern = jnp.abs(n) * (self.astern_thrust * n - self.astern_inflow * u)
        return jnp.where(n > 0, jnp.maximum(ahead, 0.0), jnp.minimum(astern, 0.0))

    def lift(self, rudder: Any, thrust: Any, u: Any) -> Any:
        """Return the lift of one rudder (N), to starboard, at an angle (rad) behind a propeller with a thrust (N)."""
        stream = 8 * thrust / (np.pi * self.density * self.diameter**2) + u**2
        flows = stream > 0
        gain = jnp.where(flows, jnp.sqrt(jnp.where(flows, stream, 1.0)), 0.0) - u
        past = jnp.where(u < 0, u, u + self.induced * gain)
        ahead = self.ahead_lift * rudder - self.ahead_stall * jnp.abs(rudder) * rudder
        astern = self.astern_lift * rudder - self.astern_stall * jnp.abs(rudder) * rudder
        return jnp.where(past < 0, astern, ahead) * jnp.abs(past) * past

    def wrench(self, rudder: Any, shaft_speed: Any, u: Any) -> tuple[Any, Any, Any]:
        """Return X, Y (N) and N (N m) of both propellers and both rudders, about the reference point amidships."""
        T = self.thrust(shaft_speed, u)
        L = self.lift(rudder, T, u)
        return 2 * T, 2 * L, -2 * self.rudder_arm * L


@record
class WindLoad:
    """Force of the wind on the part of the vessel above the water, about the reference point amidships.

        (X, Y, N) = rho V^2/2 (cx A cos(g), cy B sin(g), cn B L sin(2 g))      g: angle from x to the direction in which
        the relative wind blows

    Source:  Fossen, "Handbook", 2021, section 10.1, for a vessel symmetric to port and starboard. Areas and
             coefficients are our own choice. The coefficients are in the middle of the handbook's ranges.
    """

    wind: Wind = part("Wind velocity over the ground, just above the water.", default=Wind())
    frontal_area: Scalar = quantity("m^2", "Area A of the vessel exposed to wind from ahead.", default=0.04, low=0)
    lateral_area: Scalar = quantity("m^2", "Area B of the vessel exposed to wind from the side.", default=0.16, low=0)
    length: Scalar = quantity("m", "Overall length L of the vessel.", default=1.255, above=0, source=TABLE_1)
    cx: Scalar = quantity("1", "Wind coefficient of the force along the hull.", default=0.7, low=0)
    cy: Scalar = quantity("1", "Wind coefficient of the force across the hull.", default=0.85, low=0)
    cn: Scalar = quantity("1", "Wind coefficient of the yaw moment.", default=0.1)

    def wrench(self, x: VesselState) -> tuple[Any, Any, Any]:
        """Return the wind forces X, Y (N) and the yaw moment N (N m) on a vessel."""
        north, east, _ = self.wind.velocity(0.0)
        c, s = jnp.cos(x.heading), jnp.sin(x.heading)
        along = c * north + s * east - x.surge_velocity
        across = c * east - s * north - x.sway_velocity
        speed2 = along**2 + across**2
        blows = speed2 > 0
        speed = jnp.where(blows, jnp.sqrt(jnp.where(blows, speed2, 1.0)), 0.0)
        q = AIR / 2
        turning = 2 * along * across  # V^2 sin(2 g)
        return (
            q * self.cx * self.frontal_area * speed * along,
            q * self.cy * self.lateral_area * speed * across,
            q * self.cn * self.lateral_area * self.length * turning,
        )


@record
class SurfaceVessel:
    """Manoeuvring model of a vessel in the plane, CyberShip II by default. Sway has no actuator.

        M nu_r' + C(nu_r) nu_r + D(nu_r) nu_r = tau        nu_r = nu - nu_c: through the water         [1]
        delta' = limit((delta_c - delta)/T_d, rate)        n' = (n_c - n)/T_n

    nu = (u, v, r) is the velocity over the ground, nu_c the velocity of the current, and tau the forces. delta is the
    rudder angle and n the propeller speed. M contains mass and added mass; C follows from M. [1] writes the equations
    about a point amidships. Here the state describes the centre of mass, which is x_g ahead of this point. Only the
    forces are computed about the point of [1].

    Frames:  W north-east-down, B at the centre of mass, x forward, y starboard.
    Valid:   calm water without waves; no roll, pitch or heave. Rudders to 35 degrees.
    Not modelled: waves, shallow water, the propellers' side force.
    Source:  [1]; current and relative velocity as in Fossen, "Handbook of marine craft hydrodynamics and motion
             control", 2nd ed., 2021, section 10.3. Rates and lags of the actuators are our own choice.
    """

    mass: Scalar = quantity("kg", "Total mass.", default=23.8, above=0, source=TABLE_1)
    inertia: Scalar = quantity(
        "kg m^2", "Moment of inertia about z at the reference point amidships.", default=1.76, above=0, source=TABLE_1
    )
    centre: Scalar = quantity(
        "m", "Distance x_g of the centre of mass ahead of the reference point amidships.", default=0.046, source=TABLE_1
    )
    added_surge: Scalar = quantity("kg", "Added mass in surge, -X_u'.", default=2.0, low=0, source=TABLE_1)
    added_sway: Scalar = quantity("kg", "Added mass in sway, -Y_v'.", default=10.0, low=0, source=TABLE_1)
    added_coupling: Scalar = quantity(
        "kg m", "Added mass coupling sway and yaw, -Y_r' = -N_v'.", default=0.0, source=TABLE_1
    )
    added_yaw: Scalar = quantity("kg m^2", "Added inertia in yaw, -N_r'.", default=1.0, low=0, source=TABLE_1)
    damping: HullDamping = part("Damping of the hull.", default=HullDamping())
    propulsion: TwinScrew = part("Propellers and rudders.", default=TwinScrew())
    current: Current = part("Water current.", default=Current())
    wind: Any = part("Wind forces on the vessel. None: no wind.", default=None, optional=WindLoad())
    rudder_limit: Scalar = quantity("rad", "Maximum angle of the rudders.", default=35 * DEG, above=0)
    rudder_rate: Scalar = quantity("rad/s", "Maximum rate of the rudders.", default=30 * DEG, above=0)
    rudder_lag: Scalar = quantity("s", "Time constant of the rudders' servo.", default=0.1, above=0)
    shaft_limit: Scalar = quantity("rad/s", "Maximum speed of the shafts.", default=2000 / 60 * TURN, above=0)
    shaft_lag: Scalar = quantity("s", "Time constant of the shafts' drive.", default=0.3, above=0)

    MAV_TYPE: ClassVar[str] = "SURFACE_BOAT"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def input_limits(self) -> dict[str, tuple[Any, Any]]:
        """Return the limits of the rudder angle (rad) and of the propeller speed (rad/s)."""
        rudder, shaft = self.rudder_limit, self.shaft_limit
        return {"rudder": (-rudder, rudder), "shaft_speed": (-shaft, shaft)}

    def dynamics(self, t: Any, x: VesselState, u: VesselControls) -> VesselState:
        """Return the time derivative of the state x (SI) under the commands of the servos."""
        du, dv, dr = self.accelerations(x)
        c, s = jnp.cos(x.heading), jnp.sin(x.heading)
        asked = jnp.clip(u.rudder, -self.rudder_limit, self.rudder_limit)
        shaft = jnp.clip(u.shaft_speed, -self.shaft_limit, self.shaft_limit)
        return VesselState(
            surge_velocity=du,
            sway_velocity=dv,
            yaw_rate=dr,
            north=c * x.surge_velocity - s * x.sway_velocity,
            east=s * x.surge_velocity + c * x.sway_velocity,
            heading=x.yaw_rate,
            rudder=jnp.clip((asked - x.rudder) / self.rudder_lag, -self.rudder_rate, self.rudder_rate),
            shaft_speed=(shaft - x.shaft_speed) / self.shaft_lag,
        )

    def accelerations(self, x: VesselState) -> tuple[Any, Any, Any]:
        """Return the time derivatives of surge and sway velocity (m/s^2) and of the yaw rate (rad/s^2)."""
        r = x.yaw_rate
        along, across = self.current.in_plane(x.heading)
        u, v = x.surge_velocity - along, x.sway_velocity - self.centre * r - across
        X, Y, N = self.wrench(x, u, v)
        m11, m22 = self.mass + self.added_surge, self.mass + self.added_sway
        m23, m33 = self.mass * self.centre + self.added_coupling, self.inertia + self.added_yaw
        momentum = m22 * v + m23 * r
        X, Y, N = X + momentum * r, Y - m11 * u * r, N - momentum * u + m11 * u * v
        determinant = m22 * m33 - m23**2
        dr = (m22 * N - m23 * Y) / determinant
        dv = (m33 * Y - m23 * N) / determinant - r * along
        return X / m11 + r * across, dv + self.centre * dr, dr

    def wrench(self, x: VesselState, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Return X, Y (N) and N (N m) of all forces about the reference point amidships.

        u, v: velocities of this point through the water (m/s).
        """
        forces = [self.damping.wrench(u, v, x.yaw_rate), self.propulsion.wrench(x.rudder, x.shaft_speed, u)]
        if self.wind is not None:
            forces.append(self.wind.wrench(x))
        X, Y, N = (sum(axis[1:], axis[0]) for axis in zip(*forces, strict=True))
        return X, Y, N

    def motion(self, t: Any, x: VesselState, u: VesselControls) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors."""
        du, dv, dr = self.accelerations(x)
        o, r = jnp.zeros_like(du), x.yaw_rate
        stack = jnp.stack
        return Motion(
            t=t,
            p_WB=stack([x.north, x.east, o]),
            attitude=stack([o, o, x.heading]),
            v_WB_B=stack([x.surge_velocity, x.sway_velocity, o]),
            w_WB_B=stack([o, o, r]),
            a_WB_B=stack([du - r * x.sway_velocity, dv + r * x.surge_velocity, o]),
            alpha_WB_B=stack([o, o, dr]),
        )
