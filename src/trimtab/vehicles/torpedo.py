"""Torpedo-shaped underwater vehicle REMUS in six degrees of freedom, with the coefficients of the simulation in [1].

[1] is T. Prestero, "Verification of a six-degree of freedom simulation model for the REMUS autonomous underwater
vehicle", Massachusetts Institute of Technology and Woods Hole Oceanographic Institution, 2001.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.linalg import solve_spd
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import DEG, to_euler
from trimtab.core.signals import Motion
from trimtab.environment.current import Current

TABLES = "[1] appendix B"
RPM = np.pi / 30
"""One revolution per minute, in rad/s."""
CRUISE = 1500 * RPM
"""Shaft speed for which [1] states thrust and torque (rad/s)."""
DOWN = np.array([0.0, 0.0, 1.0])


@record
class TorpedoControls:
    """Commands of the torpedo's servos and motor. Source: [1] section 4.5."""

    rudder: Scalar = quantity(
        "rad", "Commanded angle of both rudder fins; positive pushes the tail to starboard.", kind="angle"
    )
    stern: Scalar = quantity("rad", "Commanded angle of both stern planes; positive pushes the tail up.", kind="angle")
    shaft_speed: Scalar = quantity("rad/s", "Commanded speed of the propeller; positive drives ahead.")


@record
class TorpedoState:
    """State of the torpedo: position, attitude, velocity over ground, angular velocity, fin angles, propeller speed.

    Source:  [1] section 3.2.
    """

    position: Any = quantity("m", "Position: north, east, depth.", frame="W", shape=(3,), default=np.zeros(3))
    attitude: Any = quantity(
        "1", "Attitude: quaternion q_WB, scalar first.", frame="WB", shape=(4,), default=np.array([1.0, 0.0, 0.0, 0.0])
    )
    velocity: Any = quantity(
        "m/s", "Velocity over the ground: surge, sway, heave.", frame="B", shape=(3,), default=np.zeros(3)
    )
    rate: Any = quantity(
        "rad/s", "Angular velocity: roll, pitch, yaw rate.", frame="B", shape=(3,), default=np.zeros(3)
    )
    rudder: Scalar = quantity("rad", "Angle of the rudder fins.", kind="angle", default=0.0)
    stern: Scalar = quantity("rad", "Angle of the stern planes.", kind="angle", default=0.0)
    shaft_speed: Scalar = quantity("rad/s", "Speed of the propeller.", default=0.0)


