"""Inertial navigation in the plane: mechanisation, positions of the sensors, and initial values of the filters.

Frames: W north-east-down; B at the vehicle's reference point, x forward, y starboard. The vehicle stays level. The
navigated point is the IMU, so that no angular acceleration is needed.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import planar
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.sensor_watch import NEVER

DIMENSION = 8
"""Number of values in a Belief: heading, velocity (2), position (2), gyro bias, accelerometer biases (2)."""


class Belief(NamedTuple):
    """Estimate of a navigation filter at one instant. All inertial filters use the same order of values.

    x: heading (rad, unwrapped), velocity north and east (m/s), position north and east (m) of the IMU, gyro bias
    (rad/s), accelerometer biases forward and starboard (m/s^2); shape (8,).
    P: covariance of estimate minus truth (8, 8).
    """

    x: Any
    P: Any


@record
class InertialStart:
    """Initial estimate before the first measurement, and its uncertainty.

    Heading and position are unknown at first, and the first heading and position determine them. In [1], they are set
    to the first measurement, with its variance. The first update has the same effect.

    Source: [1] section 5.4.5 for biases and velocity.
    """

    heading: Scalar = quantity("rad", "Initial heading.", default=0.0, kind="angle")
    north: Scalar = quantity("m", "Initial north coordinate of the IMU.", default=0.0, frame="W")
    east: Scalar = quantity("m", "Initial east coordinate of the IMU.", default=0.0, frame="W")
    velocity_north: Scalar = quantity("m/s", "Initial north velocity of the IMU.", default=0.0, frame="W")
    velocity_east: Scalar = quantity("m/s", "Initial east velocity of the IMU.", default=0.0, frame="W")
    sigma_heading: Scalar = quantity(
        "rad", "Standard deviation of the initial heading. The default is for an unknown heading.", default=1.8, above=0
    )
    sigma_position: Scalar = quantity(
        "m", "Standard deviation of each initial position coordinate.", default=10.0, above=0
    )
    sigma_velocity: Scalar = quantity(
        "m/s",
        "Standard deviation of each initial velocity component.",
        default=1.0,
        above=0,
        source="[1] section 5.4.5",
    )
    sigma_gyro_bias: Scalar = quantity(
        "rad/s", "Standard deviation of the initial gyro bias.", default=1.0, above=0, source="[1] section 5.4.5"
    )
    sigma_force_bias: Scalar = quantity(
        "m/s^2",
        "Standard deviation of each initial accelerometer bias.",
        default=1.0,
        above=0,
        source="[1] section 5.4.5",
    )

    def velocity(self) -> Any:
        """Return the initial velocity (2,), north and east."""
        return stack_numbers(self.velocity_north, self.velocity_east)

    def position(self) -> Any:
        """Return the initial position (2,), north and east."""
        return stack_numbers(self.north, self.east)

    def heading_variances(self) -> Any:
        """Return the initial variances of heading and gyro bias (2,)."""
        return stack_numbers(self.sigma_heading, self.sigma_gyro_bias) ** 2

    def motion_variances(self) -> Any:
        """Return the initial variances of velocity, position and accelerometer biases (6,)."""
        sigmas = (self.sigma_velocity, self.sigma_position, self.sigma_force_bias)
        return stack_numbers(*(s for s in sigmas for _ in range(2))) ** 2

    def pose(self) -> Any:
        """Return the initial heading, velocity and position (5,)."""
        return jnp.concatenate(
            [jnp.reshape(jnp.asarray(self.heading, np.float64), 1), self.velocity(), self.position()]
        )

    def variances(self) -> Any:
        """Return all initial variances (8,), in the order of Belief.x: heading, velocity, position, biases."""
        (heading, bias), motion = self.heading_variances(), self.motion_variances()
        return jnp.concatenate([heading[None], motion[:4], bias[None], motion[4:]])


@record
class LeverArms:
    """Positions of the IMU and the position sensor in B. Source: docs page, Aided inertial navigation."""

    imu: Any = quantity("m", "Position of the IMU on the vehicle.", default=np.zeros(2), frame="B", shape=(2,))
    aiding: Any = quantity(
        "m", "Position of the point that the position sensor measures.", default=np.zeros(2), frame="B", shape=(2,)
    )

    def imu_to_aided_point(self) -> Any:
        """Return the vector (2,) in B from the IMU to the point that the position sensor measures."""
        return self.aiding - self.imu


def mechanise(dt: Any, f0: Any, f1: Any, v: Any, r: Any) -> tuple[Any, Any]:
    """Return velocity and position (2,) in W after dt (s), exact if the specific force changes linearly from f0 to f1.

        v + dt/2 (f1 + f0)        r + v dt + dt^2/6 (f1 + 2 f0)                                       [1, eq. 3.42]

    f0, f1: specific force in W at the start and end of the step (2,).  v, r: velocity and position at the start (2,).
    """
    return v + dt / 2 * (f1 + f0), r + v * dt + dt * dt / 6 * (f1 + 2 * f0)


def mechanise_corrected(dt: Any, before: Any, imu_reading: Any, x: Any) -> tuple[Any, Any, Any]:
    """Return heading, velocity and position after dt (s) of an INS that subtracts estimated biases from IMU readings.

    before, imu_reading: IMU readings at the start and end of the step (3,).
    x: heading, velocity (2,), position (2,), gyro bias, accelerometer biases (2,) at the start of the step.
    The accelerometer biases are turned to W with the heading at the start of the step, as in Phi.
    """
    phi, v, r, gyro_bias, force_bias = x
    B = planar(phi)
    heading = phi + dt / 2 * (imu_reading[0] + before[0]) - dt * gyro_bias
    bias = B @ force_bias
    f0, f1 = B @ before[1:] - bias, planar(heading) @ imu_reading[1:] - bias
    velocity, position = mechanise(dt, f0, f1, v, r)
    return heading, velocity, position


def rotate_lever(heading: Any, arm: Any) -> tuple[Any, Any]:
    """Return a lever arm (2,) converted from B to W, and its derivative by the heading."""
    B = planar(heading)
    quarter = jnp.stack([-arm[1], arm[0]])
    return B @ arm, B @ quarter


def stack_numbers(*numbers: Any) -> Any:
    """Return an array (n,), in double precision, of n numbers or JAX tracers."""
    return jnp.stack([jnp.asarray(number, np.float64) for number in numbers])


@record
class ImuHistory:
    """Last samples of an IMU, the newest at the end. Source: docs page, Particle filter."""

    t: Any = quantity("100 ns", "Time of each IMU sample; NEVER in an unused slot.", kind="time")
    imu_reading: Any = quantity("1", "Yaw rate (rad/s), specific force forward and starboard (m/s^2); (slots, 3).")
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers (slots, 2): 1 if the sensor cannot be trusted.")


class PreintegratedMotion(NamedTuple):
    """Motion between two instants, integrated once from IMU readings for filters that start from different states.

    time: T (s).  turn: (rad).  velocity: dv (2,).  position: dr (2,).  D1, D2: (2, 2).  untrusted: (2,).
    With the turn a since the first instant, and vectors in the body's axes at the first instant:

        turn,  dv = int R(a) f dt,  dr = int dv dt,  D1 = int R(a) dt,  D2 = int D1 dt

    so that a state with heading phi, velocity v, position r and biases (bg, ba) becomes, after T:

        phi + turn - bg T,   v + B(phi) (dv - D1 ba),   r + v T + B(phi) (dr - D2 ba)

    This is correct to first order in the biases. The effect of bg T on B within the step is left out (0.002 of dv for
    1 deg/s and 0.1 s).

    Source: Lupton, Sukkarieh, "Visual-inertial-aided navigation for high-dynamic motion", IEEE Trans. Robotics 28
    (2012).
    """

    time: Any
    turn: Any
    velocity: Any
    position: Any
    D1: Any
    D2: Any
    untrusted: Any


def empty_imu_history(slots: int) -> ImuHistory:
    """Return a history without samples, for the given number of IMU samples."""
    return ImuHistory(np.full(slots, NEVER, np.int64), np.zeros((slots, 3)), np.zeros((slots, 2)))


def append_sample(h: ImuHistory, t: Any, imu_reading: Any, untrusted: Any) -> ImuHistory:
    """Return the history with an IMU sample added and the oldest removed."""
    t, imu_reading, untrusted = (jnp.asarray(v) for v in (t, imu_reading, untrusted))
    return ImuHistory(
        jnp.concatenate([h.t[1:], t[None]]),
        jnp.concatenate([h.imu_reading[1:], imu_reading[None]]),
        jnp.concatenate([h.untrusted[1:], untrusted[None]]),
    )


def preintegrate(h: ImuHistory, begin: Any, end: Any) -> PreintegratedMotion:
    """Return the motion between two instants, as far as IMU samples exist. Readings are interpolated linearly."""
    zero, two = jnp.zeros(()), jnp.zeros(2)
    start = PreintegratedMotion(zero, zero, two, two, jnp.zeros((2, 2)), jnp.zeros((2, 2)), two)

    def one(m: PreintegratedMotion, i: Any) -> tuple[PreintegratedMotion, None]:
        t0, t1 = h.t[i], h.t[i + 1]
        a, b = jnp.maximum(t0, begin), jnp.minimum(t1, end)
        there = (t0 > NEVER) & (b > a)
        span = jnp.where(there, t1 - t0, 1).astype(np.float64)
        share = [jnp.where(there, (t - t0).astype(np.float64) / span, 0.0) for t in (a, b)]
        f0, f1 = (h.imu_reading[i] + s * (h.imu_reading[i + 1] - h.imu_reading[i]) for s in share)
        dt = jnp.where(there, to_seconds(b - a), 0.0)
        turn = m.turn + dt * (f0[0] + f1[0]) / 2
        R0, R1 = planar(m.turn), planar(turn)
        velocity, position = mechanise(dt, R0 @ f0[1:], R1 @ f1[1:], m.velocity, m.position)
        D1, D2 = mechanise(dt, R0, R1, m.D1, m.D2)
        untrusted = jnp.where(
            there, jnp.maximum(m.untrusted, jnp.maximum(h.untrusted[i], h.untrusted[i + 1])), m.untrusted
        )
        return PreintegratedMotion(m.time + dt, turn, velocity, position, D1, D2, untrusted), None

    return lax.scan(one, start, jnp.arange(h.t.shape[0] - 1))[0]
