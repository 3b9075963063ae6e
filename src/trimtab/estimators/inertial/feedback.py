"""Indirect feedback form: the estimated errors are taken out of the INS at once, which then runs on corrected.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, Frame
from trimtab.estimators.inertial.aided import InertialState, Intake, initial_inertial_state, navigate
from trimtab.estimators.inertial.dual_filter import (
    HEADING_ROW,
    POSITION_ROWS,
    InertialNoise,
    belief_covariance,
    heading_process_noise,
    heading_transition,
    lever_arm_noise,
    motion_process_noise,
    motion_transition,
)
from trimtab.estimators.inertial.mechanisation import Belief, InertialStart, LeverArms, mechanise, rotate_lever
from trimtab.estimators.inertial.navigation_state import (
    HeadingFix,
    PositionFix,
    fuse_measurement,
    no_heading_fix,
    no_position_fix,
)
from trimtab.estimators.inertial.sensor_watch import NEVER
from trimtab.estimators.kalman import predict_covariance


@record
class FeedbackNode:
    """Corrected INS, its biases and their covariances at one instant. Source: [1] chapter 3."""

    t: Scalar = quantity("100 ns", "The instant.", kind="time")
    felt: Any = quantity("1", "IMU: yaw rate (rad/s), force per mass forward and starboard (m/s^2).", shape=(3,))
    doubt: Any = quantity("1", "1 where gyro, or accelerometers, can't be trusted.", shape=(2,))
    heading: Scalar = quantity("rad", "Heading; unwrapped.", kind="angle")
    gyro_bias: Scalar = quantity("rad/s", "What is taken off the gyro.")
    velocity: Any = quantity("m/s", "Velocity.", frame="W", shape=(2,))
    position: Any = quantity("m", "Position.", frame="W", shape=(2,))
    force_bias: Any = quantity("m/s^2", "What is taken off the accelerometers.", frame="B", shape=(2,))
    P1: Any = quantity("1", "Covariance of the errors: heading, gyro bias.", shape=(2, 2))
    P2: Any = quantity("1", "Covariance of the errors: velocity, position, force biases.", shape=(6, 6))
    heading_fix: HeadingFix = part("How headings fared.")
    position_fix: PositionFix = part("How positions fared.")


@record
class AidedInertialFeedback:
    """Closed loop: after each update the errors go back into the INS and its biases, and are zero again.

    The error states are estimate minus truth for heading, velocity and position, and true minus estimated bias for the
    biases, which are added to the bias estimates. Between updates the errors are zero, so only covariances move.

    Valid:         for ever: the INS's own errors stay as small as those of the estimate.
    Not modelled:  what a heading error does to velocity; see AidedInertialCoupled.
    Source:        [1] chapter 3, which describes this form and flies the feed-forward one.
    """

    intake: Intake = part("Which samples are read.", default=Intake())
    noise: InertialNoise = part("Of IMU and aiding.", default=InertialNoise())
    start: InertialStart = part("What is believed at first.", default=InertialStart())
    arms: LeverArms = part("Where the sensors sit.", default=LeverArms())

    ANY_ORDER: ClassVar[bool] = True

    @property
    def listens(self) -> tuple[str, ...]:
        """The IMU and what aids it."""
        return self.intake.listens()

    def check(self) -> None:
        """Refuse an intake that can't work."""
        self.intake.check()

    def init(self, key: Key) -> InertialState:
        """Nothing measured yet."""
        return initial_inertial_state(self)

    def step(self, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
        """The estimate at integer time t; its state is a NavigationState."""
        return navigate(self, t, state, frame)

    def first(self) -> FeedbackNode:
        """Before the first sample."""
        s = self.start
        return FeedbackNode(
            t=np.int64(NEVER),
            felt=np.zeros(3),
            doubt=np.zeros(2),
            heading=jnp.asarray(s.heading, np.float64),
            gyro_bias=np.float64(0),
            velocity=s.velocity(),
            position=s.position(),
            force_bias=np.zeros(2),
            P1=jnp.diag(s.heading_variances()),
            P2=jnp.diag(s.motion_variances()),
            heading_fix=no_heading_fix(),
            position_fix=no_position_fix(),
        )

    def propagate(self, node: FeedbackNode, dt: Any, felt: Any, doubt: Any) -> FeedbackNode:
        """A time dt (s) on, to where the IMU reads felt (3,); biases act with the heading at its start, as in Phi2."""
        growth, reach = self.noise.growth(dt, doubt), self.noise.integration_time(dt)
        B = planar(node.heading)
        heading = node.heading + dt / 2 * (felt[0] + node.felt[0]) - dt * node.gyro_bias
        bias = B @ node.force_bias
        f0, f1 = B @ node.felt[1:] - bias, planar(heading) @ felt[1:] - bias
        velocity, position = mechanise(dt, f0, f1, node.velocity, node.position)
        P1 = predict_covariance(node.P1, heading_transition(dt), heading_process_noise(growth, reach))
        P2 = predict_covariance(
            node.P2, motion_transition(dt, node.heading), motion_process_noise(growth, node.heading, reach)
        )
        return replace(node, felt=felt, heading=heading, velocity=velocity, position=position, P1=P1, P2=P2)

    def correct_heading(self, node: FeedbackNode, z: Any, variance: Any = 0.0) -> FeedbackNode:
        """With a heading z (rad), any equal of it, of its own variance, or of noise.heading where that is 0."""
        y = wrap(node.heading - z)[None]
        R = self.noise.heading_noise(variance)
        believed = {"gate": self.intake.gate_heading, "patience": self.intake.patience_heading}
        done, fix = fuse_measurement(node.heading_fix, jnp.zeros(2), node.P1, y, HEADING_ROW, R, sign=-1.0, **believed)
        return replace(
            node,
            heading=node.heading - done.x[0],
            gyro_bias=node.gyro_bias + done.x[1],
            P1=done.P,
            heading_fix=fix,
        )

    def correct_position(self, node: FeedbackNode, z: Any, variance: Any = 0.0) -> FeedbackNode:
        """With a position z (2,) of the aided point; its variance as for headings."""
        arm, slope = rotate_lever(node.heading, self.arms.imu_to_aided_point())
        R = lever_arm_noise(self.noise.position_noise(variance), slope, node.P1[0, 0])
        y = node.position + arm - z
        believed = {"gate": self.intake.gate_position, "patience": self.intake.patience_position}
        done, fix = fuse_measurement(
            node.position_fix, jnp.zeros(6), node.P2, y, POSITION_ROWS, R, sign=-1.0, **believed
        )
        return replace(
            node,
            velocity=node.velocity - done.x[:2],
            position=node.position - done.x[2:4],
            force_bias=node.force_bias + done.x[4:],
            P2=done.P,
            position_fix=fix,
        )

    def belief(self, node: FeedbackNode) -> Belief:
        """Of the IMU's point."""
        x = jnp.concatenate([node.heading[None], node.velocity, node.position, node.gyro_bias[None], node.force_bias])
        return Belief(x, belief_covariance(node.P1, node.P2, -1.0))
