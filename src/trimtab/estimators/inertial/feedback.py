"""Indirect feedback form: after each measurement, the estimated errors are removed from the INS.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import wrap
from trimtab.estimators.inertial.aided import Intake, check_intake, initial_inertial_state, listened_sensors, navigate
from trimtab.estimators.inertial.dual_filter import (
    HEADING_ROW,
    POSITION_ROWS,
    InertialNoise,
    aided_point,
    belief_covariance,
    dual_model,
)
from trimtab.estimators.inertial.mechanisation import Belief, InertialStart, LeverArms, mechanise_corrected
from trimtab.estimators.inertial.navigation_state import (
    HeadingFix,
    PositionFix,
    first_of_node,
    fuse_heading,
    fuse_position,
)
from trimtab.estimators.kalman import predict_covariance


@record
class FeedbackNode:
    """State of the filters with feedback at one instant: corrected INS, biases and covariances. Source: [1] chapter
    3."""

    t: Scalar = quantity("100 ns", "Time of the filter state.", kind="time")
    imu_reading: Any = quantity(
        "1", "IMU sample: yaw rate (rad/s), specific force forward and starboard (m/s^2).", shape=(3,)
    )
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers: 1 if the sensor cannot be trusted.", shape=(2,))
    heading: Scalar = quantity("rad", "Heading of the corrected INS, unwrapped.", kind="angle")
    gyro_bias: Scalar = quantity("rad/s", "Bias subtracted from the gyro's readings.")
    velocity: Any = quantity("m/s", "Velocity of the corrected INS.", frame="W", shape=(2,))
    position: Any = quantity("m", "Position of the corrected INS.", frame="W", shape=(2,))
    force_bias: Any = quantity("m/s^2", "Biases subtracted from the accelerometers' readings.", frame="B", shape=(2,))
    P1: Any = quantity("1", "Covariance of the errors of heading and gyro bias.", shape=(2, 2))
    P2: Any = quantity("1", "Covariance of the errors of velocity, position, accelerometer biases.", shape=(6, 6))
    heading_fix: HeadingFix = part("Statistics of the heading updates.")
    position_fix: PositionFix = part("Statistics of the position updates.")


@record
class AidedInertialFeedback:
    """Indirect filter with feedback: after each update the INS and its biases are corrected by the estimated errors,
    and the error states are reset to zero.

    The error states of heading, velocity and position are estimate minus truth. The error states of biases are true
    minus estimated bias. After an update, the bias errors are added to the bias estimates. Between updates the errors
    are zero, and only the covariances are propagated.

    Valid:         for any length of flight, because the INS's errors stay as small as those of the estimate.
    Not modelled:  effect of a heading error on the velocity; see AidedInertialCoupled.
    Source:        [1] chapter 3, which describes this form but flies the feed-forward form.
    """

    intake: Intake = part("Sensors that the filter reads, and checks of the samples.", default=Intake())
    noise: InertialNoise = part("Noise of the IMU and of the aiding sensors.", default=InertialNoise())
    start: InertialStart = part("Initial estimate and its uncertainty.", default=InertialStart())
    arms: LeverArms = part("Positions of the sensors on the vehicle.", default=LeverArms())

    AIDED_BY: ClassVar[str] = "positions"
    ANY_ORDER: ClassVar[bool] = True
    listens = property(listened_sensors)
    check = check_intake
    init = initial_inertial_state
    step = navigate

    def first(self) -> FeedbackNode:
        """Return the filter's initial state, before the first sample."""
        s = self.start
        return FeedbackNode(
            **first_of_node(),
            heading=jnp.asarray(s.heading, np.float64),
            gyro_bias=np.float64(0),
            velocity=s.velocity(),
            position=s.position(),
            force_bias=np.zeros(2),
            P1=jnp.diag(s.heading_variances()),
            P2=jnp.diag(s.motion_variances()),
        )

    def propagate(self, node: FeedbackNode, dt: Any, imu_reading: Any, untrusted: Any) -> FeedbackNode:
        """Propagate the state by dt (s). imu_reading: IMU sample at the end of the step (3,).

        Accelerometer biases are turned to W with the heading at the start of the step, as in Phi2.
        """
        m = dual_model(self.noise, dt, untrusted, node.heading)
        x = node.heading, node.velocity, node.position, node.gyro_bias, node.force_bias
        heading, velocity, position = mechanise_corrected(dt, node.imu_reading, imu_reading, x)
        P1, P2 = predict_covariance(node.P1, m.F1, m.Q1), predict_covariance(node.P2, m.F2, m.Q2)
        return replace(
            node, imu_reading=imu_reading, heading=heading, velocity=velocity, position=position, P1=P1, P2=P2
        )

    def correct_heading(self, node: FeedbackNode, z: Any, variance: Any = 0.0) -> FeedbackNode:
        """Correct the state with a measured heading z (rad, modulo 2 pi). If `variance` is 0, use noise.heading."""
        y = wrap(node.heading - z)[None]
        R = self.noise.heading_noise(variance)
        correction, fix = fuse_heading(self, node, jnp.zeros(2), node.P1, y, HEADING_ROW, R, sign=-1.0)
        return replace(
            node,
            heading=node.heading - correction.x[0],
            gyro_bias=node.gyro_bias + correction.x[1],
            P1=correction.P,
            heading_fix=fix,
        )

    def correct_position(self, node: FeedbackNode, z: Any, variance: Any = 0.0) -> FeedbackNode:
        """Correct the state with a measured position z (2,) (m). If `variance` is 0, use noise.position."""
        arm, R = aided_point(self, node.heading, node.P1[0, 0], variance)
        y = node.position + arm - z
        correction, fix = fuse_position(self, node, jnp.zeros(6), node.P2, y, POSITION_ROWS, R, sign=-1.0)
        return replace(
            node,
            velocity=node.velocity - correction.x[:2],
            position=node.position - correction.x[2:4],
            force_bias=node.force_bias + correction.x[4:],
            P2=correction.P,
            position_fix=fix,
        )

    def belief(self, node: FeedbackNode) -> Belief:
        """Return the estimated motion of the IMU and its covariance, as a Belief."""
        x = jnp.concatenate([node.heading[None], node.velocity, node.position, node.gyro_bias[None], node.force_bias])
        return Belief(x, belief_covariance(node.P1, node.P2, -1.0))
