"""Model of an ultrasonic range as a function of position, with cone error: value, slope and curvature. Also the
compensation of the cone error, and the update of a filter with the ranges of a ping, one after another.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
5.5.4; [4] Bar-Shalom, Li, Kirubarajan, "Estimation with applications to tracking and navigation", Wiley 2001, sections
5.2 and 10.3 (second order), as Jazwinski, "Stochastic processes and filtering theory", 1970, section 9.3; Schmidt 1966
for considered states.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.environment.acoustics import LINEAR, QUADRATIC, off_axis_angle, range_ratio
from trimtab.estimators.inertial.mechanisation import DIMENSION, rotate_lever
from trimtab.estimators.kalman import update
from trimtab.estimators.ranging.range_errors import RangeErrorModel

ITERATIONS = 8
TOLERANCE = 1e-6
TOP = LINEAR / (1 - 2 * QUADRATIC)
"""Angle beta off a beacon's axis (rad), about 0.003, at which e(beta) cos(beta) has its maximum, and thus zero slope. e
is the ratio of true to measured range."""
START, FARTHEST = 2.2 * TOP, 1.4
"""Smallest and largest initial angle (rad) of Newton's method. For a range above the height, no root is below 2 TOP."""
POSE = np.array([0, 3, 4])
"""Indices of heading and position, the states on which a predicted range depends nonlinearly."""


def compensate_range(measured: Any, height: Any) -> tuple[Any, Any, Any]:
    """Return the true range r, the angle beta off the beacon's axis, and the number of iterations.

        e(beta) cos(beta) = h / rho,   r = e(beta) rho

    e is the ratio of true to measured range. The equation is solved by Newton's method from acos(h/rho), to 1e-6. Its
    left side rises from 1 at beta = 0 to a maximum at 0.003 rad, and falls beyond. Therefore the iteration starts
    beyond the maximum. If noise makes a range smaller than the height, there is no solution. Then the measured range
    and an angle of 0 are returned.

    Args:
        measured: measured range rho (m), any shape.
        height: height of the beacon above the unit (m), same shape.

    Source: [1] section 5.5.4; the safeguards are added, see docs Errata.
    """
    climbs = (measured > height) & (height > 0)
    goal = jnp.where(climbs, height / jnp.where(climbs, measured, 1.0), 0.9)
    beta = jnp.clip(off_axis_angle(goal, jnp.ones_like(goal)), START, FARTHEST)

    def closer(_: Any, carry: Any) -> Any:
        beta, iterations = carry
        ratio, slope = range_ratio(beta), 2 * QUADRATIC * beta + LINEAR
        excess = ratio * jnp.cos(beta) - goal
        step = excess / (slope * jnp.cos(beta) - ratio * jnp.sin(beta))
        going = jnp.abs(excess) > TOLERANCE
        beta = jnp.where(going, jnp.clip(beta - step, 1.5 * TOP, FARTHEST), beta)
        return beta, iterations + going

    beta, iterations = lax.fori_loop(0, ITERATIONS, closer, (beta, jnp.zeros_like(beta)))
    true_range = jnp.where(climbs, range_ratio(beta) * measured, measured)
    return true_range, jnp.where(climbs, beta, 0.0), jnp.where(climbs, iterations, 0.0)


class RangePrediction(NamedTuple):
    """Predicted range (m), its derivative by north and east (2,), and its second derivative (2, 2) in 1/m."""

    range: Any
    slope: Any
    curvature: Any


def predict_range(beacon: Any, place: Any, down: Any, *, cone: bool) -> RangePrediction:
    """Return the range from an ultrasonic unit to a beacon, including the cone error but no noise.

        d / e(beta),  tan beta = |p - q| / h,  e = 1 without cone error

    d is the distance, e the ratio of true to measured range, beta the angle off the beacon's axis. The cone error is
    modelled, not compensated, for two reasons. The noise is that of the measured range, and a range that noise has made
    shorter than the height can't be compensated. The curvature is that of the distance d.

    beacon: north, east, down in W (3,).  place: north and east of the unit (2,).  down: down coordinate of the unit.
    cone: True if the cone error makes ranges off the axis too long.
    """
    away, height = place - beacon[:2], down - beacon[2]
    square = away @ away
    distance = jnp.sqrt(square + height * height)
    distance = jnp.where(distance > 0, distance, 1.0)
    g = away / distance
    curvature = (jnp.eye(2) - g[:, None] * g[None, :]) / distance
    if not cone:
        return RangePrediction(distance, g, curvature)
    aside = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    aside = jnp.where(square > 0, aside, 0.0)
    beta = jnp.arctan2(aside, height)
    e, rises = range_ratio(beta), 2 * QUADRATIC * beta + LINEAR
    direction = away / jnp.where(aside > 0, aside, 1.0)
    slope = g / e - direction * (rises * height / (e * e * distance))
    return RangePrediction(distance / e, slope, curvature)


