"""Extended Kalman filter of raw ranges and odometry, for a wheeled vehicle among beacons at known positions.

Source: [4] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001, section
10.3 (extended filter); docs page, Odometry and ranges.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.linalg import symmetric
from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.sensor_watch import NEVER, increment
from trimtab.estimators.kalman import update
from trimtab.estimators.ranging.pose_search import (
    FEWEST,
    KEPT,
    RecentRanges,
    fit_pose,
    move_ranges,
    no_recent_ranges,
    remember_range,
)
from trimtab.estimators.ranging.position import SQUARE

HEADING, NORTH, EAST, TURN_BIAS, COURSE, SCALE, ERRORS = range(7)
"""Indices of the states of the odometry filter. From ERRORS on, there is one range error for each beacon."""
DOUBTED_MIN = 3
"""Smallest number of beacons with a rejected newest range for a restart. Ranges to two beacons fit two positions."""
OTHERS_MIN = 3
"""Smallest number of ranges for a restart, without the ranges to the two beacons that have the most ranges."""
AGREEMENT = 2.0
"""Largest chi-square per degree of freedom at which ranges count as agreeing with each other."""
RESTART_VARIANCE = 4.0
"""Factor on the variances after a restart. It allows for the error that all ranges of a beacon have in common."""
NEAREST = 0.01
"""Lower limit of the distance to a beacon (m) in computations. At the beacon, a range has no direction."""


@record
class OdometryNoise:
    """Noise of the odometry, whose errors grow with the distance driven, or with time.

    Source: docs page, Odometry and ranges; values reconstructed for an indoor robot.
    """

    slip: Scalar = quantity(
        "m/sqrt(m)", "Random walk of the position with distance, along and across the path.", default=0.03, above=0
    )
    turn: Scalar = quantity("rad/sqrt(s)", "Random walk of the heading over time.", default=2e-3, above=0)
    bias_walk: Scalar = quantity("rad/s/sqrt(s)", "Random walk of the yaw rate's bias.", default=1e-5, low=0)
    grip: Scalar = quantity(
        "m/s^2",
        "Maximum acceleration of wheels that do not slip. A distance that requires more acceleration is not trusted.",
        default=9.81,
        above=0,
    )


@record
class RadioErrors:
    """Errors of radio ranges: measured = (1 + scale) distance + error of the beacon + noise.

    Source: docs page, Odometry and ranges. The default values are our own estimates for ultra-wideband radios.
    """

    noise: Scalar = quantity("m", "Standard deviation of a range's white noise.", default=0.15, above=0)
    scale: Scalar = quantity(
        "1", "Expected scale error of all ranges, positive if they are too long.", default=0.0, above=-0.5
    )
    sigma_scale: Scalar = quantity("1", "Standard deviation of the ranges' scale error.", default=0.01, low=0)
    sigma_error: Scalar = quantity("m", "Standard deviation of each beacon's constant range error.", default=0.1, low=0)
    gate: Scalar = quantity("1", "NIS gate for single ranges.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1",
        "Number of newest ranges, 6 to 16, that must agree with each other to restart the filter; 0 for no restarts.",
        default=12,
        kind="count",
    )


@record
class PlanarStart:
    """Initial pose of the vehicle and its uncertainty. Source: docs page, Odometry and ranges."""

    heading: Scalar = quantity("rad", "Initial heading, from north to the body's x axis.", kind="angle", default=0.0)
    north: Scalar = quantity("m", "Initial north position.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Initial east position.", frame="W", default=0.0)
    sigma_heading: Scalar = quantity("rad", "Standard deviation of the initial heading.", default=0.05, above=0)
    sigma_position: Scalar = quantity(
        "m", "Standard deviation of each initial position coordinate.", default=0.3, above=0
    )
    sigma_turn_bias: Scalar = quantity(
        "rad/s", "Standard deviation of the yaw rate's initial bias.", default=5e-3, low=0
    )
    sigma_course: Scalar = quantity(
        "rad", "Initial standard deviation of the angle from the x axis to the velocity.", default=0.03, low=0
    )


@record
class RadioFix:
    """Statistics of the newest range updates, one entry per beacon. Source: docs page, Odometry and ranges."""

    innovation: Any = quantity("m", "Innovation of each range, measured minus predicted; 0 if no range arrived.")
    normalised: Any = quantity("1", "Range innovations divided by their standard deviations.")
    nis: Any = quantity("1", "NIS of each beacon's range.")
    accepted: Any = quantity("1", "True for each beacon whose range was used.", kind="flag")
    beacon_rejected_in_a_row: Any = quantity(
        "1", "Number of ranges of each beacon rejected since its last accepted range.", kind="count"
    )
    used: Scalar = quantity("1", "Number of ranges used so far.", kind="count")
    rejected: Scalar = quantity("1", "Number of ranges rejected so far.", kind="count")
    rejected_in_a_row: Scalar = quantity("1", "Number of ranges rejected since the last accepted range.", kind="count")
    restarts: Scalar = quantity(
        "1", "Number of restarts of the pose from ranges that agree with each other.", kind="count"
    )
    late: Scalar = quantity("1", "Number of unused messages: no odometry sample was near in time.", kind="count")


@record
class RobotNavigation:
    """Position and heading with their uncertainty, at the newest odometry. Source: docs page, Odometry and ranges."""

    heading: Scalar = quantity("rad", "Heading, clockwise from north, not wrapped to one turn.", kind="angle")
    north: Scalar = quantity("m", "Estimated north position.", frame="W")
    east: Scalar = quantity("m", "Estimated east position.", frame="W")
    speed: Scalar = quantity("m/s", "Speed at the newest odometry sample.")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate at the newest odometry sample, corrected for its bias.")
    turn_bias: Scalar = quantity("rad/s", "Bias of the odometry's yaw rate, positive if the rate is too large.")
    course: Scalar = quantity("rad", "Estimated angle from the body's x axis to the direction of motion.", kind="angle")
    range_scale: Scalar = quantity("1", "Scale error common to all ranges, positive if they are too long.")
    range_error: Any = quantity("m", "Estimated constant error of each beacon's ranges (n,).")
    sigma_heading: Scalar = quantity("rad", "Standard deviation of the heading.")
    sigma_north: Scalar = quantity("m", "Standard deviation of the north position.")
    sigma_east: Scalar = quantity("m", "Standard deviation of the east position.")
    covariance_north_east: Scalar = quantity("m^2", "Covariance of north and east position.", frame="W")
    position_fix: RadioFix = part("Statistics of the range updates.")


@record
class OdometryState:
    """State of the filter of odometry and ranges. Source: docs page, Odometry and ranges."""

    t: Scalar = quantity("100 ns", "Time of the newest odometry sample.", kind="time")
    distance: Scalar = quantity("m", "Total distance driven, as reported by the newest odometry sample.")
    turn: Scalar = quantity("rad", "Total angle turned, as reported by the newest odometry sample.", kind="angle")
    speed: Scalar = quantity("m/s", "Speed at the newest odometry sample.")
    rate: Scalar = quantity("rad/s", "Yaw rate at the newest odometry sample.")
    moved: Scalar = quantity("1", "True once two odometry samples have determined speed and yaw rate.", kind="flag")
    x: Any = quantity("1", "Heading, north, east, yaw rate bias, drift angle, scale error, beacon errors (6 + n,).")
    P: Any = quantity("1", "Covariance of the state's error (6 + n, 6 + n).")
    fix: RadioFix = part("Statistics of the range updates.")
    recent: RecentRanges = part("Newest ranges, stored for a restart.")


class PredictedRange(NamedTuple):
    """Predicted range (m), its derivative by the states (6 + n,), and the motion since the odometry sample (2,) (m)."""

    range: Any
    H: Any
    along: Any


@record
class OdometryRanging:
    """Extended Kalman filter driven by odometry, from a known initial pose. It fuses each range when it arrives.

    Odometry samples are totals of distance and angle since power-on, so that a lost message loses no motion. For a
    range measured between two samples, the position is extrapolated with the last speed and yaw rate.

    Frames:  beacons in W; level vehicle on a flat floor.
    Valid:   from the first odometry sample on, unless the newest `patience` ranges (16 if it is 0) were all rejected.
    Not modelled: antennas away from the vehicle's reference point; a range's curvature, small at metres.
    Source:  docs page, Odometry and ranges.
    """

    noise: OdometryNoise = part("Noise of the odometry.", default=OdometryNoise())
    errors: RadioErrors = part("Errors of the radio ranges.", default=RadioErrors())
    start: PlanarStart = part("Initial pose and its uncertainty.", default=PlanarStart())
    beacons: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=SQUARE, frame="W")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's antenna.", default=0.0, frame="W")
    longest: Scalar = quantity("s", "Maximum time between a range and the last odometry sample.", default=1.0, above=0)
    odometry: str = option("Name of the odometry sensor; its samples have `distance` and `turn`.", default="odometry")
    ranging: str = option("Name of the ranging sensor; its samples have `range` and `arrived`.", default="ranging")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the odometry sensor and the ranging sensor."""
        return (self.odometry, self.ranging)

    def check(self) -> None:
        """Raise InputError if the beacons are not a list of positions, or the patience is out of range."""
        patience, shape = int(self.errors.patience), np.shape(self.beacons)
        if patience and not FEWEST <= patience <= KEPT:
            problem = f"the patience must be 0, or {FEWEST} to {KEPT}, got {patience}"
            raise InputError("OdometryRanging.errors.patience", problem, fix="set 0 for no restarts; the default is 12")
        if len(shape) != 2 or shape[1] != 3 or not shape[0]:
            fix = "give north, east and down of each beacon"
            raise InputError("OdometryRanging.beacons", f"the shape must be (n, 3), got {shape}", fix=fix)

    def init(self, key: Key) -> OdometryState:
        """Return the filter's initial state, before any measurement."""
        return first_state(self, initial_belief(self.start, self.errors, np.shape(self.beacons)[0]))

    def step(self, t: Any, state: OdometryState, frame: Frame) -> tuple[OdometryState, Estimate]:
        """Return the new state and the estimate, a RobotNavigation, at integer time t."""
        s, came = drive_on(self, state, t, frame)
        s, ranged = fuse_ranges(self, s, t, frame)
        most = jnp.where(self.errors.patience > 0, self.errors.patience, KEPT)
        valid = (s.t > NEVER) & (s.fix.rejected_in_a_row < most)
        return s, planar_estimate(t, s, s.x, s.P, came | ranged, valid)


