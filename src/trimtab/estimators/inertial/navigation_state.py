"""Output of an aided inertial navigation system: state at the vehicle's reference point, its uncertainty, and
statistics of the fused measurements.

Source: docs page, Aided inertial navigation.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.interfaces import InertialForm
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rotation import planar
from trimtab.estimators.inertial.mechanisation import DIMENSION, Belief, LeverArms, rotate_lever
from trimtab.estimators.inertial.sensor_watch import NEVER, SensorWatch, increment
from trimtab.estimators.kalman import NO_GATE, CovarianceHealth, Update, covariance_health, inflate_covariance, update


@record
class HeadingFix:
    """Statistics of the heading updates. Source: docs page, Aided inertial navigation."""

    innovation: Any = quantity("rad", "Innovation: measured minus predicted heading.", kind="angle", shape=(1,))
    normalised: Any = quantity("1", "Heading innovation divided by its standard deviation.", shape=(1,))
    nis: Scalar = quantity(
        "1", "NIS of the heading: squared innovation divided by its variance; chi-square with one degree of freedom."
    )
    used: Scalar = quantity("1", "Number of headings used so far.", kind="count")
    rejected: Scalar = quantity("1", "Number of headings rejected by the gate so far.", kind="count")
    rejected_in_a_row: Scalar = quantity(
        "1", "Number of measurements rejected since the last accepted one.", kind="count"
    )
    forced: Scalar = quantity(
        "1",
        "Number of times the filter accepted a measurement outside the gate after too many rejections in a row.",
        kind="count",
    )


@record
class PositionFix:
    """Statistics of the position updates. Source: docs page, Aided inertial navigation."""

    innovation: Any = quantity(
        "m", "Innovation: measured minus predicted position, north and east.", frame="W", shape=(2,)
    )
    normalised: Any = quantity("1", "Position innovations divided by their standard deviations.", shape=(2,))
    nis: Scalar = quantity(
        "1",
        "NIS of the position: y' S^-1 y, with the innovation y and its covariance S; chi-square with two "
        "degrees of freedom.",
    )
    used: Scalar = quantity("1", "Number of positions used so far.", kind="count")
    rejected: Scalar = quantity("1", "Number of positions rejected by the gate so far.", kind="count")
    rejected_in_a_row: Scalar = quantity(
        "1", "Number of measurements rejected since the last accepted one.", kind="count"
    )
    forced: Scalar = quantity(
        "1",
        "Number of times the filter accepted a measurement outside the gate after too many rejections in a row.",
        kind="count",
    )


@record
class NavigationState:
    """Estimated state of a vehicle in the plane, and its uncertainty. The first fields are those that planar laws read.

    Velocity and position are those of the vehicle's reference point, not of the IMU.
    Source: docs page, Aided inertial navigation.
    """

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B")
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B")
    heading: Scalar = quantity(
        "rad", "Heading: angle from north to the body's x axis, clockwise, not wrapped to one turn.", kind="angle"
    )
    north: Scalar = quantity("m", "North position of the reference point.", frame="W")
    east: Scalar = quantity("m", "East position of the reference point.", frame="W")
    sigma_surge_velocity: Scalar = quantity("m/s", "Standard deviation of the velocity along the body's x axis.")
    sigma_sway_velocity: Scalar = quantity("m/s", "Standard deviation of the velocity along the body's y axis.")
    sigma_yaw_rate: Scalar = quantity("rad/s", "Standard deviation of the yaw rate, including the gyro's noise.")
    sigma_heading: Scalar = quantity("rad", "Standard deviation of the heading.")
    sigma_north: Scalar = quantity("m", "Standard deviation of the north position.")
    sigma_east: Scalar = quantity("m", "Standard deviation of the east position.")
    gyro_bias: Scalar = quantity("rad/s", "Estimated bias of the gyro.")
    forward_bias: Scalar = quantity("m/s^2", "Estimated bias of the forward accelerometer.")
    starboard_bias: Scalar = quantity("m/s^2", "Estimated bias of the starboard accelerometer.")
    sigma_gyro_bias: Scalar = quantity("rad/s", "Standard deviation of the gyro bias.")
    sigma_forward_bias: Scalar = quantity("m/s^2", "Standard deviation of the forward accelerometer bias.")
    sigma_starboard_bias: Scalar = quantity("m/s^2", "Standard deviation of the starboard accelerometer bias.")
    heading_fix: Any = part("Statistics of the heading updates.")
    position_fix: Any = part("Statistics of the position updates.")
    covariance: CovarianceHealth = part("Checks of the filter's covariance.")
    imu: SensorWatch = part("Checks of the IMU's samples.")
    heading_sensor: Any = part("Checks of the heading sensor's samples; None without a heading sensor.")
    position_sensor: Any = part("Checks of the position sensor's samples; None without a position sensor.")
    coasting: Scalar = quantity(
        "1",
        "True if no IMU data arrive. The filter then assumes constant velocity, and the standard deviations grow.",
        kind="flag",
    )
    clock_backwards: Scalar = quantity("1", "Number of times the autopilot's clock ran backwards.", kind="count")


def no_heading_fix() -> HeadingFix:
    """Return the statistics of heading updates before the first measurement."""
    none = np.int32(0)
    return HeadingFix(np.zeros(1), np.zeros(1), np.float64(0), none, none, none, none)


def no_position_fix() -> PositionFix:
    """Return the statistics of position updates before the first measurement."""
    none = np.int32(0)
    return PositionFix(np.zeros(2), np.zeros(2), np.float64(0), none, none, none, none)


def first_of_node(position_fix: Any = None) -> dict[str, Any]:
    """Return the initial values of the fields that the states (nodes) of all inertial filters share.

    position_fix: initial statistics of the position updates; default: a PositionFix.
    """
    return {
        "t": np.int64(NEVER),
        "imu_reading": np.zeros(3),
        "untrusted": np.zeros(2),
        "heading_fix": no_heading_fix(),
        "position_fix": no_position_fix() if position_fix is None else position_fix,
    }


def fuse_heading(
    form: InertialForm, node: Any, x: Any, P: Any, y: Any, H: Any, R: Any, *, consider: Any = None, sign: float = 1.0
) -> tuple[Update, HeadingFix]:
    """Return the update of x and P with a heading, using the gate of the filter's intake, and the new statistics.

    Other arguments are those of `fuse_measurement`.
    """
    gate, patience = form.intake.gate_heading, form.intake.patience_heading
    return fuse_measurement(node.heading_fix, x, P, y, H, R, gate=gate, patience=patience, consider=consider, sign=sign)


def fuse_position(
    form: InertialForm, node: Any, x: Any, P: Any, y: Any, H: Any, R: Any, *, consider: Any = None, sign: float = 1.0
) -> tuple[Update, PositionFix]:
    """Return the update of x and P with a position, using the gate of the filter's intake, and the new statistics.

    Other arguments are those of `fuse_measurement`.
    """
    gate, patience = form.intake.gate_position, form.intake.patience_position
    return fuse_measurement(
        node.position_fix, x, P, y, H, R, gate=gate, patience=patience, consider=consider, sign=sign
    )


def fuse_measurement(
    fix: Any,
    x: Any,
    P: Any,
    y: Any,
    H: Any,
    R: Any,
    *,
    gate: Any,
    patience: Any,
    consider: Any = None,
    sign: float = 1.0,
) -> tuple[Update, Any]:
    """Return the result of one update, and its statistics, a HeadingFix or PositionFix.

    After `patience` consecutive rejections, the next measurement is accepted even if it is outside the gate. The
    covariance is first inflated until the innovation is plausible. If patience is 0, this never happens. The other
    arguments are those of `kalman.update` and `count_measurement`.
    """
    patience = jnp.asarray(patience)
    gives = (patience > 0) & (fix.rejected_in_a_row >= patience)
    wider = jnp.where(gives, inflate_covariance(P, y, H, R), P)
    correction = update(x, wider, y, H, R, gate=jnp.where(gives, NO_GATE, gate), consider=consider)
    correction = correction._replace(P=jnp.where(correction.accepted, correction.P, P))
    fix = count_measurement(fix, correction, sign)
    return correction, replace(fix, forced=increment(fix.forced, gives & correction.accepted))


def count_measurement(fix: Any, correction: Update, sign: float = 1.0) -> Any:
    """Return the statistics, a HeadingFix or PositionFix, after one more measurement.

    sign: -1 if the update's innovation is predicted minus measured, else 1.
    """
    S = correction.S
    sigma = jnp.sqrt(jnp.stack([S[j, j] for j in range(S.shape[0])]))
    refused = correction.finite & ~correction.accepted
    in_a_row = jnp.where(correction.accepted, 0, increment(fix.rejected_in_a_row, refused)).astype(np.int32)
    return replace(
        fix,
        innovation=sign * correction.innovation,
        normalised=sign * correction.innovation / sigma,
        nis=correction.nis,
        used=increment(fix.used, correction.accepted),
        rejected=increment(fix.rejected, refused),
        rejected_in_a_row=in_a_row,
    )


def reference_kinematics(belief: Belief, rate: Any, gyro_variance: Any, arms: LeverArms) -> dict[str, Any]:
    """Return the kinematic fields of NavigationState, from an estimate (Belief) of the IMU's motion.

    rate: reading of the gyro (rad/s).  gyro_variance: variance of the gyro's noise.  arms: positions of the sensors.
    """
    x, P = belief
    B = planar(x[0])
    yaw_rate = rate - x[5]
    v = B.T @ x[1:3]
    arm, slope = rotate_lever(x[0], arms.imu)
    surge, sway = v[0] + yaw_rate * arms.imu[1], v[1] - yaw_rate * arms.imu[0]
    lever = jnp.stack([-arms.imu[1], arms.imu[0]])
    none, eye = jnp.zeros((3, 2)), jnp.eye(2)  # these quantities don't depend on the accelerometer biases
    by_heading = jnp.concatenate([jnp.stack([v[1], -v[0]]), jnp.zeros(1), -slope])[:, None]
    by_velocity = jnp.concatenate([B.T, none])
    by_position = jnp.concatenate([none, eye])
    by_rate_bias = jnp.concatenate([lever, -jnp.ones(1), jnp.zeros(2)])[:, None]
    J = jnp.concatenate([by_heading, by_velocity, by_position, by_rate_bias], axis=1)
    noise = gyro_variance * by_rate_bias[:, 0] ** 2
    outer = jnp.sqrt(jnp.maximum(jnp.sum((J @ P[:6, :6]) * J, axis=1) + noise, 0.0))
    own = [jnp.sqrt(jnp.maximum(P[j, j], 0.0)) for j in range(DIMENSION)]
    names = ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east")
    sigmas = {f"sigma_{name}": outer[j] for j, name in enumerate(names)}
    return sigmas | {
        "surge_velocity": surge,
        "sway_velocity": sway,
        "yaw_rate": yaw_rate,
        "heading": x[0],
        "north": x[3] - arm[0],
        "east": x[4] - arm[1],
        "gyro_bias": x[5],
        "forward_bias": x[6],
        "starboard_bias": x[7],
        "sigma_heading": own[0],
        "sigma_gyro_bias": own[5],
        "sigma_forward_bias": own[6],
        "sigma_starboard_bias": own[7],
        "covariance": covariance_health(P),
    }
