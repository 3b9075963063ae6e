"""Extended filter of raw ranges and odometry, for a wheeled vehicle among beacons at known places.

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
from trimtab.estimators.ranging.position import SQUARE

HEADING, NORTH, EAST, TURN_BIAS, COURSE, SCALE, ERRORS = range(7)
"""Indices of the states; from ERRORS on, one error of each beacon."""
NEAREST = 0.01
"""Smallest distance of a beacon (m); at the beacon itself a range has no direction."""


@record
class OdometryNoise:
    """Noise of the odometry; its errors grow with the distance driven, or with time.

    Source: docs page; figures as of an indoor robot: reconstructed.
    """

    slip: Scalar = quantity(
        "m/sqrt(m)", "Random walk of the position, along and across the path, over the distance.", default=0.03, above=0
    )
    turn: Scalar = quantity("rad/sqrt(s)", "Random walk of the heading.", default=2e-3, above=0)
    bias_walk: Scalar = quantity("rad/s/sqrt(s)", "Random walk of the bias of the rate of turn.", default=1e-5, low=0)
    grip: Scalar = quantity(
        "m/s^2",
        "Maximum acceleration of wheels with grip; a distance that needs more is fully distrusted.",
        default=9.81,
        above=0,
    )


@record
class RadioErrors:
    """Errors of the ranges: measured = (1 + scale) distance + error of the beacon + noise.

    Source: docs page; figures as of ultra-wideband radios: reconstructed.
    """

    noise: Scalar = quantity("m", "White noise of a range.", default=0.15, above=0)
    scale: Scalar = quantity(
        "1", "Scale error of all ranges; positive when they are too long.", default=0.0, above=-0.5
    )
    sigma_scale: Scalar = quantity("1", "Standard deviation of the scale error.", default=0.01, low=0)
    sigma_error: Scalar = quantity("m", "Standard deviation of a beacon's error.", default=0.1, low=0)
    gate: Scalar = quantity("1", "NIS gate for ranges.", default=15.137, above=0)
    patience: Scalar = quantity(
        "1", "Consecutive rejections after which the next range is accepted anyway; 0: never.", default=8, kind="count"
    )


@record
class PlanarStart:
    """Initial pose of the vehicle and its uncertainty. Source: docs page."""

    heading: Scalar = quantity("rad", "Angle from north to the body's x axis.", kind="angle", default=0.0)
    north: Scalar = quantity("m", "Position, north.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Position, east.", frame="W", default=0.0)
    sigma_heading: Scalar = quantity("rad", "Standard deviation of the initial heading.", default=0.05, above=0)
    sigma_position: Scalar = quantity(
        "m", "Standard deviation of each initial position coordinate.", default=0.3, above=0
    )
    sigma_turn_bias: Scalar = quantity(
        "rad/s", "Standard deviation of the bias of the rate of turn.", default=5e-3, low=0
    )
    sigma_course: Scalar = quantity(
        "rad", "Standard deviation of the angle from the body's x axis to its course.", default=0.03, low=0
    )


@record
class RadioFix:
    """Statistics of the newest range updates; arrays have one entry for each beacon. Source: docs page."""

    innovation: Any = quantity("m", "Innovations: measured minus predicted; 0 where no range arrived.")
    normalised: Any = quantity("1", "Innovations divided by their standard deviations.")
    nis: Any = quantity("1", "NIS of each range.")
    accepted: Any = quantity("1", "True for each range that was used.", kind="flag")
    refused_in_a_row: Any = quantity("1", "Ranges of each beacon rejected since one was used.", kind="count")
    used: Scalar = quantity("1", "Ranges used so far.", kind="count")
    rejected: Scalar = quantity("1", "Ranges rejected so far.", kind="count")
    rejected_in_a_row: Scalar = quantity("1", "Ranges rejected since any was used.", kind="count")
    given_in: Scalar = quantity(
        "1",
        "Number of times the filter accepted a measurement outside the gate after too many rejections in a row.",
        kind="count",
    )
    late: Scalar = quantity("1", "Number of ranges too far in time from the newest odometry: not used.", kind="count")


@record
class RobotNavigation:
    """Position and heading with their uncertainty, at the newest odometry. Source: docs page."""

    heading: Scalar = quantity("rad", "Angle from north to the body's x axis; unwrapped.", kind="angle")
    north: Scalar = quantity("m", "Position, north.", frame="W")
    east: Scalar = quantity("m", "Position, east.", frame="W")
    speed: Scalar = quantity("m/s", "Speed at the newest odometry.")
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn at the newest odometry, without its bias.")
    turn_bias: Scalar = quantity("rad/s", "Bias of the odometry's rate of turn; positive when it turns too fast.")
    course: Scalar = quantity("rad", "Angle from the body's x axis to its course.", kind="angle")
    range_scale: Scalar = quantity("1", "Scale error common to all ranges; positive when they are too long.")
    range_error: Any = quantity("m", "Error of each beacon's ranges (n,).")
    sigma_heading: Scalar = quantity("rad", "Standard deviation of the heading.")
    sigma_north: Scalar = quantity("m", "Standard deviation of the north position.")
    sigma_east: Scalar = quantity("m", "Standard deviation of the east position.")
    covariance_north_east: Scalar = quantity("m^2", "Covariance of north and east.", frame="W")
    position_fix: RadioFix = part("Statistics of the range updates.")


@record
class OdometryState:
    """State of the filter. Source: docs page."""

    t: Scalar = quantity("100 ns", "Time of the newest odometry.", kind="time")
    distance: Scalar = quantity("m", "Distance driven until the newest odometry.")
    turn: Scalar = quantity("rad", "Angle turned until the newest odometry.", kind="angle")
    speed: Scalar = quantity("m/s", "Speed at the newest odometry.")
    rate: Scalar = quantity("rad/s", "Rate of turn at the newest odometry.")
    moved: Scalar = quantity("1", "True once there has been a motion, so that speed and rate are known.", kind="flag")
    x: Any = quantity("1", "Heading, north, east, turn bias, course, scale, beacons' errors (6 + n,).")
    P: Any = quantity("1", "Covariance of estimate minus truth (6 + n, 6 + n).")
    fix: RadioFix = part("Statistics of the range updates.")


class PredictedRange(NamedTuple):
    """Return a predicted range (m), and its derivative by the states (6 + n,)."""

    range: Any
    H: Any


@record
class OdometryRanging:
    """Extended Kalman filter driven by odometry. It fuses each range when it arrives.

    Odometry gives the total distance and angle since it was switched on, so a lost message loses nothing. A range
    measured between two readings is compared with the position extrapolated with the last speed and rate.

    Frames:  beacons in W; level vehicle on a flat floor.
    Valid:   from the first odometry on; the initial pose is given (`OdometryParticle` finds it by itself).
    Not modelled: antennas away from the vehicle's reference point; a range's curvature (beacons are metres away).
    Source:  docs page.
    """

    noise: OdometryNoise = part("Noise of the odometry.", default=OdometryNoise())
    errors: RadioErrors = part("Errors of the ranges.", default=RadioErrors())
    start: PlanarStart = part("Initial estimate and its uncertainty.", default=PlanarStart())
    beacons: Any = quantity("m", "Surveyed positions (n, 3).", default=SQUARE, frame="W")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's antenna.", default=0.0, frame="W")
    longest: Scalar = quantity("s", "Maximum time between a range and the newest odometry.", default=1.0, above=0)
    odometry: str = option("Name of the odometry sensor; its samples have `distance` and `turn`.", default="odometry")
    ranging: str = option("Name of the ranging sensor; its samples have `range` and `arrived`.", default="ranging")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the odometry and the ranging sensor."""
        return (self.odometry, self.ranging)

    def check(self) -> None:
        """Raise InputError if the beacons are not a list of positions."""
        shape = np.shape(self.beacons)
        if len(shape) != 2 or shape[1] != 3 or not shape[0]:
            fix = "give north, east and down of each beacon"
            raise InputError("OdometryRanging.beacons", f"the shape must be (n, 3), got {shape}", fix=fix)

    def init(self, key: Key) -> OdometryState:
        """Return the initial state, before any measurement."""
        return first_state(self, initial_belief(self.start, self.errors, np.shape(self.beacons)[0]))

    def step(self, t: Any, state: OdometryState, frame: Frame) -> tuple[OdometryState, Estimate]:
        """Return the estimate at integer time t; its state is a RobotNavigation."""
        s, came = drive_on(self, state, t, frame)
        s, ranged = fuse_ranges(self, s, t, frame)
        return s, planar_estimate(t, s, s.x, s.P, came | ranged, s.t > NEVER)


