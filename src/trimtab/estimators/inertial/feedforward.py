"""Indirect feed-forward form: an INS that is never reset, and the thesis's two filters that estimate its errors.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import planar, wrap
from trimtab.estimators.inertial.aided import Intake, check_intake, initial_inertial_state, listened_sensors, navigate
from trimtab.estimators.inertial.dual_filter import (
    HEADING_ROW,
    POSITION_ROWS,
    InertialNoise,
    aided_point,
    belief_covariance,
    dual_model,
)
from trimtab.estimators.inertial.mechanisation import Belief, InertialStart, LeverArms, mechanise
from trimtab.estimators.inertial.navigation_state import (
    HeadingFix,
    PositionFix,
    first_of_node,
    fuse_heading,
    fuse_position,
)
from trimtab.estimators.kalman import predict


@record
class FeedforwardNode:
    """State of the INS without correction and of its error filters at one instant. Source: [1] chapter 3."""

    t: Scalar = quantity("100 ns", "Time of the filter state.", kind="time")
    imu_reading: Any = quantity(
        "1", "IMU sample: yaw rate (rad/s), specific force forward and starboard (m/s^2).", shape=(3,)
    )
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers: 1 if the sensor cannot be trusted.", shape=(2,))
    heading: Scalar = quantity("rad", "Heading of the INS without correction, unwrapped.", kind="angle")
    velocity: Any = quantity("m/s", "Velocity of the INS without correction.", frame="W", shape=(2,))
    position: Any = quantity("m", "Position of the INS without correction.", frame="W", shape=(2,))
    x1: Any = quantity("1", "Estimated errors: heading (rad), gyro bias (rad/s).", shape=(2,))
    P1: Any = quantity("1", "Covariance of the errors of heading and gyro bias.", shape=(2, 2))
    x2: Any = quantity("1", "Estimated errors: velocity (m/s), position (m), accelerometer biases (m/s^2).", shape=(6,))
    P2: Any = quantity("1", "Covariance of the errors of velocity, position, accelerometer biases.", shape=(6, 6))
    heading_fix: HeadingFix = part("Statistics of the heading updates.")
    position_fix: PositionFix = part("Statistics of the position updates.")


@record
class AidedInertialFeedforward:
    """Aided INS of [1]: an INS that is never corrected, and filters of its errors. The output is the INS minus the
    estimated error.

        heading = phi_ins - x1[0]        yaw rate = w - x1[1]        v = v_ins - x2[:2]        r = r_ins - x2[2:4]

    Valid:         while the INS's errors stay small enough for a linear model. The INS's errors keep growing, because
                   the INS is never reset: after half an hour with biases of 0.1 m/s^2 the INS is 160 km off. This error
                   is still harmless in double precision.
    Not modelled:  effect of a heading error on the velocity. Positions don't correct the heading in this filter.
    Source:        [1] chapter 3; differences from [1]: docs page and Errata.
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

    def first(self) -> FeedforwardNode:
        """Return the filter's initial state, before the first sample."""
        s = self.start
        return FeedforwardNode(
            **first_of_node(),
            heading=jnp.asarray(s.heading, np.float64),
            velocity=s.velocity(),
            position=s.position(),
            x1=np.zeros(2),
            P1=jnp.diag(s.heading_variances()),
            x2=np.zeros(6),
            P2=jnp.diag(s.motion_variances()),
        )

    def propagate(self, node: FeedforwardNode, dt: Any, imu_reading: Any, untrusted: Any) -> FeedforwardNode:
        """Propagate the state by dt (s). imu_reading: IMU sample at the end of the step (3,)."""
        before = node.heading - node.x1[0]
        m = dual_model(self.noise, dt, untrusted, before)
        heading = node.heading + dt / 2 * (imu_reading[0] + node.imu_reading[0])
        x1, P1 = predict(node.x1, node.P1, m.F1, m.Q1)
        f0, f1 = planar(before) @ node.imu_reading[1:], planar(heading - x1[0]) @ imu_reading[1:]
        velocity, position = mechanise(dt, f0, f1, node.velocity, node.position)
        x2, P2 = predict(node.x2, node.P2, m.F2, m.Q2)
        return replace(
            node,
            imu_reading=imu_reading,
            heading=heading,
            velocity=velocity,
            position=position,
            x1=x1,
            P1=P1,
            x2=x2,
            P2=P2,
        )

    def correct_heading(self, node: FeedforwardNode, z: Any, variance: Any = 0.0) -> FeedforwardNode:
        """Correct the state with a measured heading z (rad, modulo 2 pi). If `variance` is 0, use noise.heading."""
        y = wrap(node.heading - z - node.x1[0])[None]
        R = self.noise.heading_noise(variance)
        correction, fix = fuse_heading(self, node, node.x1, node.P1, y, HEADING_ROW, R, sign=-1.0)
        return replace(node, x1=correction.x, P1=correction.P, heading_fix=fix)

    def correct_position(self, node: FeedforwardNode, z: Any, variance: Any = 0.0) -> FeedforwardNode:
        """Correct the state with a measured position z (2,) (m). If `variance` is 0, use noise.position."""
        arm, R = aided_point(self, node.heading - node.x1[0], node.P1[0, 0], variance)
        y = node.position + arm - z - node.x2[2:4]
        correction, fix = fuse_position(self, node, node.x2, node.P2, y, POSITION_ROWS, R, sign=-1.0)
        return replace(node, x2=correction.x, P2=correction.P, position_fix=fix)

    def belief(self, node: FeedforwardNode) -> Belief:
        """Return the estimated motion of the IMU and its covariance, as a Belief."""
        heading = node.heading - node.x1[0]
        kinematic = [heading[None], node.velocity - node.x2[:2], node.position - node.x2[2:4]]
        x = jnp.concatenate([*kinematic, node.x1[1:], node.x2[4:]])
        return Belief(x, belief_covariance(node.P1, node.P2, -1.0))