def drive_on(form: OdometryRanging, state: OdometryState, t: Any, frame: Frame) -> tuple[OdometryState, Any]:
    """Return the state at the time of the newest odometry sample, and True if the frame has added a motion."""
    s, came, motion = read_odometry(state, frame.samples[form.odometry], t, form.noise.grip)
    x, P = predict_odometry(state.x, state.P, motion, form.noise)
    recent = move_ranges(s.recent, jnp.where(came, (x - s.x)[NORTH : EAST + 1], 0.0))
    return replace(s, x=jnp.where(came, x, s.x), P=jnp.where(came, P, s.P), recent=recent), came


def fuse_ranges(form: OdometryRanging, s: OdometryState, t: Any, frame: Frame) -> tuple[OdometryState, Any]:
    """Return the state after the ranges of a frame, fused one after another, and True if the frame has any range."""
    ranges, ahead, fix = read_ranges(s, frame.samples[form.ranging], t, form.longest)

    def each(carry: Any, row: Any) -> tuple[Any, Any]:
        i, z = row
        return lax.cond(z > 0, lambda: fuse_range(form, carry, i, z, ahead), lambda: carry), ()

    s, _ = lax.scan(each, replace(s, fix=fix), (jnp.arange(ranges.shape[0]), ranges))
    return s, jnp.any(ranges > 0)


