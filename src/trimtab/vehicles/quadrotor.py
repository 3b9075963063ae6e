"""Multirotor with n rotors over flat ground: quadrotor, hexarotor or any other arrangement, set by its parameters."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, quantity, record
from trimtab.core.rotation import to_euler
from trimtab.core.signals import Motion
from trimtab.environment.wind import Wind

SHORTEST_LAG = 0.005
"""Smallest time constant (s) used for the state `rotor_speed`. If `lag` is 0, rotor speeds follow commands at once."""


@record
class MultirotorState:
    """State of a multirotor: position, velocity, attitude, angular rate and rotor speeds.

    Frames:  W north-east-down, B fixed to the body.

    The quaternion is normalised after each step. Source: this module.
    """

    position: Any = quantity("m", "Position of the centre of mass.", frame="W", shape=(3,), default=(0.0, 0.0, 0.0))
    velocity: Any = quantity("m/s", "Velocity of the centre of mass.", frame="W", shape=(3,), default=(0.0, 0.0, 0.0))
    attitude: Any = quantity("1", "Quaternion q_WB, scalar first.", frame="WB", shape=(4,), default=(1.0, 0, 0, 0))
    rate: Any = quantity(
        "rad/s", "Angular velocity of the body relative to W.", frame="B", shape=(3,), default=(0.0, 0.0, 0.0)
    )
    rotor_speed: Any = quantity("rad/s", "Speed of each rotor (n,); negative in reverse.", default=(0.0, 0.0, 0.0, 0.0))


@record
class RotorSpeeds:
    """Desired rotor speeds; command and input of a multirotor. Source: this module."""

    speed: Any = quantity(
        "rad/s", "Desired speed of each rotor (n,); negative in reverse.", default=(0.0, 0.0, 0.0, 0.0)
    )


@record
class RotorDemand:
    """Total thrust and moments demanded by a law. Frame: B. Source: this module."""

    thrust: Scalar = quantity("N", "Total thrust of the rotors, against the body's z axis.", frame="B")
    moment: Any = quantity("N m", "Demanded moments in roll, pitch and yaw.", frame="B", shape=(3,))
    working: Any = quantity("1", "True for each rotor that is assumed to work (n,).", kind="flag", default=(True,) * 4)


@record
class Rotors:
    """Rotors of a multirotor: positions, directions of rotation, thrust and torque.

    All rotors thrust against the body's z axis.

        T = k w |w|        Q = -s c T

    w: speed of a rotor.  T: thrust of the rotor.  Q: moment about z on the body due to the rotor's rotation.

    Frames:  positions in B from the centre of mass; s = +1 for rotation about +z (clockwise from above), else -1.
    Valid:   near hover. Not modelled: inflow, ground effect, flapping (except for its drag), interference of wakes.
    Source:  [1] T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010,
             sections II and V for positions, directions of rotation and c. The thrust coefficient is our own choice.
    """

    places: Any = quantity(
        "m",
        "Position of each rotor's hub (n, 3).",
        frame="B",
        default=np.array([[0.315, 0, 0], [0, 0.315, 0], [-0.315, 0, 0], [0, -0.315, 0]]),
        source="[1] d = 0.315",
    )
    spins: Any = quantity(
        "1",
        "Direction of rotation of each rotor (n,): 1 clockwise from above, -1 counter-clockwise.",
        default=np.array([1.0, -1, 1, -1]),
    )
    thrust_coefficient: Scalar = quantity(
        "N s^2/rad^2", "Coefficient k: thrust per rotor speed squared.", default=8e-5, above=0
    )
    torque_ratio: Scalar = quantity(
        "m", "Coefficient c: torque per thrust of a rotor.", default=8.004e-4, low=0, source="[1] section V"
    )
    inertia: Scalar = quantity("kg m^2", "Moment of inertia of each rotor about its shaft.", default=0.0, low=0)

    def check(self) -> None:
        """Raise InputError if `places` does not have one row for each element of `spins`, or if `spins` contains a
        value other than 1 and -1."""
        n = np.size(self.spins)
        if np.shape(self.places) != (n, 3) or np.ndim(self.spins) != 1:
            problem = f"{n} rotors (spins) need positions (places) of shape ({n}, 3), got {np.shape(self.places)}"
            raise InputError("places", problem, fix=f"give {n} positions of three numbers each")
        if not (np.abs(self.spins) == 1).all():
            raise InputError(
                "spins",
                f"spins must be 1 or -1, got {np.asarray(self.spins).tolist()}",
                fix="give 1 or -1 for each rotor",
            )

    def effectiveness(self) -> Any:
        """Return the matrix (4, n) of total thrust and moments about x, y, z per newton of thrust of each rotor."""
        x, y = jnp.asarray(self.places)[:, 0], jnp.asarray(self.places)[:, 1]
        return jnp.stack([jnp.ones_like(x), -y, x, -jnp.asarray(self.spins) * self.torque_ratio])

    def thrusts(self, speed: Any) -> Any:
        """Return the thrust of each rotor (N) at the rotor's speed (rad/s)."""
        return self.thrust_coefficient * speed * jnp.abs(speed)

    def speeds(self, thrust: Any) -> Any:
        """Return the speed of each rotor (rad/s) for the rotor's thrust (N)."""
        some = thrust != 0
        root = jnp.sqrt(jnp.abs(jnp.where(some, thrust, 1.0)) / self.thrust_coefficient)
        return jnp.where(some, jnp.sign(thrust) * root, 0.0)

    def angular_momentum(self, speed: Any) -> Any:
        """Return the angular momentum of all rotors about z (N m s)."""
        return self.inertia * jnp.sum(jnp.asarray(self.spins) * speed)


