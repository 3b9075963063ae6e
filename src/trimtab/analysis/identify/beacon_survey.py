"""Survey of beacon positions, from measured ranges to the beacons and the motion of the vehicle's ranging receiver.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record

ANGLES = np.radians([15.0, 60.0, 90.0, 120.0, 165.0])
"""Start values (rad) for a beacon's angle about the main line of the path. One search is made from each.

The start positions of a beacon all have the same distance from the line, which is estimated from the ranges.
"""
DAMPING, DAMPING_MAX = 1e-3, 1e12
"""Initial and largest damping of a Levenberg-Marquardt step, relative to the diagonal of J'J."""
CONVERGED = 1e-8
"""Largest change of an unknown in a converged search's last step, in standard errors of the unknown."""
EQUAL = 12.0
"""Largest difference in squared residuals of two solutions, in mean square residuals, at which both are possible."""
APART = 5.0
"""Distance between two solutions for a beacon, in standard errors, above which the solutions count as different."""
DETERMINED = 0.1
"""Largest accepted standard error of a beacon's coordinate, as a fraction of the beacon's distance."""


@record
class BeaconSurvey:
    """Surveyed beacon positions, and path of the ranging receiver.

    Frames:  W: the origin is the receiver's position at the first ping, the axes are those of the odometry.
    Source:  Triggs et al., "Bundle adjustment: a modern synthesis", 1999; the task is from [1] chapter 7.
    """

    beacons: Any = quantity("m", "Positions of the beacons (n, 3).", frame="W")
    covariance: Any = quantity("m^2", "Covariance of each beacon's position (n, 3, 3).")
    path: Any = quantity("m", "North and east position of the ranging receiver at each ping (k, 2).", frame="W")
    residual: Scalar = quantity("1", "Root of the weighted sum of squared residuals per degree of freedom.")
    iterations: Scalar = quantity("1", "Number of steps of the Levenberg-Marquardt search.", kind="count")

    def standard_errors(self) -> Any:
        """Return standard errors (n, 3) of the beacons' coordinates (m), which follow from the assumed noise."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def survey_beacons(
    ranges: Any, odometry: Any, *, range_noise: float, odometry_noise: float, iterations: int = 100
) -> BeaconSurvey:
    """Estimate positions of beacons and the path of the ranging receiver by least squares, from ranges and odometry.

    Args:
        ranges: measured ranges (k, n) in m, for k pings and n beacons, corrected for the cone error. NaN means no
            reply.
        odometry: displacement from each ping to the next (m), north and east, shape (k - 1, 2), from odometry or
            inertial navigation. The axes of the odometry become those of W. The origin of W is the position at the
            first ping.
        range_noise: standard deviation of a range (m).
        odometry_noise: standard deviation of each coordinate of a displacement (m).
        iterations: maximum number of search steps from each start position.

    The receiver stays at down = 0, and the beacons are above. Each beacon must answer four pings that are not on one
    line.

    Raises: InputError if no search converges, if several positions of a beacon fit the ranges equally well, or if the
    standard error of a beacon's coordinate exceeds DETERMINED times the beacon's distance.
    """
    ranges, odometry = _check_ranges(ranges, odometry, range_noise, odometry_noise)
    k, n = ranges.shape
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(odometry, axis=0)])

    def residuals(x: Any) -> tuple[Any, Any]:
        return _weighted_residuals(x, ranges, odometry, range_noise, odometry_noise)

    found = []
    for angle in ANGLES:
        beacons = np.stack([_guess_beacon(path, ranges[:, j], j, angle) for j in range(n)])
        end = _search(residuals, np.concatenate([beacons.ravel(), path[1:].ravel()]), iterations)
        if end is not None:
            found.append(_put_above(end, n))
    if not found:
        fix = "drive loops as wide as the beacons are high; leave out ranges with large errors"
        raise InputError("survey", f"no search for the beacon positions converges in {iterations} steps", fix=fix)
    best = min(found, key=lambda end: end.cost)
    dof = max(int(np.isfinite(ranges).sum()) + 2 * (k - 1) - len(best.x), 1)
    rest = float(np.sqrt(best.cost / dof))
    _refuse_doubt(best, found, n, path, EQUAL * max(1.0, rest**2))
    blocks = np.stack([best.covariance[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] for j in range(n)])
    path = np.concatenate([np.zeros((1, 2)), best.x[3 * n :].reshape(k - 1, 2)])
    return BeaconSurvey(best.x[: 3 * n].reshape(n, 3), blocks, path, rest, best.steps)


class _SearchEnd(NamedTuple):
    """Result of a search. x: unknowns.  cost: sum of squared residuals.  covariance: covariance of x.

    steps: number of search steps.
    """

    x: Any
    cost: float
    covariance: Any
    steps: int


def _put_above(end: _SearchEnd, n: int) -> _SearchEnd:
    """Return the result with all beacons above the ranging receiver. Beacons mirrored below have the same ranges."""
    sign = np.ones(len(end.x))
    sign[2 : 3 * n : 3] = np.where(end.x[2 : 3 * n : 3] > 0, -1.0, 1.0)
    return end._replace(x=end.x * sign, covariance=end.covariance * np.outer(sign, sign))


def _search(residuals: Callable[[Any], tuple[Any, Any]], x: Any, iterations: int) -> _SearchEnd | None:
    """Return the result of a Levenberg-Marquardt search. Return None if it does not converge or determine all unknowns.

    Source: D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", SIAM J. 11 (1963).
    """
    damping, done = DAMPING, 0
    r, J = residuals(x)
    for _ in range(iterations):
        done += 1
        normal, gradient = J.T @ J, J.T @ r
        size = np.diag(normal)
        try:
            step = -np.linalg.solve(normal + damping * np.diag(size), gradient)
        except np.linalg.LinAlgError:
            return None
        there, slope = residuals(x + step)
        if np.isfinite(there).all() and there @ there <= r @ r:
            x, r, J, damping = x + step, there, slope, max(damping / 10, 1e-12)
            if np.abs(step * np.sqrt(size)).max() <= CONVERGED:
                break
        elif np.abs(step * np.sqrt(size)).max() <= CONVERGED:
            break
        else:
            damping *= 10
            if damping > DAMPING_MAX:
                return None
    else:
        return None
    scale = np.sqrt(np.diag(J.T @ J))
    if np.linalg.cond(J / scale) > 1 / np.sqrt(np.finfo(float).eps):
        return None
    inverse = np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale)
    return _SearchEnd(x, float(r @ r), inverse, done)


def _refuse_doubt(best: _SearchEnd, found: list[_SearchEnd], n: int, path: Any, near: float) -> None:
    """Raise InputError if two positions of a beacon fit equally well, or if the ranges do not determine the position.

    near: largest difference of the sums of squared residuals at which two positions fit equally well.
    """
    fix = "drive a loop under the beacon, as wide as the beacon is high, and measure more ranges"
    errors = np.sqrt(np.diag(best.covariance)[: 3 * n]).reshape(n, 3)
    places = best.x[: 3 * n].reshape(n, 3)
    middle = np.append(path.mean(axis=0), 0.0)
    for j in range(n):
        distance = float(np.linalg.norm(places[j] - middle))
        if not errors[j].max() <= DETERMINED * distance:
            problem = (
                f"the ranges do not determine beacon {j}: standard error {errors[j].max():.3g} m at {distance:.3g} m"
            )
            raise InputError("survey", problem, fix=fix)
        for other in found:
            there = other.x[3 * j : 3 * j + 3]
            if other.cost - best.cost <= near and (np.abs(there - places[j]) > APART * errors[j]).any():
                texts = (np.array2string(p, precision=3, suppress_small=True) for p in (places[j], there))
                problem = f"two positions of beacon {j} fit the ranges equally well: {' and '.join(texts)} m"
                raise InputError("survey", problem, fix=fix)


def _check_ranges(ranges: Any, odometry: Any, range_noise: float, odometry_noise: float) -> tuple[Any, Any]:
    ranges, odometry = np.asarray(ranges, np.float64), np.asarray(odometry, np.float64)
    if ranges.ndim != 2 or odometry.shape != (len(ranges) - 1, 2):
        problem = f"got ranges of shape {ranges.shape}, odometry of shape {odometry.shape}"
        raise InputError("survey", problem, fix="pass ranges (k, n) and displacements (k - 1, 2) between pings")
    if not (range_noise > 0 and odometry_noise > 0):
        problem = f"range_noise and odometry_noise must be above 0 m, got {range_noise} m and {odometry_noise} m"
        raise InputError("survey", problem, fix="pass standard deviations above 0")
    return ranges, odometry


def _guess_beacon(path: Any, ranges: Any, number: int, angle: float) -> Any:
    """Estimate a beacon's position (3,), as the start of a search, from the ranges to the beacon and the path.

    rho^2 = s^2 - 2 a s + c is linear in a and c. rho is a range. s and a are the positions of receiver and beacon along
    the main line of the path. c - a^2 is the beacon's squared distance from the line. number: index of the beacon, for
    errors. angle: angle of the beacon about the line (rad), from horizontal upwards.
    """
    there = np.isfinite(ranges)
    if there.sum() < 4:
        problem = f"beacon {number} answered {there.sum()} pings; at least 4 are needed"
        raise InputError("survey", problem, fix="drive a loop under the beacon")
    points, rho = path[there], ranges[there]
    centre = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - centre)
    s = (points - centre) @ axes[0]
    if extent[0] == 0:
        raise InputError(
            "survey",
            f"all pings that beacon {number} answered were sent from one point",
            fix="drive a loop under the beacon",
        )
    a, c = np.linalg.lstsq(np.stack([-2 * s, np.ones(len(s))], axis=1), rho**2 - s**2, rcond=None)[0]
    away = np.sqrt(max(c - a * a, 0.01))
    place = centre + a * axes[0] + away * np.cos(angle) * axes[1]
    return np.array([*place, -away * np.sin(angle)])


def _weighted_residuals(
    x: Any, ranges: Any, odometry: Any, range_noise: float, odometry_noise: float
) -> tuple[Any, Any]:
    """Return the weighted residuals of ranges and odometry, and their Jacobian.

    x: coordinates of n beacons (3 each), then of k - 1 positions of the ranging receiver (2 each).
    """
    k, n = ranges.shape
    beacons = x[: 3 * n].reshape(n, 3)
    path = np.concatenate([np.zeros((1, 2)), x[3 * n :].reshape(k - 1, 2)])
    ping, beacon = np.nonzero(np.isfinite(ranges))
    line = beacons[beacon] - np.concatenate([path[ping], np.zeros((len(ping), 1))], axis=1)
    distance = np.linalg.norm(line, axis=1)
    unit = line / distance[:, None] / range_noise
    m = len(ping)
    J = np.zeros((m + 2 * (k - 1), len(x)))
    rows = np.arange(m)
    for axis in range(3):
        J[rows, 3 * beacon + axis] = unit[:, axis]
    later = ping > 0
    for axis in range(2):
        J[rows[later], 3 * n + 2 * (ping[later] - 1) + axis] = -unit[later, axis]
    row, column = m + np.arange(2 * (k - 1)), 3 * n + np.arange(2 * (k - 1))
    J[row, column] = 1 / odometry_noise
    J[row[2:], column[:-2]] = -1 / odometry_noise
    steps = (np.diff(path, axis=0) - odometry).ravel() / odometry_noise
    return np.concatenate([(distance - ranges[ping, beacon]) / range_noise, steps]), J