def initial_belief(start: PlanarStart, errors: RadioErrors, n: int) -> tuple[Any, Any]:
    """Return the initial state x (6 + n,) and its covariance."""
    o, one = jnp.zeros(()), jnp.ones(n)
    x = jnp.stack([start.heading + o, start.north + o, start.east + o, o, o, errors.scale + o])
    sigmas = (start.sigma_heading, start.sigma_position, start.sigma_position, start.sigma_turn_bias)
    sigmas = (*sigmas, start.sigma_course, errors.sigma_scale)
    sigma = jnp.concatenate([jnp.stack([s + o for s in sigmas]), errors.sigma_error * one])
    return jnp.concatenate([x, 0 * one]), jnp.diag(sigma**2)


def first_state(form: Any, belief: tuple[Any, Any]) -> OdometryState:
    """Return the initial state of a filter of odometry and ranges. belief: x (6 + n,) and its covariance."""
    n, o = np.shape(form.beacons)[0], np.float64(0)
    zero, none, count = np.zeros(n), np.zeros(n, np.int32), np.int32(0)
    fix = RadioFix(zero, zero, zero, np.zeros(n, bool), none, count, count, count, count, count)
    return OdometryState(np.int64(NEVER), o, o, o, o, np.bool_(False), *belief, fix, no_recent_ranges())


class OdometryMotion(NamedTuple):
    """Motion between two odometry samples: distance (m), angle (rad), time (s), untrusted part of the distance (m)."""

    distance: Any
    turn: Any
    dt: Any
    doubt: Any


