"""Inertial navigation aided by raw ultrasonic ranges. Each ping is fused at the time at which it was sent.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.linalg import symmetric
from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, Frame
from trimtab.estimators.inertial.aided import InertialState, Intake, initial_inertial_state, listened_sensors, navigate
from trimtab.estimators.inertial.coupled import SIGNS, is_force_significant, propagate_coupled
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import DIMENSION, Belief, InertialStart, LeverArms
from trimtab.estimators.inertial.navigation_state import HeadingFix, first_of_node, fuse_heading
from trimtab.estimators.inertial.sensor_watch import increment
from trimtab.estimators.ranging.position import ALL, ONE_REJECTED, PAIR, SQUARE, RangingPosition, check_positions
from trimtab.estimators.ranging.range_errors import (
    RangeErrorModel,
    RangeFix,
    count_ranges,
    diagnose_beacons,
    no_range_fix,
)
from trimtab.estimators.ranging.range_model import place_information, unit_geometry, update_with_ranges
from trimtab.estimators.ranging.start import (
    RangingStart,
    add_heading,
    add_unit_position,
    empty_start,
    propagate_start,
    solve_start,
)


@record
class TightNode:
    """Filter state at one instant, with data for a pending start. Source: docs page, Tightly coupled ranging."""

    t: Scalar = quantity("100 ns", "Time of the filter state.", kind="time")
    imu_reading: Any = quantity(
        "1", "IMU sample: yaw rate (rad/s), specific force forward and starboard (m/s^2).", shape=(3,)
    )
    untrusted: Any = quantity("1", "Flags of gyro and accelerometers: 1 if the sensor cannot be trusted.", shape=(2,))
    x: Any = quantity(
        "1", "Filter state (9 + n,): values of Belief.x (pose, velocity, biases), scale error, error of each beacon."
    )
    P: Any = quantity("1", "Covariance of the state's error (9 + n, 9 + n).")
    force: Any = quantity(
        "m/s^2", "Low-pass filtered specific force, corrected for bias, used in the Jacobian.", frame="B", shape=(2,)
    )
    steady: Any = quantity(
        "m/s^2", "Low-pass filtered specific force, corrected for bias, used to detect rest.", frame="B", shape=(2,)
    )
    start: RangingStart = part("Data collected from pings until the filter can start.")
    heading_fix: HeadingFix = part("Statistics of the heading updates.")
    position_fix: RangeFix = part("Statistics of the range updates.")


@record
class TightlyCoupled:
    """Extended Kalman filter that fuses each range separately. It also uses pings with few ranges, and rejects
    outliers.

    State: heading, velocity, position, gyro and accelerometer biases, scale error of all ranges, error of each beacon.
    With two ultrasonic units, or with a lever arm and motion, ranges alone make the heading observable.

    Starts:  in closed form (`RangingStart`) from the first four pings with three or more ranges, without a first guess.
             Only the biases are then taken from `start`. With begins="given", all states are taken from `start`.
    Frames:  beacons in W, ultrasonic units in B; level vehicle on a flat floor.
    Not modelled: survey errors that change with the position; motion of the vehicle while the sound travels.
    Source:  [1] chapter 7 names such a filter as future work; docs page, Tightly coupled ranging.
    """

    intake: Intake = part(
        "Sensors that the filter reads, and checks of the samples. The field `position` names the ranging sensor.",
        default=Intake(heading="", position="ranging", slots=48),
    )
    noise: InertialNoise = part("Noise of the IMU and of the heading sensor.", default=InertialNoise())
    errors: RangeErrorModel = part("Errors of the ultrasonic ranges.", default=RangeErrorModel())
    start: InertialStart = part("Initial estimate and its uncertainty.", default=InertialStart())
    arms: LeverArms = part("Position of the IMU on the vehicle.", default=LeverArms())
    beacons: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=SQUARE, frame="W")
    units: Any = quantity("m", "Positions of the vehicle's ultrasonic units (m, 3).", default=PAIR, frame="B")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's reference point.", default=0.0, frame="W")
    smoothing: Scalar = quantity(
        "s", "Time constant of the low-pass filter of the specific force used in the Jacobian.", default=0.05, low=0
    )
    rest_smoothing: Scalar = quantity(
        "s", "Time constant of the low-pass filter of the specific force used to detect rest.", default=0.5, low=0
    )
    rest_sigmas: Scalar = quantity(
        "1",
        "Number of standard deviations below which the specific force counts as zero. Only used with a "
        "single ultrasonic unit.",
        default=3.0,
        low=0,
    )
    start_sigma: Scalar = quantity(
        "m", "Standard deviation of a range during the start, including its constant errors.", default=0.03, above=0
    )
    start_heading: Scalar = quantity(
        "rad", "Largest standard deviation of the heading at which the filter starts.", default=0.25, above=0
    )
    start_time: Scalar = quantity("s", "Longest time for which pings are collected for a start.", default=3.0, above=0)
    cone: bool = option(
        "True to model the cone error, which makes ranges off a beacon's axis too long.",
        default=True,
        choices=(True, False),
    )
    begins: str = option(
        'Initial state: found from "ranges", or "given" by `start`.', default="ranges", choices=("ranges", "given")
    )

    AIDED_BY: ClassVar[str] = "ranges"
    listens = property(listened_sensors)

    def check(self) -> None:
        """Raise InputError if the settings of sensors, or the positions of beacons or ultrasonic units, are invalid."""
        self.intake.check()
        if not self.intake.position:
            raise InputError(
                "TightlyCoupled.intake.position",
                "the field must name the ranging sensor",
                fix="give the ranging sensor's name",
            )
        check_positions("TightlyCoupled", self)

    def init(self, key: Key) -> InertialState:
        """Return the initial navigation state, before any measurement."""
        return initial_inertial_state(self, key, np.shape(self.beacons)[0] + 1)

    def step(self, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
        """Return the new state and the estimate, a NavigationState with a RangeFix, at integer time t."""
        state, estimate = navigate(self, t, state, frame)
        return state, replace(estimate, valid=estimate.valid & estimate.state.position_fix.tracking)

    def first(self) -> TightNode:
        """Return the filter's initial state, before the first sample."""
        s, n = self.start, np.shape(self.beacons)[0]
        variances = jnp.concatenate([s.variances(), self.errors.variances(n)])
        running = self.begins == "given"
        range_fix = replace(no_range_fix(n), tracking=np.bool_(running), starts=np.int32(running))
        return TightNode(
            **first_of_node(range_fix),
            x=jnp.concatenate([s.pose(), jnp.zeros(4 + n)]),
            P=jnp.diag(variances),
            force=np.zeros(2),
            steady=np.zeros(2),
            start=empty_start(),
        )

    def propagate(self, node: TightNode, dt: Any, imu_reading: Any, untrusted: Any) -> TightNode:
        """Propagate the state by dt (s). imu_reading: IMU sample at the end of the step (3,)."""
        m = propagate_coupled(self, node, dt, imu_reading, untrusted)
        signs = SIGNS[:, None] * SIGNS[None, :]
        F, Q = m.F * signs, m.Q * signs
        own, cross = node.P[:DIMENSION, :DIMENSION], F @ node.P[:DIMENSION, DIMENSION:]
        rest = node.P[DIMENSION:, DIMENSION:]
        wanders = jnp.where(np.arange(rest.shape[0]) == 0, dt * self.errors.scale_walk**2, 0.0)
        rest = rest + jnp.where(np.eye(rest.shape[0], dtype=bool), wanders[:, None], 0.0)
        top = jnp.concatenate([symmetric(F @ own @ F.T + Q), cross], axis=1)
        P = jnp.concatenate([top, jnp.concatenate([cross.T, rest], axis=1)])
        start = propagate_start(node.start, dt, node.imu_reading, imu_reading, node.x[5:8])
        start = tree_where(jnp.max(untrusted) > 0, empty_start(), start)
        return replace(node, imu_reading=imu_reading, x=m.x, P=P, force=m.force, steady=m.steady, start=start)

    def correct_heading(self, node: TightNode, z: Any, variance: Any) -> TightNode:
        """Correct the state with a measured heading z (rad, modulo 2 pi). If `variance` is 0, use noise.heading.

        Before the filter has started, the heading is added to the data for the start instead.
        """
        H = (jnp.arange(node.x.shape[0]) == 0).astype(np.float64)[None]
        R = self.noise.heading_noise(variance)
        y = wrap(z - node.x[0])[None]
        corrected = correction_mask(self, node).at[0].set(1.0).at[5].set(1.0)
        correction, fix = fuse_heading(self, node, node.x, node.P, y, H, R, consider=corrected)
        fused = replace(node, x=correction.x, P=correction.P, heading_fix=fix)
        waiting = replace(
            node,
            start=add_heading(node.start, z, R[0, 0]),
            heading_fix=replace(node.heading_fix, used=increment(node.heading_fix.used, True)),
        )
        return tree_where(node.position_fix.tracking, fused, waiting)

    def correct_ranges(self, node: TightNode, value: Any) -> TightNode:
        """Correct the state with the ranges of a ping, or add them to the data for the start.

        value: ranges (n,) and index of the unit. The value 0 marks a range that did not arrive, and -1 an invalid
        range.
        """
        n = np.shape(self.beacons)[0]
        unit = jnp.clip(value[n], 0, np.shape(self.units)[0] - 1).astype(np.int32)
        unsure = jnp.sqrt(node.P[3, 3] + node.P[4, 4]) > self.errors.wide
        fix = node.position_fix
        invalid = (fix.invalid + jnp.sum(value[:n] < 0)).astype(np.int32)
        node = replace(node, position_fix=replace(fix, unit=unit, invalid=invalid))
        check = unsure | ~fix.tracking
        agree, place, good = lax.cond(
            check,
            lambda: find_agreeing_ranges(self, node, value[:n], unit),
            lambda: (value[:n] > 0, jnp.zeros(2), jnp.asarray(False)),
        )
        return lax.cond(
            fix.tracking,
            lambda: update_running(self, node, value[:n], unit, agree),
            lambda: update_starting(self, node, unit, agree, place, good),
        )

    def belief(self, node: TightNode) -> Belief:
        """Return the estimated motion of the IMU and its covariance, as a Belief."""
        return Belief(node.x[:DIMENSION], node.P[:DIMENSION, :DIMENSION])


