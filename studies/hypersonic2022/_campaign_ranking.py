"""Ranking of the coefficients by Sobol's indices of success, and by the tolerable error of each alone.

Source: [5] Saltelli et al., "Variance based sensitivity analysis of model output", Computer Physics Communications 181
(2010): total index, the share of the variance of success that would be left if all but this one were known.
"""

import warnings
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from studies.hypersonic2022._campaign import COEFFICIENTS, KINDS, NAMES, fly_plants

FACTORS = (*NAMES, "disturbance")
COARSE = np.geomspace(0.01, 0.9, 16)
FINE = 9


class Indices(NamedTuple):
    """Sobol indices of FACTORS (38,).

    first, total: first-order and total indices.  low, high: 95 % bootstrap interval of the total indices.
    share: share of the runs that succeeded.
    """

    first: Any
    total: Any
    low: Any
    high: Any
    share: float


class Threshold(NamedTuple):
    """Tolerable error of each coefficient in NAMES (37,).

    down, up: fraction by which it alone can fall or rise without failure. Infinite if a change of 0.9 does not fail.
    """

    down: Any
    up: Any

    @property
    def least(self) -> Any:
        """Return the smaller of down and up (37,)."""
        return np.minimum(self.down, self.up)


@cache
def sobol_indices(size: float, integral: bool, n: int = 128) -> Indices:
    """Return Sobol's indices of success, with coefficients uniform in 1 +- size, any of KINDS, and the same noise.

    Args:
        size: half-width of the coefficients' factors.
        integral: True for integral action in the law.
        n: base sample size, a power of 2. The number of runs is 40 n.
    """
    calls: list[Any] = []

    def succeeded(x: Any) -> Any:
        kinds = np.minimum(x[-1].astype(int), len(KINDS) - 1)
        found = fly_plants(x[:-1].T, kinds, integral=integral, seeds=np.zeros(x.shape[1], int)).is_success
        calls.append(found)
        return found.astype(float)

    ends = stats.uniform(1 - size, 2 * size), stats.uniform(0, len(KINDS))
    dists = [ends[0]] * len(COEFFICIENTS) + [ends[1]]
    sobol: Any = stats.sobol_indices
    found = sobol(func=succeeded, n=n, dists=dists, random_state=np.random.default_rng(1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a factor that never changes the outcome has no variance to resample
        bounds = found.bootstrap(confidence_level=0.95, n_resamples=500).total_order.confidence_interval
    low, high = (np.where(np.isfinite(b), b, found.total_order) for b in (bounds.low, bounds.high))
    return Indices(found.first_order, found.total_order, low, high, float(np.concatenate(calls).mean()))


@cache
def failure_thresholds(integral: bool) -> Threshold:
    """Scale each coefficient alone, down and up, by growing amounts until the first failure, then refine."""
    signs = np.array([-1.0, 1.0])
    count = len(COEFFICIENTS), 2
    below, above = _bracket_failure(np.broadcast_to(COARSE, (*count, len(COARSE))), signs, integral)
    finite = np.where(np.isfinite(above), above, 0.9)
    inner = below[..., None] + (finite - below)[..., None] * np.arange(1, FINE + 1) / (FINE + 1)
    low, high = _bracket_failure(inner, signs, integral, below)
    high = np.where(np.isfinite(high), high, above)
    low = np.where(np.isfinite(above), (low + high) / 2, np.inf)
    return Threshold(low[:, 0], low[:, 1])


def _bracket_failure(grid: Any, signs: Any, integral: bool, start: Any = 0.0) -> tuple[Any, Any]:
    """Return the last error before the first failure, and the first error that fails (inf if none does): (37, 2).

    grid: errors (37, 2, n).
    """
    d, two, n = grid.shape
    factors = np.ones((d, two, n, d))
    for i in range(d):
        factors[i, :, :, i] += signs[:, None] * grid[i]
    found = fly_plants(
        factors.reshape(-1, d), np.zeros(d * two * n, int), integral=integral, seeds=np.zeros(d * two * n, int)
    )
    failed = ~found.is_success.reshape(d, two, n)
    none = ~failed.any(axis=2)
    first = np.where(none, n, failed.argmax(axis=2))
    before = np.take_along_axis(grid, np.maximum(first - 1, 0)[..., None], axis=2)[..., 0]
    at = np.take_along_axis(grid, np.minimum(first, n - 1)[..., None], axis=2)[..., 0]
    return np.where(first > 0, before, start), np.where(none, np.inf, at)


def rank_names(values: Any, names: tuple[str, ...], *, most: bool) -> list[str]:
    """Return the names by value, largest or smallest first."""
    return [names[i] for i in np.argsort(-np.asarray(values) if most else np.asarray(values), kind="stable")]


def rank_correlation(total: Any, least: Any) -> float:
    """Return the rank correlation of total indices and thresholds: 1 for equal order, NaN if either is constant."""
    capped = np.minimum(least, 1.0)
    if np.ptp(total) == 0 or np.ptp(capped) == 0:
        return np.nan
    found: Any = stats.spearmanr(total, -capped)
    return float(found.statistic)
