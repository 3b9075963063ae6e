"""Least-squares fit of a few coefficients, with their covariance and rejection of outliers.

Candidates for outliers are found with a robust fit (least absolute deviations). Each is then tested against an ordinary
least-squares fit of the other readings. A reading is left out and reported if its distance from that fit exceeds
the distance that occurs by chance in one of a hundred tables without outliers.

Source: Rousseeuw, Leroy, "Robust regression and outlier detection", 1987, section 5.1, for the scale and the
re-weighting; Weisberg, "Applied linear regression", 2005, section 9.1, for the test of one reading against the others.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes a second to import

from trimtab.loop.calibration import student_reach

CHANCE = 0.01
"""Probability that a reading is left out although the table has no outliers."""
ROUNDS = 50


class LinearFit(NamedTuple):
    """Linear fit y = A b of n readings y with k coefficients b.

    value: b (k,).  covariance: covariance of b (k, k).  residuals: y - A b (n,), also of outliers.
    kept: (n,) bool, False for outliers. deviation: standard deviation of a reading.
    freedom: degrees of freedom, i.e. number of readings kept minus k.
    """

    value: Any
    covariance: Any
    residuals: Any
    kept: Any
    deviation: float
    freedom: int

    def standard_errors(self) -> Any:
        """Return the standard error of each coefficient (k,)."""
        return np.sqrt(np.diagonal(self.covariance))

    def interval(self) -> tuple[Any, Any]:
        """Return lower and upper limits (k,) of the coefficients' 95 % intervals, by Student's t distribution."""
        reach = student_reach(self.freedom) * self.standard_errors()
        return self.value - reach, self.value + reach


def fit_linear(A: Any, y: Any, floor: float = 0.0) -> LinearFit:
    """Fit y = A b by least squares, and leave out outliers. n must exceed k.

    Args:
        A: regression matrix (n, k), one column for each coefficient, of full rank.
        y: readings (n,).
        floor: minimum standard deviation of a reading, e.g. due to rounding, in the unit of y.
    """
    A, y = np.asarray(A, np.float64), np.asarray(y, np.float64)
    kept = _select_consistent(A, y, floor)
    value, S, deviation, freedom = _fit_kept(A, y, kept, floor)
    return LinearFit(value, S * deviation**2, y - A @ value, kept, deviation, freedom)


def _fit_kept(A: Any, y: Any, kept: Any, floor: float) -> tuple[Any, Any, float, int]:
    """Return estimate, (A'A)^-1, standard deviation of a reading and degrees of freedom, from the readings kept."""
    some = A[kept]
    scale = np.linalg.norm(some, axis=0)
    inverse = np.linalg.inv((some / scale).T @ (some / scale)) / np.outer(scale, scale)
    value = np.linalg.lstsq(some / scale, y[kept], rcond=None)[0] / scale
    freedom = int(kept.sum()) - A.shape[1]
    rest = y[kept] - some @ value
    return value, inverse, max(math.sqrt(float(rest @ rest) / max(freedom, 1)), floor), freedom


def _select_consistent(A: Any, y: Any, floor: float) -> Any:
    """Return a mask (n,) that is True for readings that are not outliers.

    At least 60 % and at least k + 2 readings are kept.
    """
    n, k = A.shape
    kept = np.ones(n, bool)
    least = max(k + 2, math.ceil(0.6 * n))
    if n < k + 3:
        return kept
    rest = np.abs(y - A @ _least_deviations(A, y))
    scale = max(1.4826 * (1 + 5 / (n - k)) * float(np.median(np.sort(rest)[k:])), floor, 1e-12 * np.ptp(y) + 1e-300)
    kept = rest <= 2.5 * scale
    if kept.sum() < least:
        kept = rest <= np.sort(rest)[least - 1]
    for _ in range(ROUNDS):
        value, S, deviation, freedom = _fit_kept(A, y, kept, floor)
        leverage = np.einsum("ij,jk,ik->i", A, S, A)
        alone = np.where(kept, np.sqrt(np.maximum(1 - leverage, 1e-12)), np.sqrt(1 + leverage))
        z = np.abs(y - A @ value) / (max(deviation, 1e-300) * alone)
        inside = kept & (freedom > 1)
        t = z * np.sqrt(np.where(inside, np.maximum(freedom - 1, 1) / np.maximum(freedom - z**2, 1e-9), 1.0))
        limit = stdtrit(np.where(inside, max(freedom - 1, 1), max(freedom, 1)), 1 - CHANCE / (2 * n))
        new = t <= limit
        if new.sum() < least:
            new = t <= np.sort(t)[least - 1]
        if (new == kept).all():
            break
        kept = new if new.sum() <= kept.sum() + 1 else kept | (t == t[~kept].min())
    return kept


def _least_deviations(A: Any, y: Any) -> Any:
    """Return the coefficients (k,) that minimise the sum of absolute deviations, by re-weighted least squares."""
    value = np.linalg.lstsq(A, y, rcond=None)[0]
    small = 1e-6 * (np.ptp(y) or 1.0)
    for _ in range(ROUNDS):
        w = 1 / np.sqrt(np.maximum(np.abs(y - A @ value), small))
        value = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)[0]
    return value
