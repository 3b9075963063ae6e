"""Discrete matrices and noise of the thesis's two filters: heading, then velocity and position.

Errors are estimate minus truth; a bias is reading minus truth. x1 = (heading, gyro bias); x2 = (velocity north,
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

    consistent:  white noise of variance s^2 per sample grows a heading (velocity) by s^2 tick dt in a time dt, a bias
                 with the walk q by q dt.
    literal:     the printed numbers are added as they stand at every tick, although they are variances of a rate (a
                 force) and not of a heading (velocity): gains near 0.8, output close to the aiding sensor.

    Source: [1] section 5.4.5; the reading of the walks as per second is reconstructed.
    """

    gyro: Scalar = quantity("rad^2/s^2", "White noise of one gyro sample.", default=4.9e-4, above=0, source=TABLE)
    gyro_walk: Scalar = quantity("rad^2/s^3", "Random walk of the gyro's bias.", default=5e-4, low=0, source=TABLE)
    forward: Scalar = quantity(
        "m^2/s^4", "White noise of one forward force sample.", default=3.4e-2, above=0, source=TABLE
    )
    starboard: Scalar = quantity(
        "m^2/s^4", "White noise of one starboard force sample.", default=2.7e-2, above=0, source=TABLE
    )
    force_walk: Scalar = quantity(
        "m^2/s^5", "Random walk of each accelerometer's bias.", default=5e-4, low=0, source=TABLE
    )
    heading: Scalar = quantity("rad^2", "Variance of a heading measurement.", default=1.6e-4, above=0, source=TABLE)
    position: Scalar = quantity(
        "m^2", "Variance of each coordinate of a position fix.", default=5.6e-4, above=0, source=TABLE
    )
    doubtful_rate: Scalar = quantity(
        "rad/sqrt(s)", "Random walk of the heading while the gyro cannot be trusted.", default=1.0, low=0
    )
    doubtful_force: Scalar = quantity(
        "m/s/sqrt(s)", "Random walk of the velocity while the accelerometers cannot be trusted.", default=2.0, low=0
    )
    heading_constant: Scalar = quantity(
        "rad",
        "Constant error of the heading sensor, e.g. of its mounting; added to the variance, as it is unobservable.",
        default=0.0,
        low=0,
    )
    position_constant: Scalar = quantity(
        "m",
        "Constant error of the positions, e.g. of a beacon's survey; added to the variance, as it is unobservable.",
        default=0.0,
        low=0,
    )
    tick: int = period("Time between the samples to which these variances belong.", default=ms(6.5536))
    covariance: str = option(
        "Use of the noise variances: with consistent units, or literally as printed.",
        default="consistent",
        choices=("consistent", "literal"),
    )

    def growth(self, dt: Any, untrusted: Any) -> Any:
        """Return variances added in dt (s): heading, gyro bias, velocity forward and starboard, force biases (6,).

        untrusted: (2,), 1.0 where gyro or accelerometers can't be trusted, else 0.0.
        """
        white = stack_numbers(self.gyro, self.forward, self.starboard)
        walk = stack_numbers(self.gyro_walk, self.force_walk, self.force_walk)
        tick = to_seconds(self.tick)
        if self.covariance == "literal":
            white, walk = white * (dt / tick), walk * (dt / tick)
        else:
            white, walk = white * (tick * dt), walk * dt
        lost = jnp.stack([self.doubtful_rate * untrusted[0], self.doubtful_force * untrusted[1]])
        white = white + dt * jnp.stack([lost[0] ** 2, lost[1] ** 2, lost[1] ** 2])
        return jnp.stack([white[0], walk[0], white[1], white[2], walk[1], walk[2]])

    def integration_time(self, dt: Any) -> Any:
        """Return the time (s) over which noise is integrated within a step: all of it, or 0 as printed."""
        return jnp.zeros_like(dt) if self.covariance == "literal" else dt

    def heading_noise(self, variance: Any) -> Any:
        """Return R of a heading (1, 1): the given variance where it is above 0, else that of the sensor."""
        return jnp.reshape(jnp.where(variance > 0, variance, self.heading), (1, 1))

    def position_noise(self, variance: Any) -> Any:
        """Return R of a heading (1, 1): the given variance where it is above 0, else the default one."""
        own = variance if np.ndim(variance) == 2 else variance * jnp.eye(2)
        return jnp.where(own[0, 0] > 0, own, self.position * jnp.eye(2))

    def constant_variances(self) -> Any:
        """Return R of a position fix (2, 2): the given variance or covariance (2, 2) if above 0, else the default."""
        heading, place = self.heading_constant**2, self.position_constant**2
        zero = jnp.zeros(())
        return stack_numbers(heading, zero, zero, place, place, zero, zero, zero)