@record
class Multirotor:
    """Multirotor: a rigid body with n rotors that thrust against its z axis.

    Position and yaw can be controlled, but tilt cannot be controlled independently.

        p' = v      m v' = m g e3 - T R e3 - R D R.T (v - wind)      q' = q (0, w)/2
        J w' = M - w × (J w + h e3) - D_w w      omega_i' = (u_i - omega_i)/lag

    p, v: position and velocity in W.  q, R: attitude as quaternion and as matrix.  w: angular rate in B.  omega_i,
    u_i: actual and commanded speed of rotor i.  T, M, h: thrust, moment and angular momentum of all rotors.
    D, D_w: coefficients of drag and of rotational damping.

    The defaults are those of the quadrotor of [1], which has no drag, no lag and no angular momentum of the rotors. The
    torque ratio c is the value printed in [1]. With this small value, the yaw moment is small.

    Frames:  W north-east-down, flat ground; B at the centre of mass, x forward, y starboard, z down.
    Valid:   constant gravity and air density. Not modelled: ground, reaction torque of a change of rotor speed.
    Source:  [1] T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010,
             eqs. 2-5; [2] M. W. Mueller, R. D'Andrea, "Stability and control of a quadrocopter despite the complete
             loss of one, two, or three propellers", ICRA 2014, for h and D_w; [3] M. Faessler, A. Franchi,
             D. Scaramuzza, "Differential flatness of quadrotor dynamics subject to rotor drag", RA-L 2018, for D.
    """

    mass: Scalar = quantity("kg", "Mass of the craft.", default=4.34, above=0, source="[1] section V")
    inertia: Any = quantity(
        "kg m^2",
        "Moments of inertia about the body's x, y and z axes.",
        frame="B",
        shape=(3,),
        default=np.array([0.0820, 0.0845, 0.1377]),
        above=0,
        source="[1] section V",
    )
    gravity: Scalar = quantity("m/s^2", "Gravitational acceleration, downward.", default=9.81, low=0)
    rotors: Rotors = part("Rotors of the craft.", default=Rotors())
    lag: Scalar = imperfection("s", "Time constant of each rotor's speed.", "motor-lag")
    drag: Any = quantity(
        "N s/m",
        "Coefficients of drag along x, y, z: force per airspeed, for body and rotors together.",
        frame="B",
        shape=(3,),
        default=np.zeros(3),
        low=0,
        off={"rotor-drag": np.zeros(3)},
    )
    turning_drag: Any = quantity(
        "N m s",
        "Coefficients of damping about x, y, z: moment per angular rate, for body and rotors together.",
        frame="B",
        shape=(3,),
        default=np.zeros(3),
        low=0,
    )
    wind: Wind = part("Wind velocity over the ground.", default=Wind(), off={"wind": Wind()})

    MAV_TYPE: ClassVar[str] = "QUADROTOR"
    """Vehicle type reported to ground stations: a name in `vehicle_type.VehicleType`."""

    def acting_speed(self, x: MultirotorState, u: RotorSpeeds) -> Any:
        """Return the rotor speeds that act (n,) (rad/s): the state's rotor speeds, or the commanded speeds if the lag
        is 0."""
        return jnp.where(self.lag > 0, x.rotor_speed, u.speed)

    def accelerations(self, x: MultirotorState, u: RotorSpeeds) -> tuple[Any, Any]:
        """Return the acceleration of the centre of mass in W (3,) (m/s^2) and the angular acceleration in B (3,)
        (rad/s^2)."""
        speed = self.acting_speed(x, u)
        wrench = self.rotors.effectiveness() @ self.rotors.thrusts(speed)
        R = quaternion.to_matrix(x.attitude)
        through_air = R.T @ (x.velocity - self.wind.velocity(-x.position[2]))
        down = jnp.array([0.0, 0.0, 1.0])
        force = -wrench[0] * down - jnp.asarray(self.drag) * through_air
        J = jnp.asarray(self.inertia)
        momentum = J * x.rate + self.rotors.angular_momentum(speed) * down
        moment = wrench[1:] - jnp.cross(x.rate, momentum) - jnp.asarray(self.turning_drag) * x.rate
        return self.gravity * down + R @ force / self.mass, moment / J

    def dynamics(self, t: Any, x: MultirotorState, u: RotorSpeeds) -> MultirotorState:
        """Return the time derivative of the state x at time t (s)."""
        acceleration, turn = self.accelerations(x, u)
        return MultirotorState(
            position=x.velocity,
            velocity=acceleration,
            attitude=quaternion.rate(x.attitude, x.rate),
            rate=turn,
            rotor_speed=(u.speed - x.rotor_speed) / jnp.maximum(self.lag, SHORTEST_LAG),
        )

    def after_step(self, t: Any, x: MultirotorState) -> MultirotorState:
        """Return the state at time t (s), with its quaternion normalised."""
        return MultirotorState(x.position, x.velocity, quaternion.normalise(x.attitude), x.rate, x.rotor_speed)

    def motion(self, t: Any, x: MultirotorState, u: RotorSpeeds) -> Motion:
        """Return the motion of the vehicle at time t (unit: 100 ns), for sensors."""
        acceleration, turn = self.accelerations(x, u)
        R = quaternion.to_matrix(x.attitude)
        return Motion(
            t=t,
            p_WB=x.position,
            attitude=to_euler(R),
            v_WB_B=R.T @ x.velocity,
            w_WB_B=x.rate,
            a_WB_B=R.T @ acceleration,
            alpha_WB_B=turn,
        )

    def hover(self, position: Any = (0.0, 0.0, 0.0), heading: Any = 0.0) -> MultirotorState:
        """Return the hovering state at a position (m, W) and heading (rad), with equal thrust of all rotors."""
        n = np.size(self.rotors.spins)
        share = np.full(n, float(self.mass) * float(self.gravity) / n)
        q = np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)])
        speed = np.sqrt(share / float(self.rotors.thrust_coefficient))
        return MultirotorState(np.asarray(position, float), np.zeros(3), q, np.zeros(3), speed)


def ring_rotors(spins: str, arm: float, first: float = 0.0) -> tuple[Any, Any]:
    """Return positions (n, 3) and directions of rotation (n,) of rotors around a ring, for `Rotors`.

    Args:
        spins: one letter per rotor in clockwise order from above: P turns clockwise, N counter-clockwise, e.g. "PNPN".
        arm: radius of the ring (m).
        first: angle of the first rotor, clockwise from the nose (rad).

    Raises: InputError if `spins` is empty or contains another letter.
    """
    if not spins or set(spins) - set("PN"):
        raise InputError(
            "spins",
            f"the text must consist of the letters P and N, got {spins!r}",
            fix="write P (clockwise from above) or N (counter-clockwise) for each rotor, e.g. PNPNPN",
        )
    angle = first + 2 * np.pi * np.arange(len(spins)) / len(spins)
    places = arm * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return places, np.array([1.0 if letter == "P" else -1.0 for letter in spins])
