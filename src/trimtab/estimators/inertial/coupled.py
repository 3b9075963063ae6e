"""Coupled extended Kalman filter: one covariance for all states, so that positions alone correct the heading.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3;
[5] Schmidt 1966 for states that are considered but not corrected.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rotation import planar, wrap
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.aided import Intake, check_intake, initial_inertial_state, listened_sensors, navigate
from trimtab.estimators.inertial.dual_filter import (
    InertialNoise,
    belief_covariance,
    heading_process_noise,
    motion_process_noise,
)
from trimtab.estimators.inertial.mechanisation import (
    Belief,
    InertialStart,
    LeverArms,
    mechanise_corrected,
    rotate_lever,
)
from trimtab.estimators.inertial.navigation_state import (
    HeadingFix,
    PositionFix,
    first_of_node,
    fuse_heading,
    fuse_position,
)
from trimtab.estimators.kalman import Update, predict_covariance

SIGNS = np.array([1.0, 1, 1, 1, 1, -1, -1, -1])
"""Sign of each error state: 1 if the error is estimate minus truth, -1 (biases) if it is truth minus estimate."""


@record
class CoupledNode:
    """State of the coupled filter at one instant: corrected INS, biases and covariance. Source: [1] chapter 3."""

    t: Scalar = quantity("100 ns", "Time of the filter state.", kind="time")
    imu_reading: Any = quantity(
        "1", "IMU sample: yaw rate (rad/s), specific force forward and starboard (m/s^2).", shape=(3,)
    )
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers: 1 if the sensor cannot be trusted.", shape=(2,))
    x: Any = quantity(
        "1", "Heading, velocity, position, gyro bias, accelerometer biases (8,), in the order of Belief.x.", shape=(8,)
    )
    P: Any = quantity(
        "1",
        "Covariance of the error states: heading, velocity, position, gyro bias, accelerometer biases.",
        shape=(8, 8),
    )
    force: Any = quantity(
        "m/s^2", "Low-pass filtered specific force, corrected for bias, used in the Jacobian.", frame="B", shape=(2,)
    )
    steady: Any = quantity(
        "m/s^2", "Low-pass filtered specific force, corrected for bias, used to detect rest.", frame="B", shape=(2,)
    )
    heading_fix: HeadingFix = part("Statistics of the heading updates.")
    position_fix: PositionFix = part("Statistics of the position updates.")


@record
class AidedInertialCoupled:
    """Extended Kalman filter of eight error states with feedback. The heading is observable under specific force.

        dphi' = -db      dv' = J f dphi - B da      dr' = dv      J f = (-f_east, f_north)      (d = estimate - truth)

    phi is the heading, v the velocity, r the position, b the gyro bias, a the accelerometer biases, and f the specific
    force. B turns vectors from body axes to W. While the low-passed force is within `rest_sigmas` standard deviations
    of zero (noise and accelerometer biases), positions contain no information about the heading. Heading and gyro bias
    are then considered, not corrected ([5]).

    Valid:   near the truth. An initial heading error above about half a radian makes the filter overconfident.
             At rest the heading is not observable, and its error grows with the gyro's bias.
    Source:  [1] chapter 3; low-pass filters and detection of rest: reconstructed, see docs page.
    """

    intake: Intake = part(
        "Sensors that the filter reads, and checks of the samples. The heading sensor is optional.",
        default=Intake(heading=""),
    )
    noise: InertialNoise = part("Noise of the IMU and of the aiding sensors.", default=InertialNoise())
    start: InertialStart = part("Initial estimate and its uncertainty.", default=InertialStart())
    arms: LeverArms = part("Positions of the sensors on the vehicle.", default=LeverArms())
    smoothing: Scalar = quantity(
        "s", "Time constant of the low-pass filter of the specific force used in the Jacobian.", default=0.05, low=0
    )
    rest_smoothing: Scalar = quantity(
        "s", "Time constant of the low-pass filter of the specific force used to detect rest.", default=0.5, low=0
    )
    rest_sigmas: Scalar = quantity(
        "1",
        "Number of standard deviations below which the specific force counts as zero; 0 for never.",
        default=3.0,
        low=0,
    )
    rest: str = option(
        "Treatment of heading and gyro bias at rest: consider their uncertainty only, or correct them.",
        default="consider",
        choices=("consider", "correct"),
    )

    AIDED_BY: ClassVar[str] = "positions"
    ANY_ORDER: ClassVar[bool] = True
    listens = property(listened_sensors)
    check = check_intake
    init = initial_inertial_state
    step = navigate

    def first(self) -> CoupledNode:
        """Return the filter's initial state, before the first sample."""
        s = self.start
        return CoupledNode(
            **first_of_node(),
            x=jnp.concatenate([s.pose(), jnp.zeros(3)]),
            P=jnp.diag(s.variances()),
            force=np.zeros(2),
            steady=np.zeros(2),
        )

    def propagate(self, node: CoupledNode, dt: Any, imu_reading: Any, untrusted: Any) -> CoupledNode:
        """Propagate the state by dt (s). imu_reading: IMU sample at the end of the step (3,).

        Accelerometer biases are turned to W with the heading at the start of the step, as in Phi.
        """
        m = propagate_coupled(self, node, dt, imu_reading, untrusted)
        P = predict_covariance(node.P, m.F, m.Q)
        return replace(node, imu_reading=imu_reading, x=m.x, P=P, force=m.force, steady=m.steady)

    def correct_heading(self, node: CoupledNode, z: Any, variance: Any = 0.0) -> CoupledNode:
        """Correct the state with a measured heading z (rad, modulo 2 pi). If `variance` is 0, use noise.heading."""
        H = jnp.zeros((1, 8)).at[0, 0].set(1.0)
        R = self.noise.heading_noise(variance)
        y = wrap(node.x[0] - z)[None]
        correction, fix = fuse_heading(self, node, jnp.zeros(8), node.P, y, H, R, sign=-1.0)
        return replace(_reset_errors(node, correction), heading_fix=fix)

    def correct_position(self, node: CoupledNode, z: Any, variance: Any = 0.0) -> CoupledNode:
        """Correct the state with a measured position z (2,) (m). If `variance` is 0, use noise.position."""
        arm, slope = rotate_lever(node.x[0], self.arms.imu_to_aided_point())
        none = jnp.zeros((2, 2))
        H = jnp.concatenate([slope[:, None], none, jnp.eye(2), jnp.zeros((2, 3))], axis=1)
        y = node.x[3:5] + arm - z
        R = self.noise.position_noise(variance)
        consider = None
        if self.rest == "consider":
            learns = jnp.where(self.is_force_observable(node), 1.0, 0.0)
            one = jnp.ones(4)
            consider = jnp.concatenate([learns[None], one, learns[None], one[:2]])
        correction, fix = fuse_position(self, node, jnp.zeros(8), node.P, y, H, R, consider=consider, sign=-1.0)
        return replace(_reset_errors(node, correction), position_fix=fix)

    def is_force_observable(self, node: CoupledNode) -> Any:
        """Return True if the low-passed force differs significantly from zero, so that the heading is observable."""
        return is_force_significant(node.steady, node.P, self.noise, self.rest_smoothing, self.rest_sigmas)

    def belief(self, node: CoupledNode) -> Belief:
        """Return the estimated motion of the IMU and its covariance, as a Belief."""
        return Belief(node.x, node.P * SIGNS[:, None] * SIGNS[None, :])


