"""Error-state filter of inertial navigation in space: estimate, covariance, and their propagation.

The state is a quaternion, vectors and biases. The error, truth minus estimate, has 15 numbers in this order:

    R = R^ Exp(dtheta)    v = v^ + dv    p = p^ + dp    b_gyro = b^ + ..    b_force = b^ + ..

dtheta is in B, dv and dp are in W. If raw ranges are used, two more numbers follow: bias and drift of the receiver's
clock. After a measurement the estimated error is added to the state and reset to zero.

The covariance P is propagated over many samples at once, by their combined increment (`strapdown`). A measurement is
fused one scalar at a time, in Joseph's form, so that no matrix is inverted.

Source: [1] Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, chapters 5 to 7 (local
angular error). [2] Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed.,
sections 14.2 and 14.3. [3] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation",
eq. 5.2.3-18.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core import quaternion
from trimtab.core.linalg import symmetric
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import DEG, cross_matrix
from trimtab.estimators.inertial.strapdown import Increment, Kinematics, compose, increment_of, move, no_increment

ATTITUDE, VELOCITY, POSITION, GYRO_BIAS, FORCE_BIAS, CLOCK = (slice(i, i + 3) for i in range(0, 18, 3))
"""Slices of the error vector of the error-state filter. The clock's slice has two numbers, each other slice three."""
NAVIGATION = 9
"""Number of error states that the IMU propagates: attitude, velocity, position."""
ERRORS = 15
ZERO = (0.0, 0.0, 0.0)


@record
class SpatialNoise:
    """Noise of the IMU and, if raw ranges are used, of the receiver's clock.

    The values are densities of white noise, as in the inertial unit's error model. The fields untrusted_... are used
    for saturated samples and for gaps.
    Source: docs page, Gnss and inertial; the defaults suit `Imu` with the errors of a good MEMS unit.
    """

    gyro: Scalar = quantity("rad/s/Hz^0.5", "White noise density of the gyros.", default=2e-4, above=0)
    force: Scalar = quantity("m/s^2/Hz^0.5", "White noise density of the accelerometers.", default=2e-3, above=0)
    gyro_walk: Scalar = quantity("rad/s/s^0.5", "Random walk density of the gyros' biases.", default=1e-5, low=0)
    force_walk: Scalar = quantity(
        "m/s^2/s^0.5", "Random walk density of the accelerometers' biases.", default=2e-4, low=0
    )
    untrusted_rate: Scalar = quantity(
        "rad/s", "Standard deviation assumed for an angular rate that cannot be trusted.", default=0.5, low=0
    )
    untrusted_force: Scalar = quantity(
        "m/s^2", "Standard deviation assumed for a specific force that cannot be trusted.", default=5.0, low=0
    )
    clock: Scalar = quantity("m/s^0.5", "White noise density of the rate of the receiver's clock.", default=0.1, low=0)
    clock_walk: Scalar = quantity(
        "m/s^1.5", "Random walk density of the drift of the receiver's clock.", default=0.05, low=0
    )


@record
class SpatialStart:
    """Initial estimate and its uncertainty. Source: docs page, Gnss and inertial."""

    angles: Any = quantity("rad", "Initial roll, pitch, yaw.", default=ZERO, kind="angle", shape=(3,))
    velocity: Any = quantity("m/s", "Initial velocity: north, east, down.", default=ZERO, frame="W", shape=(3,))
    position: Any = quantity("m", "Initial position: north, east, down.", default=ZERO, frame="W", shape=(3,))
    sigma_tilt: Scalar = quantity(
        "rad", "Standard deviation of the initial tilt about the body's x and y axes.", default=2.0 * DEG, above=0
    )
    sigma_heading: Scalar = quantity(
        "rad", "Standard deviation of the initial heading error about the body's z axis.", default=5.0 * DEG, above=0
    )
    sigma_velocity: Scalar = quantity(
        "m/s", "Standard deviation of each initial velocity component.", default=0.5, above=0
    )
    sigma_position: Scalar = quantity(
        "m", "Standard deviation of each initial position component.", default=2.0, above=0
    )
    sigma_gyro_bias: Scalar = quantity(
        "rad/s", "Standard deviation of each initial gyro bias.", default=0.3 * DEG, above=0
    )
    sigma_force_bias: Scalar = quantity(
        "m/s^2", "Standard deviation of each initial accelerometer bias.", default=0.05, above=0
    )
    sigma_clock_bias: Scalar = quantity(
        "m",
        "Standard deviation of the clock bias after the first ranges have set it. "
        "It must be much larger than the position's, so that these ranges are not counted twice.",
        default=100.0,
        above=0,
    )
    sigma_clock_drift: Scalar = quantity(
        "m/s", "Standard deviation of the clock drift after the first range rates have set it.", default=20.0, above=0
    )

    def sigmas(self, n: int) -> Any:
        """Return the initial standard deviation of each error (n,), n = 15 or 17."""
        tilt, three = jnp.asarray(self.sigma_tilt, float), jnp.ones(3)
        own = [
            jnp.stack([tilt, tilt, jnp.asarray(self.sigma_heading, float)]),
            self.sigma_velocity * three,
            self.sigma_position * three,
            self.sigma_gyro_bias * three,
            self.sigma_force_bias * three,
            jnp.stack([jnp.asarray(self.sigma_clock_bias, float), jnp.asarray(self.sigma_clock_drift, float)]),
        ]
        return jnp.concatenate(own)[:n]