@record
class TorpedoHull:
    """Added mass and the forces of the water on hull and fins, about the centre of buoyancy.

    Names follow SNAME: Zuw is the force Z per u w, Zww per |w| w, Zwdot per w'. For the rudder, Yuudr is the force Y
    per u^2 and rudder angle.

    Frames:  B, through the water.
    Valid:   near 1.5 m/s, small angles of attack, no stall.
    Source:  [1] appendix B, as used in its simulation. Some values are multiplied by factors that [1] chose after sea
             trials (docs page).
    """

    Xudot: Scalar = quantity("kg", "Added mass along the body's x axis.", default=-0.93, source=TABLES)
    Yvdot: Scalar = quantity(
        "kg",
        "Added mass along the body's y axis. The added mass along z is equal (Zwdot = Yvdot).",
        default=-35.5,
        source=TABLES,
    )
    Yrdot: Scalar = quantity(
        "kg m", "Added mass coupling sway and yaw; equal to Nvdot, -Zqdot and -Mwdot.", default=1.93, source=TABLES
    )
    Kpdot: Scalar = quantity("kg m^2", "Added moment of inertia in roll.", default=-0.0704, source=TABLES)
    Mqdot: Scalar = quantity(
        "kg m^2", "Added moment of inertia in pitch, and in yaw (Nrdot).", default=-4.88, source=TABLES
    )
    Xuu: Scalar = quantity(
        "kg/m", "Coefficient of the surge force per |u| u: axial drag.", default=-1.62, source=TABLES
    )
    Xwq: Scalar = quantity("kg", "Coefficient of the surge force per w q: added mass.", default=-35.5, source=TABLES)
    Xqq: Scalar = quantity("kg m", "Coefficient of the surge force per q^2: added mass.", default=-1.93, source=TABLES)
    Xvr: Scalar = quantity("kg", "Coefficient of the surge force per v r: added mass.", default=35.5, source=TABLES)
    Xrr: Scalar = quantity("kg m", "Coefficient of the surge force per r^2: added mass.", default=-1.93, source=TABLES)
    Yvv: Scalar = quantity(
        "kg/m", "Coefficient of the sway force per |v| v: cross-flow drag.", default=-1310.0, source=TABLES
    )
    Yrr: Scalar = quantity(
        "kg m", "Coefficient of the sway force per |r| r: cross-flow drag.", default=0.632, source=TABLES
    )
    Yuv: Scalar = quantity(
        "kg/m", "Coefficient of the sway force per u v: body and fin lift.", default=-28.6, source=TABLES
    )
    Ywp: Scalar = quantity("kg", "Coefficient of the sway force per w p: added mass.", default=35.5, source=TABLES)
    Yur: Scalar = quantity(
        "kg", "Coefficient of the sway force per u r: added mass and fin lift.", default=5.22, source=TABLES
    )
    Ypq: Scalar = quantity("kg m", "Coefficient of the sway force per p q: added mass.", default=1.93, source=TABLES)
    Yuudr: Scalar = quantity(
        "kg/(m rad)", "Coefficient of the sway force per u^2 and rudder angle.", default=9.64, source=TABLES
    )
    Zww: Scalar = quantity(
        "kg/m", "Coefficient of the heave force per |w| w: cross-flow drag.", default=-131.0, source=TABLES
    )
    Zqq: Scalar = quantity(
        "kg m", "Coefficient of the heave force per |q| q: cross-flow drag.", default=-0.632, source=TABLES
    )
    Zuw: Scalar = quantity(
        "kg/m", "Coefficient of the heave force per u w: body and fin lift.", default=-28.6, source=TABLES
    )
    Zuq: Scalar = quantity(
        "kg", "Coefficient of the heave force per u q: added mass and fin lift.", default=-5.22, source=TABLES
    )
    Zvp: Scalar = quantity("kg", "Coefficient of the heave force per v p: added mass.", default=-35.5, source=TABLES)
    Zrp: Scalar = quantity("kg m", "Coefficient of the heave force per r p: added mass.", default=1.93, source=TABLES)
    Zuuds: Scalar = quantity(
        "kg/(m rad)", "Coefficient of the heave force per u^2 and stern plane angle.", default=-9.64, source=TABLES
    )
    Kpp: Scalar = quantity(
        "kg m^2", "Coefficient of the roll moment per |p| p: rolling drag.", default=-0.130, source=TABLES
    )
    Mww: Scalar = quantity(
        "kg", "Coefficient of the pitch moment per |w| w: cross-flow drag.", default=3.18, source=TABLES
    )
    Mqq: Scalar = quantity(
        "kg m^2", "Coefficient of the pitch moment per |q| q: cross-flow drag.", default=-188.0, source=TABLES
    )
    Muw: Scalar = quantity(
        "kg",
        "Coefficient of the pitch moment per u w: body and fin lift, and Munk's moment.",
        default=24.0,
        source=TABLES,
    )
    Muq: Scalar = quantity(
        "kg m", "Coefficient of the pitch moment per u q: added mass and fin lift.", default=-2.0, source=TABLES
    )
    Mvp: Scalar = quantity("kg m", "Coefficient of the pitch moment per v p: added mass.", default=-1.93, source=TABLES)
    Mrp: Scalar = quantity(
        "kg m^2", "Coefficient of the pitch moment per r p: added mass.", default=4.86, source=TABLES
    )
    Muuds: Scalar = quantity(
        "kg/rad", "Coefficient of the pitch moment per u^2 and stern plane angle.", default=-6.15, source=TABLES
    )
    Nvv: Scalar = quantity(
        "kg", "Coefficient of the yaw moment per |v| v: cross-flow drag.", default=-3.18, source=TABLES
    )
    Nrr: Scalar = quantity(
        "kg m^2", "Coefficient of the yaw moment per |r| r: cross-flow drag.", default=-94.0, source=TABLES
    )
    Nuv: Scalar = quantity(
        "kg",
        "Coefficient of the yaw moment per u v: body and fin lift, and Munk's moment.",
        default=-24.0,
        source=TABLES,
    )
    Nur: Scalar = quantity(
        "kg m", "Coefficient of the yaw moment per u r: added mass and fin lift.", default=-2.0, source=TABLES
    )
    Nwp: Scalar = quantity("kg m", "Coefficient of the yaw moment per w p: added mass.", default=-1.93, source=TABLES)
    Npq: Scalar = quantity("kg m^2", "Coefficient of the yaw moment per p q: added mass.", default=-4.86, source=TABLES)
    Nuudr: Scalar = quantity(
        "kg/rad", "Coefficient of the yaw moment per u^2 and rudder angle.", default=-6.15, source=TABLES
    )

    def wrench(self, velocity: Any, rate: Any, rudder: Any, stern: Any) -> tuple[Any, Any]:
        """Return force (3,) (N) and moment (3,) (N m) of the water, without the added mass terms that contain
        accelerations."""
        (u, v, w), (p, q, r) = velocity, rate
        av, aw, aq, ar = jnp.abs(v), jnp.abs(w), jnp.abs(q), jnp.abs(r)
        X = self.Xuu * jnp.abs(u) * u + self.Xwq * w * q + self.Xqq * q**2 + self.Xvr * v * r + self.Xrr * r**2
        Y = self.Yvv * av * v + self.Yrr * ar * r + self.Yuv * u * v + self.Ywp * w * p + self.Yur * u * r
        Y = Y + self.Ypq * p * q + self.Yuudr * u**2 * rudder
        Z = self.Zww * aw * w + self.Zqq * aq * q + self.Zuw * u * w + self.Zuq * u * q + self.Zvp * v * p
        Z = Z + self.Zrp * r * p + self.Zuuds * u**2 * stern
        M = self.Mww * aw * w + self.Mqq * aq * q + self.Muw * u * w + self.Muq * u * q + self.Mvp * v * p
        M = M + self.Mrp * r * p + self.Muuds * u**2 * stern
        N = self.Nvv * av * v + self.Nrr * ar * r + self.Nuv * u * v + self.Nur * u * r + self.Nwp * w * p
        N = N + self.Npq * p * q + self.Nuudr * u**2 * rudder
        return jnp.stack([X, Y, Z]), jnp.stack([self.Kpp * jnp.abs(p) * p, M, N])