def correction_mask(form: TightlyCoupled, node: TightNode) -> Any:
    """Return a mask of the states (9 + n,): 1.0 for states that ranges correct, 0.0 for states that are considered."""
    n = np.shape(form.beacons)[0]
    vehicle = jnp.ones(DIMENSION)
    if np.shape(form.units)[0] == 1:
        moves = is_force_significant(node.steady, node.P, form.noise, form.rest_smoothing, form.rest_sigmas)
        vehicle = jnp.where((np.arange(DIMENSION) % 5 == 0) & ~moves, 0.0, vehicle)
    own = jnp.where(node.position_fix.moved | (form.errors.survey_errors != "estimate"), 0.0, jnp.ones(n))
    return jnp.concatenate([vehicle, jnp.ones(1), own])


def find_agreeing_ranges(form: TightlyCoupled, node: TightNode, ranges: Any, unit: Any) -> tuple[Any, Any, Any]:
    """Return flags of the ranges that agree with each other (n,), the ultrasonic unit's position (2,), and True if at
    least three ranges agree."""
    finder = RangingPosition(
        beacons=form.beacons,
        units=form.units,
        down=form.down,
        residual_limit=form.errors.residual,
        cone=form.cone,
    )
    fix, own = node.position_fix, node.x[DIMENSION + 1 :]
    usable = (ranges > 0) & ~(fix.moved & (fix.sigma_error > form.errors.residual))
    near = node.x[3:5] + planar(node.x[0]) @ unit_geometry(form, unit).lever
    r = finder.locate((ranges - own) / (1 + node.x[DIMENSION]), usable, unit, near, fix.tracking)
    good = ((r.mode == ALL) | (r.mode == ONE_REJECTED)) & jnp.all(jnp.isfinite(r.place))
    few = jnp.sum(usable) <= 2
    agree = usable & (jnp.arange(ranges.shape[0]) != r.rejected) & (good | few)
    return agree, jnp.where(good, r.place, near), good