def read_odometry(s: Any, sample: Any, t: Any, grip: Any) -> tuple[Any, Any, OdometryMotion]:
    """Return the state with a new odometry sample, True if there is a motion since the last sample, and the motion."""
    distance, turn = jnp.asarray(sample.value.distance, float), jnp.asarray(sample.value.turn, float)
    usable = sample.fresh & sample.valid & (sample.t > s.t) & (sample.t <= t)
    usable = usable & jnp.isfinite(distance) & jnp.isfinite(turn)
    came = usable & (s.t > NEVER)
    dt = jnp.where(came, to_seconds(sample.t - s.t), 1.0)
    way, angle = jnp.where(came, distance - s.distance, 0.0), jnp.where(came, turn - s.turn, 0.0)
    slips = came & s.moved & (jnp.abs(way / dt - s.speed) > grip * dt)
    new = replace(s, t=sample.t, distance=distance, turn=turn, speed=way / dt, rate=angle / dt, moved=came)
    return tree_where(usable, new, s), came, OdometryMotion(way, angle, dt, jnp.where(slips, jnp.abs(way), 0.0))


def predict_odometry(x: Any, P: Any, m: OdometryMotion, noise: OdometryNoise) -> tuple[Any, Any]:
    """Return state x (6 + n,) and covariance after half of the turn, the distance, and the other half of the turn."""
    angle = m.turn - x[TURN_BIAS] * m.dt
    c = x[HEADING] + x[COURSE] + angle / 2
    along = m.distance * jnp.stack([jnp.cos(c), jnp.sin(c)])
    across = jnp.stack([-along[1], along[0]])
    F = jnp.eye(x.shape[0]).at[HEADING, TURN_BIAS].set(-m.dt)
    F = F.at[NORTH : EAST + 1, HEADING].set(across).at[NORTH : EAST + 1, COURSE].set(across)
    F = F.at[NORTH : EAST + 1, TURN_BIAS].set(-across * m.dt / 2)
    place = noise.slip**2 * jnp.abs(m.distance) + m.doubt**2
    grows = jnp.stack([noise.turn**2 * m.dt, place, place, noise.bias_walk**2 * m.dt])
    q = jnp.concatenate([grows, jnp.zeros(x.shape[0] - 4)])
    new = jnp.concatenate([(x[HEADING] + angle)[None], x[NORTH : EAST + 1] + along, x[TURN_BIAS:]])
    return new, symmetric(F @ P @ F.T + jnp.diag(q))


def read_ranges(s: OdometryState, sample: Any, t: Any, longest: Any) -> tuple[Any, Any, RadioFix]:
    """Return the ranges (n,), 0 where unusable, their time after the odometry sample (s), and the reset statistics."""
    value, n = sample.value, s.fix.nis.shape[0]
    z = jnp.where(jnp.asarray(value.arrived, bool), jnp.asarray(value.range, float), 0.0)
    z = jnp.where(jnp.isfinite(z) & (z > 0) & sample.fresh & sample.valid & (s.t > NEVER), z, 0.0)
    ahead = to_seconds(sample.t - s.t)
    in_time = (jnp.abs(ahead) <= longest) & (sample.t <= t)
    late = jnp.any(z > 0) & ~in_time
    zero = jnp.zeros(n)
    fix = replace(s.fix, innovation=zero, normalised=zero, nis=zero, accepted=jnp.zeros(n, bool))
    return jnp.where(in_time, z, 0.0), jnp.where(in_time, ahead, 0.0), replace(fix, late=increment(fix.late, late))


def predict_range(x: Any, i: Any, beacons: Any, down: Any, s: OdometryState, ahead: Any) -> PredictedRange:
    """Return the predicted range to beacon i, `ahead` seconds after the odometry sample, at constant speed and rate."""
    c = x[HEADING] + x[COURSE] + (s.rate - x[TURN_BIAS]) * ahead / 2
    along = s.speed * ahead * jnp.stack([jnp.cos(c), jnp.sin(c)])
    beacon = jnp.asarray(beacons)[i]
    away, height = x[NORTH : EAST + 1] + along - beacon[:2], down - beacon[2]
    distance = jnp.maximum(jnp.sqrt(jnp.sum(away * away) + height * height), NEAREST)
    u, long = away / distance, 1 + x[SCALE]
    swing = long * (u[1] * along[0] - u[0] * along[1])
    pose = jnp.stack([swing, long * u[0], long * u[1], -swing * ahead / 2, swing, distance])
    errors = (jnp.arange(x.shape[0] - ERRORS) == i).astype(np.float64)
    return PredictedRange(long * distance + x[ERRORS:] @ errors, jnp.concatenate([pose, errors]), along)


