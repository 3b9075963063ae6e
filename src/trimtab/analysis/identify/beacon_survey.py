"""Survey of beacons, from ranges to them and the motion of the ranging unit.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record


@record
class BeaconSurvey:
    """Surveyed beacons, and the path of the survey.

    Frames:  W, whose origin and orientation are those of the first pose and of the odometry.
    Source:  Triggs et al., "Bundle adjustment: a modern synthesis", 1999; the task is from [1] chapter 7.
    """

    beacons: Any = quantity("m", "Positions (n, 3).", frame="W")
    covariance: Any = quantity("m^2", "Covariance of each beacon's position (n, 3, 3).")
    path: Any = quantity("m", "North, east of the unit at each ping (k, 2).", frame="W")
    residual: Scalar = quantity("1", "Root of the sum of squared weighted residuals over their degrees of freedom.")
    iterations: Scalar = quantity("1", "Steps of Gauss and Newton.", kind="count")

    def standard_errors(self) -> Any:
        """Return standard errors of the beacons' coordinates (m), (n, 3), from the given noise of ranges, odometry."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def survey_beacons(
    ranges: Any, odometry: Any, *, range_noise: float, odometry_noise: float, iterations: int = 30
) -> BeaconSurvey:
    """Estimate beacons and path by least squares over all pings, from ranges and the steps between them.

    Args:
        ranges: true ranges (m), corrected for the cone error, shape (k, n); NaN without a reply.
        odometry: step from each ping to the next (m), north and east, shape (k - 1, 2), from odometry or inertial
            navigation. Its frame becomes W, with the place of the first ping as origin.
        range_noise: standard deviation of a range (m).
        odometry_noise: standard deviation of each coordinate of a step (m).
        iterations: maximum number of Gauss-Newton steps.

    The unit stays at down = 0 and the beacons are above it. Each beacon needs four pings that are not on one line.
    """
    ranges, odometry = _check_ranges(ranges, odometry, range_noise, odometry_noise)
    k, n = ranges.shape
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(odometry, axis=0)])
    beacons = np.stack([_guess_beacon(path, ranges[:, j], j) for j in range(n)])
    x = np.concatenate([beacons.ravel(), path[1:].ravel()])
    done, step = 0, np.full(1, np.inf)
    while done < iterations and np.abs(step).max() >= 1e-10:
        r, J = _weighted_residuals(x, ranges, odometry, range_noise, odometry_noise)
        step = np.linalg.solve(J.T @ J, -J.T @ r)
        x, done = x + step, done + 1
    r, J = _weighted_residuals(x, ranges, odometry, range_noise, odometry_noise)
    covariance = np.linalg.inv(J.T @ J)
    blocks = np.stack([covariance[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] for j in range(n)])
    rest = float(np.sqrt(r @ r / max(len(r) - len(x), 1)))
    path = np.concatenate([np.zeros((1, 2)), x[3 * n :].reshape(k - 1, 2)])
    return BeaconSurvey(x[: 3 * n].reshape(n, 3), blocks, path, rest, done)


def _check_ranges(ranges: Any, odometry: Any, range_noise: float, odometry_noise: float) -> tuple[Any, Any]:
    ranges, odometry = np.asarray(ranges, np.float64), np.asarray(odometry, np.float64)
    if ranges.ndim != 2 or odometry.shape != (len(ranges) - 1, 2):
        problem = f"got ranges of shape {ranges.shape}, odometry of shape {odometry.shape}"
        raise InputError("survey", problem, fix="give (k, n) ranges and (k - 1, 2) steps between them")
    if not (range_noise > 0 and odometry_noise > 0):
        problem = f"noise of {range_noise} m and {odometry_noise} m does not give weights"
        raise InputError("survey", problem, fix="give standard deviations above 0")
    return ranges, odometry


def _guess_beacon(path: Any, ranges: Any, number: int) -> Any:
    """Estimate a beacon (3,) from rho^2 = |p|^2 - 2 p.b + c, linear in b and c = |b|^2 + h^2, for the path as given."""
    there = np.isfinite(ranges)
    A = np.concatenate([-2 * path[there], np.ones((there.sum(), 1))], axis=1)
    if len(A) < 4 or np.linalg.matrix_rank(A - A.mean(0), tol=1e-3) < 2:
        raise InputError(
            "survey",
            f"the {len(A)} pings that beacon {number} answered lie on one line, or are fewer than 4",
            fix="drive a loop under it",
        )
    b = np.linalg.lstsq(A, ranges[there] ** 2 - (path[there] ** 2).sum(1), rcond=None)[0]
    return np.array([b[0], b[1], -np.sqrt(max(b[2] - b[0] ** 2 - b[1] ** 2, 0.01))])


def _weighted_residuals(
    x: Any, ranges: Any, odometry: Any, range_noise: float, odometry_noise: float
) -> tuple[Any, Any]:
    """Return weighted residuals and their Jacobian: unknowns are n beacons (3 each), then k - 1 places (2 each)."""
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