def update_running(form: TightlyCoupled, node: TightNode, ranges: Any, unit: Any, agree: Any) -> TightNode:
    """Return the filter state after the ranges of a ping, for a filter that has started."""
    replies = ranges > 0
    correction = update_with_ranges(
        node.x, node.P, ranges, replies & agree, unit_geometry(form, unit), form.errors, correction_mask(form, node)
    )
    fix = count_ranges(node.position_fix, replies, correction, form.errors)
    moved, forgiven, lost = diagnose_beacons(fix, form.errors)
    P = _inflate_beacon_errors(correction.P, moved, forgiven, form.errors)
    fix = replace(
        fix,
        moved=(fix.moved | moved) & ~forgiven,
        agreed_in_a_row=jnp.where(moved | forgiven, 0, fix.agreed_in_a_row).astype(np.int32),
        beacon_rejected_in_a_row=jnp.where(moved | lost, 0, fix.beacon_rejected_in_a_row).astype(np.int32),
        rejected_pings_in_a_row=jnp.where(lost, 0, fix.rejected_pings_in_a_row).astype(np.int32),
        tracking=~lost,
    )
    P = jnp.where(lost, _replace_pose_covariance(jnp.diag(form.start.variances()[:5]), P), P)
    start = tree_where(lost, empty_start(), node.start)
    return _record_range_errors(replace(node, x=correction.x, P=P, start=start, position_fix=fix))