def fuse_range(form: Any, s: OdometryState, i: Any, z: Any, ahead: Any) -> OdometryState:
    """Return the state after an update with a measured range z (m) to beacon i."""
    e, fix = form.errors, s.fix
    at = predict_range(s.x, i, form.beacons, form.down, s, ahead)
    y, H, R = (z - at.range)[None], at.H[None], jnp.reshape(e.noise**2, (1, 1))
    new = update(s.x, s.P, y, H, R, gate=e.gate)
    used, me = new.accepted, jnp.arange(fix.nis.shape[0]) == i
    refused = jnp.where(used, 0, fix.beacon_rejected_in_a_row + 1)
    fix = replace(
        fix,
        innovation=jnp.where(me, new.innovation[0], fix.innovation),
        normalised=jnp.where(me, new.innovation[0] / jnp.sqrt(new.S[0, 0]), fix.normalised),
        nis=jnp.where(me, new.nis, fix.nis),
        accepted=jnp.where(me, used, fix.accepted),
        beacon_rejected_in_a_row=jnp.where(me, refused, fix.beacon_rejected_in_a_row).astype(np.int32),
        used=increment(fix.used, used),
        rejected=increment(fix.rejected, ~used),
        rejected_in_a_row=jnp.where(used, 0, fix.rejected_in_a_row + 1).astype(np.int32),
    )
    s = replace(s, x=new.x, P=new.P, fix=fix, recent=remember_range(s.recent, i, z, -at.along, ~used))
    number = jnp.clip(e.patience, FEWEST, KEPT)
    newest = (jnp.arange(KEPT) < number) & (s.recent.range > 0)
    counts = jnp.sum((s.recent.beacon == jnp.arange(me.shape[0])[:, None]) & newest, axis=1)
    first = jnp.argmax(counts)
    second = jnp.max(jnp.where(jnp.arange(me.shape[0]) == first, 0, counts))
    others = jnp.sum(counts) - counts[first] - second
    doubted = jnp.sum((counts > 0) & (fix.beacon_rejected_in_a_row > 0)) >= DOUBTED_MIN
    doubted = doubted & (e.patience > 0) & (2 * jnp.sum(s.recent.rejected & newest) > number)
    return lax.cond(doubted & (others >= OTHERS_MIN), lambda: restart_pose(form, s, number), lambda: s)


def restart_pose(form: Any, s: OdometryState, number: Any) -> OdometryState:
    """Return the state, with the pose restarted from the newest ranges if these agree with each other."""
    e, n, fix = form.errors, s.fix.nis.shape[0], s.fix
    sigma = jnp.sqrt(e.noise**2 + e.sigma_error**2)
    fit = fit_pose(s.recent, number, form.beacons, form.down, (e.scale, e.sigma_scale), sigma)
    x0, P0 = initial_belief(form.start, e, n)
    pose = np.array([HEADING, NORTH, EAST, SCALE])
    x0 = x0.at[pose].set(fit.q).at[HEADING].set(s.x[HEADING] + s.x[COURSE] + fit.q[0])
    P0 = P0.at[pose[:, None], pose[None, :]].set(RESTART_VARIANCE * fit.P)
    own = slice(ERRORS + n)
    P0 = s.P.at[own, :].set(0.0).at[:, own].set(0.0).at[own, own].set(P0)
    again = replace(
        s,
        x=s.x.at[own].set(x0),
        P=P0,
        fix=replace(
            fix,
            restarts=increment(fix.restarts, True),
            beacon_rejected_in_a_row=jnp.zeros_like(fix.beacon_rejected_in_a_row),
            rejected_in_a_row=jnp.zeros_like(fix.rejected_in_a_row),
        ),
        recent=replace(s.recent, range=jnp.zeros(KEPT), rejected=jnp.zeros(KEPT, bool)),
    )
    return tree_where(fit.chi_square <= AGREEMENT * fit.freedom, again, s)


def planar_estimate(t: Any, s: Any, x: Any, P: Any, fresh: Any, valid: Any) -> Estimate:
    """Return the estimate of an odometry filter from its state x (6 + n,) and covariance P at the newest odometry."""
    sigma = jnp.sqrt(jnp.maximum(jnp.stack([P[k, k] for k in (HEADING, NORTH, EAST)]), 0.0))
    state = RobotNavigation(
        heading=x[HEADING],
        north=x[NORTH],
        east=x[EAST],
        speed=s.speed,
        yaw_rate=s.rate - x[TURN_BIAS],
        turn_bias=x[TURN_BIAS],
        course=x[COURSE],
        range_scale=x[SCALE],
        range_error=x[ERRORS:],
        sigma_heading=sigma[0],
        sigma_north=sigma[1],
        sigma_east=sigma[2],
        covariance_north_east=P[NORTH, EAST],
        position_fix=s.fix,
    )
    return Estimate(t=t, age=jnp.where(s.t > NEVER, to_seconds(t - s.t), 0.0), fresh=fresh, valid=valid, state=state)
