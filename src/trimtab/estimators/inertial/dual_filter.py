"""Discrete matrices and noise of the two filters of the thesis: one for heading, one for velocity and position.

Errors are estimate minus truth. A bias is reading minus true value. x1 = (heading, gyro bias); x2 = (velocity north,
east, position north, east, accelerometer bias forward, starboard).

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3
and section 5.4.5. The unit error of its process noise is described in docs Errata.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.interfaces import InertialForm
from trimtab.core.record import Scalar, option, period, quantity, record
from trimtab.core.rotation import planar
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.inertial.mechanisation import rotate_lever, stack_numbers

TABLE = "[1] section 5.4.5"
HEADING_ROW = np.array([[1.0, 0.0]])
"""Measurement matrix H of a heading, for the filter state x1."""
POSITION_ROWS = np.concatenate([np.zeros((2, 2)), np.eye(2), np.zeros((2, 2))], axis=1)
"""Measurement matrix H of a position fix, for the filter state x2."""


@record
class InertialNoise:
    """Noise of the inertial sensors and of the aiding sensors, and its effect on the covariance.

    consistent:  in a time dt, white noise of variance s^2 per sample adds s^2 tick dt to the variance of a heading or
                 velocity. A random walk with the density q adds q dt to the variance of a bias.
    literal:     the printed numbers are added unchanged at every tick, although they are variances of an angular rate
                 or a force, not of a heading or a velocity. The filter's gains are then near 0.8, and its output
                 follows the aiding sensor closely.

    Source: [1] section 5.4.5; the interpretation of the random walks as densities per second is reconstructed.
    """

    gyro: Scalar = quantity("rad^2/s^2", "Noise variance of one gyro sample.", default=4.9e-4, above=0, source=TABLE)
    gyro_walk: Scalar = quantity(
        "rad^2/s^3", "Density of the random walk of the gyro's bias.", default=5e-4, low=0, source=TABLE
    )
    forward: Scalar = quantity(
        "m^2/s^4", "Noise variance of one forward accelerometer sample.", default=3.4e-2, above=0, source=TABLE
    )
    starboard: Scalar = quantity(
        "m^2/s^4", "Noise variance of one starboard accelerometer sample.", default=2.7e-2, above=0, source=TABLE
    )
    force_walk: Scalar = quantity(
        "m^2/s^5", "Density of the random walk of each accelerometer's bias.", default=5e-4, low=0, source=TABLE
    )
    heading: Scalar = quantity("rad^2", "Variance of a heading measurement.", default=1.6e-4, above=0, source=TABLE)
    position: Scalar = quantity(
        "m^2", "Variance of each coordinate of a position fix.", default=5.6e-4, above=0, source=TABLE
    )
    untrusted_rate: Scalar = quantity(
        "rad/sqrt(s)", "Random walk of the heading while the gyro cannot be trusted.", default=1.0, low=0
    )
    untrusted_force: Scalar = quantity(
        "m/s/sqrt(s)", "Random walk of the velocity while the accelerometers cannot be trusted.", default=2.0, low=0
    )
    heading_constant: Scalar = quantity(
        "rad",
        "Constant error (1 sigma) of the heading sensor, e.g. from its mounting. The square of this error is "
        "added to the reported variance.",
        default=0.0,
        low=0,
    )
    position_constant: Scalar = quantity(
        "m",
        "Constant error (1 sigma) of the positions, e.g. from a beacon's survey. The square of this error is "
        "added to the reported variance.",
        default=0.0,
        low=0,
    )
    tick: int = period("Time between IMU samples to which the noise variances apply.", default=ms(6.5536))
    covariance: str = option(
        "Use of the noise variances: consistent with their units, or literally as printed in the thesis.",
        default="consistent",
        choices=("consistent", "literal"),
    )

    def growth(self, dt: Any, untrusted: Any) -> Any:
        """Return the variances (6,) added in dt (s): heading, gyro bias, velocity forward and starboard, force biases.

        untrusted: flags of gyro and accelerometers (2,): 1.0 if the sensor can't be trusted, else 0.0.
        """
        white = stack_numbers(self.gyro, self.forward, self.starboard)
        walk = stack_numbers(self.gyro_walk, self.force_walk, self.force_walk)
        tick = to_seconds(self.tick)
        if self.covariance == "literal":
            white, walk = white * (dt / tick), walk * (dt / tick)
        else:
            white, walk = white * (tick * dt), walk * dt
        lost = jnp.stack([self.untrusted_rate * untrusted[0], self.untrusted_force * untrusted[1]])
        white = white + dt * jnp.stack([lost[0] ** 2, lost[1] ** 2, lost[1] ** 2])
        return jnp.stack([white[0], walk[0], white[1], white[2], walk[1], walk[2]])

    def integration_time(self, dt: Any) -> Any:
        """Return the time (s) over which noise is integrated within a step: dt if consistent, 0 if literal."""
        return jnp.zeros_like(dt) if self.covariance == "literal" else dt

    def heading_noise(self, variance: Any) -> Any:
        """Return the noise variance R (1, 1) of a heading: the given variance if above 0, else the field `heading`."""
        return jnp.reshape(jnp.where(variance > 0, variance, self.heading), (1, 1))

    def position_noise(self, variance: Any) -> Any:
        """Return the noise covariance R (2, 2) of a position fix.

        variance: variance of both coordinates of the fix, or their covariance (2, 2). If the variance of north is not
        above 0, both coordinates have the variance in the field `position`.
        """
        own = variance if np.ndim(variance) == 2 else variance * jnp.eye(2)
        return jnp.where(own[0, 0] > 0, own, self.position * jnp.eye(2))

    def constant_variances(self) -> Any:
        """Return the variances of constant errors (8,), in the order of Belief.x. Only those of heading and position
        are not 0."""
        heading, place = self.heading_constant**2, self.position_constant**2
        zero = jnp.zeros(())
        return stack_numbers(heading, zero, zero, place, place, zero, zero, zero)


def heading_transition(dt: Any) -> Any:
    """Return the transition matrix Phi1 (2, 2) of the errors (heading, gyro bias). Source: [1] chapter 3."""
    one, zero = jnp.ones_like(dt), jnp.zeros_like(dt)
    return jnp.stack([jnp.stack([one, dt]), jnp.stack([zero, one])])


def motion_transition(dt: Any, heading: Any) -> Any:
    """Return the transition matrix Phi2 (6, 6) of the errors (velocity, position, accelerometer bias) at a heading.

    The matrix is exact, because A^3 = 0.
    Source: [1] chapter 3: the block from bias to velocity is dt B, and from bias to position dt^2/2 B.
    """
    B, eye, none = planar(heading), jnp.eye(2), jnp.zeros((2, 2))
    return jnp.concatenate(
        [
            jnp.concatenate([eye, none, dt * B], axis=1),
            jnp.concatenate([dt * eye, eye, dt * dt / 2 * B], axis=1),
            jnp.concatenate([none, none, eye], axis=1),
        ]
    )


def heading_process_noise(growth: Any, reach: Any) -> Any:
    """Return the process noise Q1 (2, 2) of (heading, gyro bias).

    growth: `InertialNoise.growth`.  reach: `InertialNoise.integration_time`; if it is above 0, the bias's random walk
    also adds to the heading within the step.
    """
    walk = growth[1]
    both = walk * reach / 2
    return jnp.stack([jnp.stack([growth[0] + walk * reach**2 / 3, both]), jnp.stack([both, walk])])


def motion_process_noise(growth: Any, heading: Any, reach: Any) -> Any:
    """Return the process noise G2 Q2 G2' (6, 6) of velocity, position and biases. Noise along body axes is turned to W.

    reach: `InertialNoise.integration_time`. If it is dt, the result is the exact integral of white noise of velocity
    and biases over dt. If it is 0, as printed in [1], noise of the velocity does not affect the position in the same
    step.
    """
    B = planar(heading)
    V, A = (B * growth[2:4]) @ B.T, (B * growth[4:6]) @ B.T
    bias = B * growth[4:6]
    vr, vb, rb = V * reach / 2 + A * reach**3 / 8, bias * reach / 2, bias * reach**2 / 6
    return jnp.concatenate(
        [
            jnp.concatenate([V + A * reach**2 / 3, vr, vb], axis=1),
            jnp.concatenate([vr.T, V * reach**2 / 3 + A * reach**4 / 20, rb], axis=1),
            jnp.concatenate([vb.T, rb.T, jnp.diag(growth[4:6])], axis=1),
        ]
    )


class DualModel(NamedTuple):
    """Matrices of both filters over a step: F1, Q1 (2, 2) of the heading filter, F2, Q2 (6, 6) of the motion filter."""

    F1: Any
    Q1: Any
    F2: Any
    Q2: Any


def dual_model(noise: InertialNoise, dt: Any, untrusted: Any, heading: Any) -> DualModel:
    """Return the matrices of both filters over dt (s), for a heading at the start of the step.

    untrusted: flags of gyro and accelerometers (2,): 1 if the sensor can't be trusted.
    """
    growth, reach = noise.growth(dt, untrusted), noise.integration_time(dt)
    return DualModel(
        heading_transition(dt),
        heading_process_noise(growth, reach),
        motion_transition(dt, heading),
        motion_process_noise(growth, heading, reach),
    )


def aided_point(form: InertialForm, heading: Any, heading_variance: Any, variance: Any) -> tuple[Any, Any]:
    """Return the vector (2,) in W from the IMU to the measured point, and the position's noise covariance (2, 2)."""
    arm, slope = rotate_lever(heading, form.arms.imu_to_aided_point())
    return arm, lever_arm_noise(form.noise.position_noise(variance), slope, heading_variance)