def update_starting(form: TightlyCoupled, node: TightNode, unit: Any, agree: Any, place: Any, good: Any) -> TightNode:
    """Return the filter state after the ranges of a ping, for a filter that has not started."""
    g = unit_geometry(form, unit)
    with_it = add_unit_position(node.start, place, g.lever, place_information(place, agree, g, form.start_sigma))
    start = tree_where(good, with_it, node.start)
    biases = jnp.sqrt(jnp.stack([node.P[5, 5], jnp.maximum(node.P[6, 6], node.P[7, 7])]))
    new = solve_start(start, biases, enough=4, longest=form.start_time, heading_limit=form.start_heading)
    heading = node.x[0] + wrap(new.x[0] - node.x[0])
    x = jnp.concatenate([heading[None], new.x[1:], node.x[5:]])
    fix = node.position_fix
    used = (fix.used + jnp.sum(agree & good)).astype(np.int32)
    fix = replace(fix, used=used, tracking=new.usable, starts=increment(fix.starts, new.usable))
    return _record_range_errors(
        replace(
            node,
            x=jnp.where(new.usable, x, node.x),
            P=jnp.where(new.usable, _replace_pose_covariance(new.P, node.P), node.P),
            start=tree_where(new.usable | new.inconsistent, empty_start(), start),
            position_fix=fix,
        )
    )


def _inflate_beacon_errors(P: Any, moved: Any, forgiven: Any, errors: Any) -> Any:
    """Return the covariance P with increased variances for beacons that have moved (n,), and with initial variances for
    beacons that are trusted again (n,)."""
    none = jnp.zeros(DIMENSION + 1)
    wider = jnp.concatenate([none, jnp.where(moved, errors.moved**2, 0.0)])
    cut = jnp.concatenate([none, jnp.where(forgiven, 1.0, 0.0)]) > 0
    own = jnp.where(cut, errors.variances(moved.shape[0])[-1], wider)
    P = jnp.where(cut[:, None] | cut[None, :], 0.0, P)
    return P + jnp.where(np.eye(P.shape[0], dtype=bool), own[:, None], 0.0)


def _replace_pose_covariance(own: Any, P: Any) -> Any:
    """Return the covariance P with a new, uncorrelated block (5, 5) for heading, velocity and position."""
    across = jnp.zeros((5, P.shape[0] - 5))
    return jnp.concatenate([jnp.concatenate([own, across], axis=1), jnp.concatenate([across.T, P[5:, 5:]], axis=1)])


def _record_range_errors(node: TightNode) -> TightNode:
    """Return the filter state with the estimated scale and beacon errors copied into its statistics."""
    n = node.x.shape[0] - DIMENSION
    sigma = jnp.sqrt(jnp.maximum(jnp.stack([node.P[DIMENSION + i, DIMENSION + i] for i in range(n)]), 0.0))
    x = node.x[DIMENSION:]
    fix = replace(node.position_fix, scale=x[0], error=x[1:], sigma_scale=sigma[0], sigma_error=sigma[1:])
    return replace(node, position_fix=fix)