@record
class Nominal:
    """Estimate of the error-state filter at one instant. P is the error covariance at the beginning of `span`.

    Source: this module.
    """

    attitude: Any = quantity("1", "Quaternion q_WB, scalar first.", frame="WB", shape=(4,))
    velocity: Any = quantity("m/s", "Velocity: north, east, down.", frame="W", shape=(3,))
    position: Any = quantity("m", "Position of the IMU: north, east, down.", frame="W", shape=(3,))
    gyro_bias: Any = quantity("rad/s", "Estimated bias of the gyros.", frame="B", shape=(3,))
    force_bias: Any = quantity("m/s^2", "Estimated bias of the accelerometers.", frame="B", shape=(3,))
    clock: Any = quantity("1", "Bias (m) and drift (m/s) of the receiver's clock.", shape=(2,))
    rate: Any = quantity("rad/s", "Angular velocity of the last sample, corrected for bias.", frame="B", shape=(3,))
    acceleration: Any = quantity("m/s^2", "Acceleration of the IMU in the last sample.", frame="W", shape=(3,))
    P: Any = quantity("1", "Covariance of the error (n, n), n = 15 or 17.")
    span: Increment = part("Motion increment since the covariance P was last propagated.")
    untrusted: Scalar = quantity(
        "s", "Time during which the IMU was not trusted since the covariance P was last propagated."
    )


def first_nominal(start: SpatialStart, n: int) -> Nominal:
    """Return the initial state, before the first sample. n: number of error states, 15 or 17."""
    return Nominal(
        attitude=quaternion.from_euler(*jnp.asarray(start.angles, float)),
        velocity=jnp.asarray(start.velocity, float),
        position=jnp.asarray(start.position, float),
        gyro_bias=jnp.zeros(3),
        force_bias=jnp.zeros(3),
        clock=jnp.zeros(2),
        rate=jnp.zeros(3),
        acceleration=jnp.zeros(3),
        P=jnp.diag(start.sigmas(n) ** 2),
        span=no_increment(),
        untrusted=jnp.zeros(()),
    )


def kinematics_of(x: Nominal) -> Kinematics:
    """Return the attitude, velocity and position of the state."""
    return Kinematics(x.attitude, x.velocity, x.position)


def propagate(x: Nominal, w: Any, f: Any, dt: Any, untrusted: Any, gravity: Any) -> Nominal:
    """Return the state after dt (s), with unchanged P.

    w, f: measured angular velocity (rad/s) and specific force (m/s²), (3,) in B.  untrusted: 1 if w and f can't be
    trusted, else 0.
    """
    rate, force = w - x.gyro_bias, f - x.force_bias
    one = increment_of(rate, force, dt)
    after = move(kinematics_of(x), one, gravity)
    acceleration = quaternion.rotate(after.attitude, force) + gravity
    clock = jnp.stack([x.clock[0] + dt * x.clock[1], x.clock[1]])
    span = compose(x.span, one)
    moved = replace(x, **after._asdict(), clock=clock, rate=rate, acceleration=acceleration)
    return replace(moved, span=span, untrusted=x.untrusted + untrusted * dt)


def transition(R_WB: Any, one: Increment) -> Any:
    """Return the first 9 rows (9, 15) of the error's transition matrix over an increment that begins at R_WB (3, 3).

    The effects of errors of attitude, velocity and position are exact. The effects of bias errors are computed for a
    constant angular rate. For attitude and velocity, these effects are correct to second order in the rotation angle,
    also for a changing force (T dv - dp is the integral of s f(s)). For position, they are correct only for a constant
    force.
    """
    T, dR = one.time, quaternion.to_matrix(one.turn)
    eye, none = jnp.eye(3), jnp.zeros((3, 3))
    V, X = R_WB @ cross_matrix(one.velocity), R_WB @ cross_matrix(one.position)
    moment = R_WB @ cross_matrix(T * one.velocity - one.position)
    early, middle = (2 * eye + dR) / 3, (eye + dR) / 2
    rows = [
        [dR.T, none, none, -T * middle.T, none],
        [-V, eye, none, moment @ early, -T * (R_WB @ middle)],
        [-X, T * eye, eye, T / 3 * (X @ ((3 * eye + dR) / 4)), -T * T / 2 * (R_WB @ early)],
    ]
    return jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows])