def lever_arm_noise(R: Any, slope: Any, variance: Any) -> Any:
    """Return the noise covariance R (2, 2) plus the uncertainty of a lever arm due to an uncertain heading.

    The dual filters don't estimate the heading from positions. They treat the lever arm's error due to the heading as
    noise.  slope: derivative of the lever arm by heading (2,).  variance: variance of the heading.
    """
    return R + variance * slope[:, None] * slope[None, :]


def belief_covariance(P1: Any, P2: Any, bias_sign: float = 1.0) -> Any:
    """Return the covariance (8, 8) of a Belief from the covariances of two filters that are taken as independent.

    bias_sign: 1 if the bias error has the same sign in the filters as in a Belief; -1 if its sign is reversed. The
    errors of heading, velocity and position have the same sign in both.
    """
    s = bias_sign
    zero = jnp.zeros(4)
    signs = stack_numbers(1, 1, 1, 1, s, s)
    P2 = P2 * signs[:, None] * signs[None, :]
    top = jnp.concatenate([P1[:1, :1], jnp.zeros((1, 4)), s * P1[:1, 1:], jnp.zeros((1, 2))], axis=1)
    middle = jnp.concatenate([jnp.zeros((4, 1)), P2[:4, :4], jnp.zeros((4, 1)), P2[:4, 4:]], axis=1)
    rate = jnp.concatenate([s * P1[1:, :1], zero[None], P1[1:, 1:], jnp.zeros((1, 2))], axis=1)
    bottom = jnp.concatenate([jnp.zeros((2, 1)), P2[4:, :4], jnp.zeros((2, 1)), P2[4:, 4:]], axis=1)
    return jnp.concatenate([top, middle, rate, bottom], axis=0)
