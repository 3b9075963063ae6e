"""Rigid body over the rotating earth with six degrees of freedom, in the atmosphere or above it.

The input is a force and a moment in body axes. With an aerodynamic model, the force and moment of the air are added.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import to_euler
from trimtab.core.signals import Gust, Motion, SurroundingAir
from trimtab.core.time import to_seconds
from trimtab.environment.atmosphere import AirProperties, standard_atmosphere
from trimtab.environment.earth import Earth
from trimtab.environment.geodetic import TangentPlane, ned_axes
from trimtab.environment.wind import Wind


@record
class RigidBodyState:
    """State of a rigid body: position, velocity, attitude and angular velocity.

    Frames:  I inertial, with the z axis along the earth's axis; B fixed to the body.

    The quaternion need not have unit length. Source: Stevens, Lewis, Johnson, "Aircraft control and simulation", 1.7.
    """

    position: Any = quantity(
        "m", "Position p_I of the centre of mass relative to the earth's centre.", frame="I", shape=(3,)
    )
    velocity: Any = quantity("m/s", "Velocity of the centre of mass in I.", frame="I", shape=(3,))
    attitude: Any = quantity("1", "Quaternion q_IB, scalar first.", frame="IB", shape=(4,))
    rate: Any = quantity("rad/s", "Angular velocity of B relative to I.", frame="B", shape=(3,))


@record
class Wrench:
    """Force at the centre of mass and moment about the centre of mass. Frame: B. Source: this module."""

    force: Any = quantity("N", "Force on the body: forward, starboard, down.", frame="B", shape=(3,))
    moment: Any = quantity("N m", "Moment on the body: roll, pitch, yaw.", frame="B", shape=(3,))


NO_WRENCH = Wrench(np.zeros(3), np.zeros(3))
"""Wrench without force and moment."""


class Airflow(NamedTuple):
    """Flow of the air around a body.

    velocity: velocity of the centre of mass through the air, in B (3,) (m/s).  speed: airspeed, the length of velocity
    (m/s).
    rate: angular velocity of the body relative to the air, which rotates with the earth, in B (3,) (rad/s).
    air: air properties at the body's position.
    """

    velocity: Any
    speed: Any
    rate: Any
    air: AirProperties

    @property
    def pressure(self) -> Any:
        """Return the dynamic pressure (Pa)."""
        return self.air.density * self.speed**2 / 2

    @property
    def mach(self) -> Any:
        """Return the Mach number."""
        return self.speed / self.air.sound_speed


class FlightCondition(NamedTuple):
    """Flight state of a body.

    latitude, longitude: geodetic (rad).  height: height above the ellipsoid (m).  velocity: over the ground, in local
    north-east-down (3,) (m/s).  angles: roll, pitch, yaw of B in local north-east-down (3,) (rad).  gravity:
    acceleration of gravitation, without centrifugal acceleration (m/s²). flow: flow of the air around the body.
    """

    latitude: Any
    longitude: Any
    height: Any
    velocity: Any
    angles: Any
    gravity: Any
    flow: Airflow


@record
class BluntBody:
    """Aerodynamics of a blunt body: drag opposite to the velocity, and moments that damp the angular velocity.

        F = -q S CD v/|v|        M = q S (b Clp, c Cmq, b Cnr) (p b, q c, r b) / 2V

    Valid:   one drag coefficient at all speeds and attitudes. Not modelled: lift, side force, Mach effects.
    Source:  the form of a damping derivative: Stevens, Lewis, Johnson, "Aircraft control and simulation", 2.3.
    """

    area: Scalar = quantity("m^2", "Reference area S of the aerodynamic coefficients.", default=0.01824, above=0)
    drag: Scalar = quantity("1", "Drag coefficient CD.", default=0.1, low=0)
    span: Scalar = quantity("m", "Reference length b of the roll and yaw moments.", default=0.1, above=0)
    chord: Scalar = quantity("m", "Reference length c of the pitch moment.", default=0.1, above=0)
    roll_damping: Scalar = quantity("1", "Roll damping coefficient Clp; negative if it damps.", default=0.0)
    pitch_damping: Scalar = quantity("1", "Pitch damping coefficient Cmq; negative if it damps.", default=0.0)
    yaw_damping: Scalar = quantity("1", "Yaw damping coefficient Cnr; negative if it damps.", default=0.0)

    def wrench(self, flow: Airflow) -> Wrench:
        """Return force and moment of the air. Both are zero at zero airspeed."""
        moves = flow.speed > 0
        qS_over_V = flow.air.density * flow.speed / 2 * self.area
        lengths = jnp.stack([self.span, self.chord, self.span]) * jnp.ones(3)
        damping = jnp.stack([self.roll_damping, self.pitch_damping, self.yaw_damping]) * jnp.ones(3)
        force = -qS_over_V * self.drag * flow.velocity
        moment = qS_over_V * damping * lengths**2 * flow.rate / 2
        return Wrench(jnp.where(moves, force, 0.0), jnp.where(moves, moment, 0.0))


@record
class RigidBody:
    """Rigid body of constant mass over the rotating earth.

        p_I' = v_I        v_I' = g(p_I) + R_IB F/m        q_IB' = q_IB (0, w)/2        J w' = M - w × J w

    F and M are the force and moment of the input plus, with an aerodynamic model, those of the air. The air rotates
    with the earth; wind and the turbulence of the world are added to its velocity.

    Frames:  I inertial and E earth-fixed, which coincide at time zero; W north-east-down, fixed to the earth
             at `origin`; B at the centre of mass, x forward, y starboard, z down.
    Valid:   a rigid body with constant mass, anywhere outside the earth. Not modelled: fuel, sloshing, ground.
    Source:  Stevens, Lewis, Johnson, "Aircraft control and simulation", 3rd ed., eq. 1.7-21; compared with
             simulations of NASA in the study nesc2015.
    """

    mass: Scalar = quantity("kg", "Mass of the body.", default=1.0, above=0)
    inertia: Any = quantity(
        "kg m^2",
        "Moments of inertia Jx, Jy, Jz about the axes of B.",
        frame="B",
        shape=(3,),
        default=np.array([0.1, 0.1, 0.1]),
    )
    products: Any = quantity(
        "kg m^2",
        "Products of inertia Jxy, Jyz, Jzx: the integrals of x y, y z and z x over the mass.",
        frame="B",
        shape=(3,),
        default=np.zeros(3),
    )
    earth: Earth = part("Earth: gravitation and rotation.", default=Earth())
    wind: Wind = part("Wind velocity over the ground.", default=Wind())
    aerodynamics: Any = part("Model of the aerodynamic forces. None: no air.", default=None)
    origin: TangentPlane = part(
        "Origin of the local frame W: latitude, longitude and height on the earth.", default=TangentPlane(0.0, 0.0)
    )
    gust: Any = part("Gust added to the wind. A world with turbulence sets this field. None: no gust.", default=None)

    MAV_TYPE: ClassVar[str] = "GENERIC"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""
    QUATERNIONS: ClassVar[tuple[str, ...]] = ("attitude",)
    """Quaternion fields of the state, for an integration on the rotation group."""

    def check(self) -> None:
        """Raise InputError for moments and products of inertia that are physically impossible."""
        moments = np.linalg.eigvalsh(np.asarray(self.inertia_matrix()))
        if moments[0] <= 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-9):
            problem = f"principal moments of inertia of {np.round(moments, 9).tolist()} are not possible for a body"
            raise InputError("inertia", problem, fix="give moments above 0, none greater than the sum of the other two")

    def inertia_matrix(self) -> Any:
        """Return the inertia matrix J (3, 3) in B."""
        (x, y, z), (xy, yz, zx) = self.inertia, self.products
        rows = ([x, -xy, -zx], [-xy, y, -yz], [-zx, -yz, z])
        return jnp.stack([jnp.stack([jnp.asarray(e, float) for e in row]) for row in rows])

    def in_gust(self, gust: Gust) -> "RigidBody":
        """Return the rigid body with this gust added to the wind."""
        return replace(self, gust=gust)

    def flight(self, t: Any, x: RigidBodyState) -> FlightCondition:
        """Return the flight state at time t (s): latitude, longitude, height, velocity, angles and airflow."""
        R_EI = self.earth.to_inertial(t).T
        p_E = R_EI @ x.position
        latitude, longitude, height = self.earth.geodetic(p_E)
        R_NI = ned_axes(latitude, longitude).T @ R_EI
        R_IB = quaternion.to_matrix(x.attitude)
        over_ground = x.velocity - self._turn(x.position)
        wind = self.wind.velocity(height)
        through_air = R_IB.T @ (over_ground - R_NI.T @ wind)
        turning = R_IB.T @ jnp.array([0.0, 0.0, 1.0]) * self.earth.rate
        if self.gust is not None:
            through_air, turning = through_air - self.gust.velocity, turning + self.gust.rate
        speed2 = through_air @ through_air
        speed = jnp.where(speed2 > 0, jnp.sqrt(jnp.where(speed2 > 0, speed2, 1.0)), 0.0)
        flow = Airflow(through_air, speed, x.rate - turning, standard_atmosphere(height))
        g = self.earth.gravitation(x.position)
        return FlightCondition(
            latitude, longitude, height, R_NI @ over_ground, to_euler(R_NI @ R_IB), jnp.sqrt(g @ g), flow
        )

    def dynamics(self, t: Any, x: RigidBodyState, u: Wrench) -> RigidBodyState:
        """Return the time derivative of the state x at time t (s), under the force and moment u."""
        acceleration, turn = self.accelerations(t, x, u)
        return RigidBodyState(
            position=x.velocity,
            velocity=self.earth.gravitation(x.position) + acceleration,
            attitude=quaternion.rate(x.attitude, x.rate),
            rate=turn,
        )

    def accelerations(self, t: Any, x: RigidBodyState, u: Wrench) -> tuple[Any, Any]:
        """Return specific force at the centre of mass in I (3,) (m/s²), and angular acceleration in B (3,) (rad/s²)."""
        force, moment = u.force, u.moment
        if self.aerodynamics is not None:
            of_air = self.aerodynamics.wrench(self.flight(t, x).flow)
            force, moment = force + of_air.force, moment + of_air.moment
        J = self.inertia_matrix()
        turn = _solve_symmetric(J, moment - jnp.cross(x.rate, J @ x.rate))
        return quaternion.to_matrix(x.attitude) @ force / self.mass, turn

    def motion(self, t: Any, x: RigidBodyState, u: Wrench) -> Motion:
        """Return the motion of the body at time t (unit: 100 ns), for sensors, in the tangent plane at `origin`."""
        seconds = to_seconds(t)
        R_EI = self.earth.to_inertial(seconds).T
        plane = self.origin
        R_WI = ned_axes(plane.latitude, plane.longitude).T @ R_EI
        R_BI = quaternion.to_matrix(x.attitude).T
        R_WB = R_WI @ R_BI.T
        p_origin = self.earth.place(plane.latitude, plane.longitude, plane.height)
        felt, turn = self.accelerations(seconds, x, u)
        w_IW = jnp.stack([jnp.zeros_like(self.earth.rate), jnp.zeros_like(self.earth.rate), self.earth.rate])
        v_W = x.velocity - jnp.cross(w_IW, x.position)
        inertial = self.earth.gravitation(x.position) + felt
        a_W = inertial - 2 * jnp.cross(w_IW, v_W) - jnp.cross(w_IW, jnp.cross(w_IW, x.position))
        w_IW_B = R_BI @ w_IW
        flight = self.flight(seconds, x)
        return Motion(
            t=t,
            p_WB=R_WI @ x.position - ned_axes(plane.latitude, plane.longitude).T @ p_origin,
            attitude=to_euler(R_WB),
            v_WB_B=R_BI @ v_W,
            w_WB_B=x.rate - w_IW_B,
            a_WB_B=R_BI @ a_W,
            alpha_WB_B=turn + jnp.cross(x.rate, w_IW_B),
            air=SurroundingAir(
                height=flight.height,
                velocity=R_BI @ v_W - flight.flow.velocity,
                rate=x.rate - flight.flow.rate - w_IW_B,
            ),
        )

    def start(
        self, latitude: Any, longitude: Any, height: Any, *, velocity: Any, angles: Any, rate: Any, over_ground: bool
    ) -> RigidBodyState:
        """Return the initial state at time zero from a geodetic position, velocity, attitude and angular velocity.

        Args:
            latitude, longitude: geodetic (rad).
            height: height above the ellipsoid (m).
            velocity: velocity over the ground, in local north-east-down (3,) (m/s).
            angles: roll, pitch, yaw in local north-east-down (3,) (rad).
            rate: angular velocity in B (3,) (rad/s). over_ground: True if rate is relative to the ground, False if
            relative to I.
        """
        p = self.earth.place(latitude, longitude, height)
        R_IN = ned_axes(jnp.asarray(latitude, float), jnp.asarray(longitude, float))
        q = quaternion.multiply(quaternion.from_matrix(R_IN), quaternion.from_euler(*jnp.asarray(angles, float)))
        v = R_IN @ jnp.asarray(velocity, float) + self._turn(p)
        w = jnp.asarray(rate, float)
        if over_ground:
            w = w + quaternion.to_matrix(q).T @ jnp.array([0.0, 0.0, 1.0]) * self.earth.rate
        return RigidBodyState(p, v, q, w)

    def _turn(self, p_I: Any) -> Any:
        """Return the velocity (3,) in I of a point that rotates with the earth."""
        return self.earth.rate * jnp.stack([-p_I[1], p_I[0], jnp.zeros_like(p_I[0])])


def _solve_symmetric(J: Any, b: Any) -> Any:
    """Return J^-1 b (3,) for a symmetric matrix J (3, 3), by cofactors."""
    rows = (jnp.cross(J[1], J[2]), jnp.cross(J[2], J[0]), jnp.cross(J[0], J[1]))
    return (b[0] * rows[0] + b[1] * rows[1] + b[2] * rows[2]) / (J[0] @ rows[0])