def drive_on(form: OdometryRanging, state: OdometryState, t: Any, frame: Frame) -> tuple[OdometryState, Any]:
    """Return the state at the newest odometry, and whether it moved there now; later entries of x and P are kept."""
    s, came, motion = read_odometry(state, frame.samples[form.odometry], t, form.noise.grip)
    x, P = predict_odometry(state.x, state.P, motion, form.noise)
    return replace(s, x=jnp.where(came, x, s.x), P=jnp.where(came, P, s.P)), came


def fuse_ranges(form: OdometryRanging, s: OdometryState, t: Any, frame: Frame) -> tuple[OdometryState, Any]:
    """Return the state after the ranges of a frame, one after the other, and whether there were any."""
    ranges, ahead, fix = read_ranges(s, frame.samples[form.ranging], t, form.longest)

    def each(carry: Any, row: Any) -> tuple[Any, Any]:
        i, z = row
        x, P, fix = carry
        new = fuse_range(form, s, x, P, fix, i, z, ahead)
        return tree_where(z > 0, new, carry), ()

    (x, P, fix), _ = lax.scan(each, (s.x, s.P, fix), (jnp.arange(ranges.shape[0]), ranges))
    return replace(s, x=x, P=P, fix=fix), jnp.any(ranges > 0)


def initial_belief(start: PlanarStart, errors: RadioErrors, n: int) -> tuple[Any, Any]:
    """Return state (6 + n,) and covariance before the first range."""
    o, one = jnp.zeros(()), jnp.ones(n)
    x = jnp.stack([start.heading + o, start.north + o, start.east + o, o, o, errors.scale + o])
    sigmas = (start.sigma_heading, start.sigma_position, start.sigma_position, start.sigma_turn_bias)
    sigmas = (*sigmas, start.sigma_course, errors.sigma_scale)
    sigma = jnp.concatenate([jnp.stack([s + o for s in sigmas]), errors.sigma_error * one])
    return jnp.concatenate([x, 0 * one]), jnp.diag(sigma**2)