def is_force_significant(steady: Any, P: Any, noise: InertialNoise, smoothing: Any, sigmas: Any) -> Any:
    """Return True if a low-passed force (2,) differs from zero by at least `sigmas` standard deviations.

    P: covariance with the accelerometer biases at the indices 6 and 7.  smoothing: time constant of the low-pass (s).
    """
    tick = to_seconds(noise.tick)
    white = (noise.forward + noise.starboard) * tick / (tick + 2 * smoothing)
    return steady @ steady >= sigmas**2 * (white + P[6, 6] + P[7, 7])


class CoupledMotion(NamedTuple):
    """Step of the coupled filter: the new state, both low-passed forces (2,), transition matrix Phi and process noise Q
    of the errors (8, 8)."""

    x: Any
    force: Any
    steady: Any
    F: Any
    Q: Any


def propagate_coupled(form: Any, node: Any, dt: Any, imu_reading: Any, untrusted: Any) -> CoupledMotion:
    """Return the result of a step of dt (s) from a filter state (node) whose x begins with the values of Belief.x.

    form: filter with noise, smoothing and rest_smoothing.  imu_reading: IMU sample at the end of the step (3,).
    untrusted: as in `InertialForm.propagate`.
    """
    x = node.x
    parts = x[0], x[1:3], x[3:5], x[5], x[6:8]
    heading, velocity, position = mechanise_corrected(dt, node.imu_reading, imu_reading, parts)
    mean = (node.imu_reading[1:] + imu_reading[1:]) / 2 - x[6:8]
    force = node.force + low_pass_gain(dt, form.smoothing) * (mean - node.force)
    steady = node.steady + low_pass_gain(dt, form.rest_smoothing) * (mean - node.steady)
    growth = form.noise.growth(dt, untrusted)
    F = coupled_transition(dt, x[0], force)
    Q = coupled_process_noise(growth, x[0], form.noise.integration_time(dt))
    return CoupledMotion(jnp.concatenate([heading[None], velocity, position, x[5:]]), force, steady, F, Q)