def process_noise(noise: SpatialNoise, T: Any, untrusted: Any, n: int) -> Any:
    """Return the process noise (n, n) added in T (s). The IMU was not trusted for `untrusted` seconds of T."""
    gyro = noise.gyro**2 * T + (noise.untrusted_rate * untrusted) ** 2
    force = noise.force**2 * T + (noise.untrusted_force * untrusted) ** 2
    three = jnp.ones(3)
    own = [gyro, force, force * T * T / 3, noise.gyro_walk**2 * T, noise.force_walk**2 * T]
    diagonal = [v * three for v in own]
    if n > ERRORS:
        diagonal.append(jnp.stack([noise.clock**2 * T, noise.clock_walk**2 * T]))
    Q = jnp.diag(jnp.concatenate(diagonal))
    i = np.arange(3, 6)
    return Q.at[i, i + 3].set(force * T / 2).at[i + 3, i].set(force * T / 2)


def carry_covariance(P: Any, R_WB: Any, one: Increment, untrusted: Any, noise: SpatialNoise) -> Any:
    """Return the covariance P (n, n) propagated over an increment that begins at the attitude R_WB (3, 3)."""
    n, k = P.shape[0], NAVIGATION
    F = transition(R_WB, one)
    top = F @ P[:ERRORS]
    nav = top[:, :ERRORS] @ F.T
    across, rest = top[:, k:], P[k:, k:]
    if n > ERRORS:
        C = jnp.eye(n - k).at[-2, -1].set(one.time)
        across, rest = across @ C.T, C @ rest @ C.T
    whole = jnp.concatenate(
        [jnp.concatenate([symmetric(nav), across], axis=1), jnp.concatenate([across.T, rest], axis=1)]
    )
    return whole + process_noise(noise, one.time, untrusted, n)


def catch_up(x: Nominal, noise: SpatialNoise) -> Nominal:
    """Return the state with the covariance P propagated to the time of the estimate."""
    begin = quaternion.multiply(x.attitude, quaternion.conjugate(x.span.turn))
    P = carry_covariance(x.P, quaternion.to_matrix(begin), x.span, x.untrusted, noise)
    return replace(x, P=P, span=no_increment(), untrusted=jnp.zeros(()))


class Fusion(NamedTuple):
    """Result of scalar updates.

    error: estimated error (n,).  P: covariance after the updates.  innovation, variance, nis: innovation, its variance
    and NIS of each update (m,).  used: True for measurements that were finite, wanted and inside the gate (m,).
    """

    error: Any
    P: Any
    innovation: Any
    variance: Any
    nis: Any
    used: Any


def fuse_scalars(P: Any, y: Any, H: Any, R: Any, wanted: Any, gate: Any) -> Fusion:
    """Fuse m scalar measurements with independent noise, one after another.

    Args:     P: (n, n).    y: measured minus predicted (m,).    H: (m, n).    R: variances (m,).
              wanted: True for measurements that may be used (m,).    gate: largest NIS of a measurement that is used.
    Source:   [3]: (I - K h) P (I - K h)' + K r K', for any gain P - K g' - g K' + K s K' with g = P h', s = h g + r.
    """
    n, m = P.shape[0], y.shape[0]

    def fuse(i: Any, carry: Any) -> Any:
        error, P, innovation, variance, nis, used = carry
        h, r = H[i], R[i]
        g = P @ h
        s = h @ g + r
        apart = y[i] - h @ error
        sound = wanted[i] & jnp.isfinite(apart)
        apart = jnp.where(sound, apart, 0.0)
        square = apart * apart / s
        taken = sound & (square <= gate)
        K = jnp.where(taken, g / s, 0.0)
        P = P - K[:, None] * g - (g - K * s)[:, None] * K
        return (
            error + K * apart,
            P,
            innovation.at[i].set(apart),
            variance.at[i].set(s),
            nis.at[i].set(square),
            used.at[i].set(taken),
        )

    zero = jnp.zeros(m)
    begin = jnp.zeros(n), P, zero, zero, zero, jnp.zeros(m, bool)
    error, P, innovation, variance, nis, used = lax.fori_loop(0, m, fuse, begin)
    return Fusion(error, symmetric(P), innovation, variance, nis, used)


def put_error_in(x: Nominal, error: Any, P: Any) -> Nominal:
    """Return the state corrected by an error (n,), with P (n, n) as the remaining covariance.

    P is rotated to the corrected attitude by the right Jacobian of this rotation, to second order. Source: [1] eqs.
    283-286 and 183.
    """
    turn = error[ATTITUDE]
    n = P.shape[0]
    A = cross_matrix(turn)
    G = jnp.eye(3) - A / 2 + A @ A / 6
    top = G @ P[:3]
    own = symmetric(top[:, :3] @ G.T)
    P = P.at[:3].set(top).at[:, :3].set(top.T).at[:3, :3].set(own)
    clock = error[ERRORS:] if n > ERRORS else jnp.zeros(2)
    return replace(
        x,
        attitude=quaternion.normalise(quaternion.retract(x.attitude, turn)),
        velocity=x.velocity + error[VELOCITY],
        position=x.position + error[POSITION],
        gyro_bias=x.gyro_bias + error[GYRO_BIAS],
        force_bias=x.force_bias + error[FORCE_BIAS],
        clock=x.clock + clock,
        P=P,
    )