def first_state(form: Any, belief: tuple[Any, Any]) -> OdometryState:
    """Return the initial state of any filter on odometry and ranges with `beacons`, before the first sample."""
    n, o = np.shape(form.beacons)[0], np.float64(0)
    zero, none, count = np.zeros(n), np.zeros(n, np.int32), np.int32(0)
    fix = RadioFix(zero, zero, zero, np.zeros(n, bool), none, count, count, count, count, count)
    return OdometryState(np.int64(NEVER), o, o, o, o, np.bool_(False), *belief, fix)


class OdometryMotion(NamedTuple):
    """Motion between two odometry readings: distance (m), angle (rad), time (s), doubtful part of the distance (m)."""

    distance: Any
    turn: Any
    dt: Any
    doubt: Any


def read_odometry(s: Any, sample: Any, t: Any, grip: Any) -> tuple[Any, Any, OdometryMotion]:
    """Return the state with a new reading held in it, whether there is a motion to follow, and that motion."""
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
    """Return state (6 + n,) and covariance after a motion; half of its turn is made before the distance, half after."""
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
    """Return the ranges (n,) to use, 0 where there is none; seconds from the newest odometry to them; the old fix."""
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
    """Return the range to beacon i, `ahead` seconds from the newest odometry with its speed and rate."""
    c = x[HEADING] + x[COURSE] + (s.rate - x[TURN_BIAS]) * ahead / 2
    along = s.speed * ahead * jnp.stack([jnp.cos(c), jnp.sin(c)])
    beacon = jnp.asarray(beacons)[i]
    away, height = x[NORTH : EAST + 1] + along - beacon[:2], down - beacon[2]
    distance = jnp.maximum(jnp.sqrt(jnp.sum(away * away) + height * height), NEAREST)
    u, long = away / distance, 1 + x[SCALE]
    swing = long * (u[1] * along[0] - u[0] * along[1])
    pose = jnp.stack([swing, long * u[0], long * u[1], -swing * ahead / 2, swing, distance])
    errors = (jnp.arange(x.shape[0] - ERRORS) == i).astype(np.float64)
    return PredictedRange(long * distance + x[ERRORS:] @ errors, jnp.concatenate([pose, errors]))


def fuse_range(form: Any, s: OdometryState, x: Any, P: Any, fix: RadioFix, i: Any, z: Any, ahead: Any) -> Any:
    """Return state, covariance and fix after a range z (m) to beacon i."""
    e = form.errors
    at = predict_range(x, i, form.beacons, form.down, s, ahead)
    y, H, R = (z - at.range)[None], at.H[None], jnp.reshape(e.noise**2, (1, 1))
    in_a_row = fix.rejected_in_a_row + 1
    gives_in = (e.patience > 0) & (in_a_row >= e.patience)
    first = update(x, P, y, H, R, gate=e.gate)
    gives_in = gives_in & ~first.accepted
    doubt = (np.arange(x.shape[0]) == NORTH) | (np.arange(x.shape[0]) == EAST)  # the place alone: it was moved
    forced = update(x, P + jnp.diag(jnp.where(doubt, y[0] ** 2, 0.0)), y, H, R)
    result = tree_where(gives_in, forced, first)
    used, me = result.accepted, jnp.arange(fix.nis.shape[0]) == i
    sigma = jnp.sqrt(first.S[0, 0])
    fix = replace(
        fix,
        innovation=jnp.where(me, first.innovation[0], fix.innovation),
        normalised=jnp.where(me, first.innovation[0] / sigma, fix.normalised),
        nis=jnp.where(me, first.nis, fix.nis),
        accepted=jnp.where(me, used, fix.accepted),
        refused_in_a_row=jnp.where(me, jnp.where(used, 0, fix.refused_in_a_row + 1), fix.refused_in_a_row).astype(
            np.int32
        ),
        used=increment(fix.used, used),
        rejected=increment(fix.rejected, ~used),
        rejected_in_a_row=jnp.where(used, 0, in_a_row).astype(np.int32),
        given_in=increment(fix.given_in, gives_in),
    )
    return result.x, result.P, fix


def planar_estimate(t: Any, s: Any, x: Any, P: Any, fresh: Any, valid: Any) -> Estimate:
    """Return the estimate of a filter on odometry and ranges: x (6 + n,), P at the time of the newest odometry of s."""
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
    age = jnp.where(s.t > NEVER, to_seconds(t - s.t), 0.0)
    return Estimate(t=t, age=age, fresh=fresh, valid=valid, state=state)