def low_pass_gain(dt: Any, constant: Any) -> Any:
    """Return the gain, 0 to 1, of a first-order low-pass filter over a step dt (s)."""
    return jnp.where(dt > 0, dt / jnp.where(dt > 0, dt + constant, 1.0), 0.0)


def coupled_transition(dt: Any, heading: Any, force: Any) -> Any:
    """Return the transition matrix Phi (8, 8) of the errors of the eight states in Belief.x, for a constant specific
    force.

    Errors of biases are truth minus estimate.  dt: step (s).  heading: (rad).  force: specific force in B (2,).
    Source: [1] chapter 3; the series of exp(A dt) ends with the third power, because A^4 = 0.
    """
    B = planar(heading)
    turned = (B @ jnp.stack([-force[1], force[0]]))[:, None]
    eye, column, row = jnp.eye(2), jnp.zeros((2, 1)), jnp.zeros((1, 2))
    one = jnp.ones((1, 1))
    return jnp.concatenate(
        [
            jnp.concatenate([one, row, row, dt * one, row], axis=1),
            jnp.concatenate([dt * turned, eye, 0 * eye, dt**2 / 2 * turned, dt * B], axis=1),
            jnp.concatenate([dt**2 / 2 * turned, dt * eye, eye, dt**3 / 6 * turned, dt**2 / 2 * B], axis=1),
            jnp.concatenate([0 * one, row, row, one, row], axis=1),
            jnp.concatenate([column, 0 * eye, 0 * eye, column, eye], axis=1),
        ]
    )


def coupled_process_noise(growth: Any, heading: Any, reach: Any) -> Any:
    """Return the process noise Q (8, 8) of the eight states in Belief.x, with the same noise as in the dual filter.

    growth: `InertialNoise.growth`.  reach: `InertialNoise.integration_time`.
    """
    Q1, Q2 = heading_process_noise(growth, reach), motion_process_noise(growth, heading, reach)
    return belief_covariance(Q1, Q2)


def _reset_errors(node: CoupledNode, correction: Update) -> CoupledNode:
    return replace(node, x=node.x - SIGNS * correction.x, P=correction.P)