@record
class Torpedo:
    """Underwater vehicle REMUS with rudder, stern planes and one propeller.

        m (v' + w' x r + w x v + w x (w x r)) = f        I w' + w x I w + m r x (v' + w x v) = g        [1, eq. 3.8]
        f, g: force and moment of weight, buoyancy, propeller, and water on hull and fins               [1, eq. 4.49]

    v is the velocity of the centre of buoyancy through the water, w the angular velocity. r points from the centre of
    buoyancy down to the centre of mass. The state describes the centre of mass. Thrust and torque of the propeller are
    assumed proportional to the square of its speed, because [1] has values for one speed only.

    Frames:  W north-east-down from the surface, B at the centre of mass, x forward, y starboard, z down.
    Valid:   deep water, any attitude, 1.0 to 2.0 m/s, angles of attack within 15 degrees.
    Not modelled: waves, the surface, stall of the fins, inflow to the propeller.
    Source:  [1]; current as in Fossen, "Handbook of marine craft hydrodynamics and motion control", 2nd ed., 2021,
             section 10.3. Lags and rates of the actuators, and the gravity that converts the weight of [1] to a mass,
             are our own choice.
    """

    weight: Scalar = quantity(
        "N", "Weight; the mass is the weight divided by 9.81 m/s^2.", default=299.0, above=0, source="[1] table 2.3"
    )
    buoyancy: Scalar = quantity("N", "Buoyant force.", default=306.0, above=0, source="[1] table 2.3")
    inertia: Any = quantity(
        "kg m^2", "Moments of inertia Ixx, Iyy, Izz about the centre of buoyancy.", frame="B", shape=(3,),
        default=np.array([0.177, 3.45, 3.45]), source="[1] chapter 2",
    )  # fmt: skip
    lowered: Scalar = quantity(
        "m", "Distance z_g of the centre of mass below the centre of buoyancy.", default=0.0196, source="[1] chapter 2"
    )
    hull: TorpedoHull = part("Hydrodynamic coefficients of hull and fins.", default=TorpedoHull())
    thrust: Scalar = quantity("N", "Thrust of the propeller at 1500 rpm.", default=3.86, low=0, source="[1] table C.9")
    torque: Scalar = quantity(
        "N m", "Torque of the propeller on the hull at 1500 rpm.", default=-0.543, source="[1] table C.9"
    )
    current: Current = part("Water current.", default=Current())
    fin_limit: Scalar = quantity(
        "rad", "Maximum angle of the fins.", default=13.6 * DEG, above=0, source="[1] table 2.2"
    )
    fin_rate: Scalar = quantity("rad/s", "Maximum rate of the fins.", default=60 * DEG, above=0)
    fin_lag: Scalar = quantity("s", "Time constant of the fins' servos.", default=0.1, above=0)
    shaft_limit: Scalar = quantity("rad/s", "Maximum speed of the shaft.", default=2000 * RPM, above=0)
    shaft_lag: Scalar = quantity("s", "Time constant of the shaft's drive.", default=0.3, above=0)

    MAV_TYPE: ClassVar[str] = "SUBMARINE"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    @property
    def mass(self) -> Any:
        """Return the mass of the vehicle (kg)."""
        return self.weight / 9.81

    def input_limits(self) -> dict[str, tuple[Any, Any]]:
        """Return the limits of the fin angles (rad) and of the propeller speed (rad/s)."""
        fins, shaft = (-self.fin_limit, self.fin_limit), self.shaft_limit
        return {"rudder": fins, "stern": fins, "shaft_speed": (-shaft, shaft)}

    def dynamics(self, t: Any, x: TorpedoState, u: TorpedoControls) -> TorpedoState:
        """Return the time derivative of the state x (SI) under the commands of servos and motor."""
        velocity, rate = self.accelerations(x)
        shaft = jnp.clip(u.shaft_speed, -self.shaft_limit, self.shaft_limit)
        return TorpedoState(
            position=quaternion.rotate(x.attitude, x.velocity),
            attitude=quaternion.rate(x.attitude, x.rate),
            velocity=velocity,
            rate=rate,
            rudder=self._move_fin(x.rudder, u.rudder),
            stern=self._move_fin(x.stern, u.stern),
            shaft_speed=(shaft - x.shaft_speed) / self.shaft_lag,
        )

    def _move_fin(self, angle: Any, asked: Any) -> Any:
        """Return the rate (rad/s) at which a fin moves from its angle towards the commanded angle."""
        way = jnp.clip(asked, -self.fin_limit, self.fin_limit) - angle
        return jnp.clip(way / self.fin_lag, -self.fin_rate, self.fin_rate)

    def accelerations(self, x: TorpedoState) -> tuple[Any, Any]:
        """Return the time derivatives of velocity (3,) (m/s^2) and angular velocity (3,) (rad/s^2), both in B."""
        R_BW = quaternion.to_matrix(x.attitude).T
        water, w = self.current.in_body(R_BW), x.rate
        arm = self.lowered * DOWN
        v = x.velocity - jnp.cross(w, arm) - water
        force, moment = self.wrench(x, v, R_BW)
        turning = jnp.cross(w, v)
        force = force - self.mass * (turning + jnp.cross(w, jnp.cross(w, arm)))
        moment = moment - jnp.cross(w, self.inertia * w) - self.mass * jnp.cross(arm, turning)
        dv, dw = self._solve(force, moment)
        return dv - jnp.cross(w, water) + jnp.cross(dw, arm), dw

    def wrench(self, x: TorpedoState, v: Any, R_BW: Any) -> tuple[Any, Any]:
        """Return force (3,) (N) and moment (3,) (N m) about the centre of buoyancy, which moves at v (3,) through the
        water."""
        force, moment = self.hull.wrench(v, x.rate, x.rudder, x.stern)
        down = R_BW[:, 2]
        force = force + (self.weight - self.buoyancy) * down
        moment = moment + jnp.cross(self.lowered * DOWN, self.weight * down)
        share = jnp.abs(x.shaft_speed) * x.shaft_speed / CRUISE**2
        ahead = jnp.stack([share, 0 * share, 0 * share])
        return force + self.thrust * ahead, moment + self.torque * ahead

    def _solve(self, force: Any, moment: Any) -> tuple[Any, Any]:
        """Return the accelerations v' (3,), w' (3,). The equations of (u, w, q) and of (v, p, r) are independent."""
        m, h, mz = self.mass, self.hull, self.mass * self.lowered
        (Ix, Iy, Iz), o = self.inertia, 0.0
        across = m - h.Yvdot

        def solve(rows: Any, right: Any) -> Any:
            return solve_spd(jnp.stack([jnp.stack([jnp.asarray(e, float) for e in row]) for row in rows]), right)

        level = ([m - h.Xudot, o, mz], [o, across, h.Yrdot], [mz, h.Yrdot, Iy - h.Mqdot])
        du, dw, dq = solve(level, jnp.stack([force[0], force[2], moment[1]]))
        side = ([across, -mz, -h.Yrdot], [-mz, Ix - h.Kpdot, o], [-h.Yrdot, o, Iz - h.Mqdot])
        dv, dp, dr = solve(side, jnp.stack([force[1], moment[0], moment[2]]))
        return jnp.stack([du, dv, dw]), jnp.stack([dp, dq, dr])

    def after_step(self, t: Any, x: TorpedoState) -> TorpedoState:
        """Return the state with its quaternion normalised."""
        return replace(x, attitude=quaternion.normalise(x.attitude))

    def motion(self, t: Any, x: TorpedoState, u: TorpedoControls) -> Motion:
        """Return the motion of the centre of mass at time t (unit: 100 ns), for sensors."""
        dv, dw = self.accelerations(x)
        return Motion(
            t=t,
            p_WB=x.position,
            attitude=to_euler(quaternion.to_matrix(x.attitude)),
            v_WB_B=x.velocity,
            w_WB_B=x.rate,
            a_WB_B=dv + jnp.cross(x.rate, x.velocity),
            alpha_WB_B=dw,
        )