def heading_transition(dt: Any) -> Any:
    """Return Phi1 (2, 2) of the errors (heading, gyro bias). Source: [1] chapter 3."""
    one, zero = jnp.ones_like(dt), jnp.zeros_like(dt)
    return jnp.stack([jnp.stack([one, dt]), jnp.stack([zero, one])])


def motion_transition(dt: Any, heading: Any) -> Any:
    """Return Phi2 (6, 6) of the errors (velocity, position, accelerometer bias) at a heading; exact, as A^3 = 0.

    Source: [1] chapter 3: dt B in the block from bias to velocity, dt^2/2 B to position.
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
    """Return Q1 (2, 2) for the growth and reach of InertialNoise; with a reach, the walk also turns the heading."""
    walk = growth[1]
    both = walk * reach / 2
    return jnp.stack([jnp.stack([growth[0] + walk * reach**2 / 3, both]), jnp.stack([both, walk])])


def motion_process_noise(growth: Any, heading: Any, reach: Any) -> Any:
    """Return G2 Q2 G2' (6, 6): noise along the body's axes, expressed in W.

    With a reach of dt it is the exact integral of white noise on velocity and biases over dt; with 0, as printed, noise
    of velocity does not reach position in the same step.
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
    """Return both filters' matrices over a step: Phi1, Q1 (2, 2) of the heading, Phi2, Q2 (6, 6) of the motion."""

    F1: Any
    Q1: Any
    F2: Any
    Q2: Any


def dual_model(noise: InertialNoise, dt: Any, untrusted: Any, heading: Any) -> DualModel:
    """Return both filters over dt (s) from a heading. untrusted (2,): 1 for gyro, accelerometers not trusted."""
    growth, reach = noise.growth(dt, untrusted), noise.integration_time(dt)
    return DualModel(
        heading_transition(dt),
        heading_process_noise(growth, reach),
        motion_transition(dt, heading),
        motion_process_noise(growth, heading, reach),
    )


def aided_point(form: InertialForm, heading: Any, heading_variance: Any, variance: Any) -> tuple[Any, Any]:
    """Return the vector (2,) from the IMU to the measured point, in W, and the measurement's R (2, 2)."""
    arm, slope = rotate_lever(heading, form.arms.imu_to_aided_point())
    return arm, lever_arm_noise(form.noise.position_noise(variance), slope, heading_variance)


def lever_arm_noise(R: Any, slope: Any, variance: Any) -> Any:
    """Return R (2, 2) with the uncertainty of the heading that turns a lever arm; slope (2,): derivative by heading.

    The dual filters don't estimate heading from positions; they treat the heading error of the lever arm as noise.
    """
    return R + variance * slope[:, None] * slope[None, :]


def belief_covariance(P1: Any, P2: Any, bias_sign: float = 1.0) -> Any:
    """Return the covariance (8, 8) of a Belief from those of the two filters, which are taken as independent.

    bias_sign: -1 where the error state of a bias is true minus estimated, or a feed-forward filter's bias with
    errors of the INS that it makes grow.
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