class Geometry(NamedTuple):
    """Geometry of the ranges of one ultrasonic unit.

    beacons: positions in W (n, 3).  lever: vector in B from the navigated point to the unit (2,).  down: down
    coordinate of the unit.  cone: True to model the cone error.
    """

    beacons: Any
    lever: Any
    down: Any
    cone: bool


def unit_geometry(form: Any, unit: Any) -> Geometry:
    """Return the geometry of the ranges of an ultrasonic unit.

    form: a filter with beacons, units, down, arms and cone.  unit: index of the ultrasonic unit.
    """
    lever = jnp.asarray(form.units, np.float64)[unit]
    beacons = jnp.asarray(form.beacons, np.float64)
    return Geometry(beacons, lever[:2] - form.arms.imu, form.down + lever[2], form.cone)


class LinearisedRange(NamedTuple):
    """Predicted range at a state: value, derivative (k,), and contributions of the curvature to mean and variance."""

    range: Any
    H: Any
    mean: Any
    variance: Any


class RangeUpdate(NamedTuple):
    """Result of an update with the ranges of a ping.

    x, P: state and covariance.  innovation, variance, nis: innovation of each range, its variance and NIS (n,).
    accepted: True for ranges used (n,).
    """

    x: Any
    P: Any
    innovation: Any
    variance: Any
    nis: Any
    accepted: Any


def linearise_range(x: Any, P: Any, i: Any, g: Geometry) -> LinearisedRange:
    """Return the predicted range to beacon i at a state (9 + n,), which consists of Belief.x, the scale error and the
    errors of the beacons.

    With the range's Hessian A by (heading, north, east) and the covariance S of these states, the uncertainty of a
    Gaussian state adds tr(A S)/2 to the mean and tr(A S A S)/2 to the variance ([4] section 10.3.3).
    """
    n = g.beacons.shape[0]
    arm, slope = rotate_lever(x[0], g.lever)
    at = predict_range(jnp.asarray(g.beacons)[i], x[3:5] + arm, g.down, cone=g.cone)
    T = jnp.concatenate([slope[:, None], jnp.eye(2)], axis=1)
    by_pose = at.slope @ T
    grows = 1 + x[DIMENSION]
    none = jnp.zeros(3)
    own = (jnp.arange(n) == i).astype(np.float64)
    H = jnp.concatenate([grows * by_pose[:1], none[:2], grows * by_pose[1:], none, at.range[None], own])
    swing = jnp.where(np.arange(9).reshape(3, 3) == 0, -(at.slope @ arm), 0.0)
    A = (T.T @ at.curvature @ T + swing) @ P[POSE][:, POSE]
    mean, variance = (A[0, 0] + A[1, 1] + A[2, 2]) / 2, jnp.sum(A * A.T) / 2
    return LinearisedRange(grows * at.range + x[DIMENSION + 1 + i], H, mean, variance)


def update_with_ranges(
    x: Any, P: Any, ranges: Any, usable: Any, g: Geometry, errors: RangeErrorModel, learns: Any
) -> RangeUpdate:
    """Fuse the usable ranges (n,) of a ping, one after another, each linearised at the current state.

    learns: mask of the states (9 + n,), 0 for states that are considered, not corrected.
    """

    def one(carry: Any, row: Any) -> Any:
        x, P = carry
        i, z, use = row
        at = linearise_range(x, P, i, g)
        extra = at.variance if errors.second_order else 0.0
        y = z - at.range - (at.mean if errors.second_order else 0.0)
        gate = jnp.where(use, errors.gate, -1.0)
        R = jnp.reshape(errors.noise**2 + extra, (1, 1))
        correction = update(x, P, y[None], at.H[None], R, gate=gate, consider=learns)
        y_used, nis = (jnp.where(use, v, 0.0) for v in (correction.innovation[0], correction.nis))
        return (correction.x, correction.P), (y_used, correction.S[0, 0], nis, correction.accepted)

    rows = jnp.arange(ranges.shape[0]), ranges, usable
    (x, P), (y, S, nis, accepted) = lax.scan(one, (x, P), rows)
    return RangeUpdate(x, P, y, S, nis, accepted)


def place_information(place: Any, used: Any, g: Geometry, sigma: Any) -> Any:
    """Return the information matrix (2, 2) of an ultrasonic unit's position (2,) from the used ranges (n,).

    sigma: standard deviation of each range.
    """
    slopes = jax.vmap(lambda b: predict_range(b, place, g.down, cone=g.cone).slope)(g.beacons)
    slopes = jnp.where(used[:, None], slopes, 0.0)
    return slopes.T @ slopes / sigma**2
