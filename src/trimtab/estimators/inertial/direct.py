"""Direct form: the filters' states are heading, velocity, position and biases, not the errors of an INS.

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
    heading_transition,
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
class DirectNode:
    """State of the direct filters at one instant: total states and their covariances. Source: [1] chapter 3."""

    t: Scalar = quantity("100 ns", "Time of the filter state.", kind="time")
    imu_reading: Any = quantity(
        "1", "IMU sample: yaw rate (rad/s), specific force forward and starboard (m/s^2).", shape=(3,)
    )
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers: 1 if the sensor cannot be trusted.", shape=(2,))
    x1: Any = quantity("1", "Estimated heading (rad, unwrapped) and gyro bias (rad/s).", shape=(2,))
    P1: Any = quantity("1", "Covariance of the errors of heading and gyro bias.", shape=(2, 2))
    x2: Any = quantity("1", "Estimated velocity (m/s), position (m), accelerometer biases (m/s^2).", shape=(6,))
    P2: Any = quantity("1", "Covariance of the errors of velocity, position, accelerometer biases.", shape=(6, 6))
    heading_fix: HeadingFix = part("Statistics of the heading updates.")
    position_fix: PositionFix = part("Statistics of the position updates.")


@record
class AidedInertialDirect:
    """Filters of total states. The process model is the mechanisation with the IMU as input, linearised at each sample.

        heading' = w - bias        v' = B(heading) (F - bias)        r' = v        biases' = 0 + noise

    w is the reading of the gyro, F that of the accelerometers, v the velocity and r the position. B turns vectors from
    body axes to W.

    Valid:         under the same conditions as the feedback form. Both forms have the same estimate except for
                   rounding. The filter contains the whole state, which other process models require, e.g. a vehicle's
                   dynamics.
    Not modelled:  effect of a heading error on the velocity; see AidedInertialCoupled.
    Source:        [1] chapter 3, where this form is described but not flown.
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

    def first(self) -> DirectNode:
        """Return the filter's initial state, before the first sample."""
        s = self.start
        return DirectNode(
            **first_of_node(),
            x1=jnp.stack([jnp.asarray(s.heading, np.float64), jnp.zeros(())]),
            P1=jnp.diag(s.heading_variances()),
            x2=jnp.concatenate([s.velocity(), s.position(), jnp.zeros(2)]),
            P2=jnp.diag(s.motion_variances()),
        )

    def propagate(self, node: DirectNode, dt: Any, imu_reading: Any, untrusted: Any) -> DirectNode:
        """Propagate the state by dt (s). imu_reading: IMU sample at the end of the step (3,)."""
        m = dual_model(self.noise, dt, untrusted, node.x1[0])
        turned = jnp.stack([dt / 2 * (imu_reading[0] + node.imu_reading[0]), jnp.zeros(())])
        x1, P1 = predict(node.x1, node.P1, heading_transition(-dt), m.Q1)
        x1 = x1 + turned
        f0, f1 = planar(node.x1[0]) @ node.imu_reading[1:], planar(x1[0]) @ imu_reading[1:]
        gained = jnp.concatenate([*mechanise(dt, f0, f1, jnp.zeros(2), jnp.zeros(2)), jnp.zeros(2)])
        x2, P2 = predict(node.x2, node.P2, _total_transition(m.F2), m.Q2)
        return replace(node, imu_reading=imu_reading, x1=x1, P1=P1, x2=x2 + gained, P2=P2)

    def correct_heading(self, node: DirectNode, z: Any, variance: Any = 0.0) -> DirectNode:
        """Correct the state with a measured heading z (rad, modulo 2 pi). If `variance` is 0, use noise.heading."""
        R = self.noise.heading_noise(variance)
        correction, fix = fuse_heading(self, node, node.x1, node.P1, wrap(z - node.x1[0])[None], HEADING_ROW, R)
        return replace(node, x1=correction.x, P1=correction.P, heading_fix=fix)

    def correct_position(self, node: DirectNode, z: Any, variance: Any = 0.0) -> DirectNode:
        """Correct the state with a measured position z (2,) (m). If `variance` is 0, use noise.position."""
        arm, R = aided_point(self, node.x1[0], node.P1[0, 0], variance)
        y = z - node.x2[2:4] - arm
        correction, fix = fuse_position(self, node, node.x2, node.P2, y, POSITION_ROWS, R)
        return replace(node, x2=correction.x, P2=correction.P, position_fix=fix)

    def belief(self, node: DirectNode) -> Belief:
        """Return the estimated motion of the IMU and its covariance, as a Belief."""
        x = jnp.concatenate([node.x1[:1], node.x2[:4], node.x1[1:], node.x2[4:]])
        return Belief(x, belief_covariance(node.P1, node.P2))


def _total_transition(transition: Any) -> Any:
    """Return the transition matrix Phi2 of total states, computed from the transition matrix of error states.

    The blocks of the biases have opposite signs.
    """
    signs = jnp.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
    return transition * signs[:, None] * signs[None, :]
