"""Sensitivity of a metric to each factor: Sobol indices of first and total order from the rows of a Saltelli design.

    S_i = V(E(Y | x_i)) / V(Y)          T_i = 1 - V(E(Y | all but x_i)) / V(Y)

S_i is the share of the variance that would vanish if factor i were known. T_i is the share that would remain if all
other factors were known. T_i - S_i is due to interactions with other factors. If the noise is a factor, its T is the
share of the variance that the parameters do not explain.

Source: [1] Sobol, Math. Comput. Simul. 55 (2001); [2] Saltelli et al., Comput. Phys. Commun. 181 (2010), table 2 (b)
and (f), as scipy.stats.sobol_indices has them. Intervals: percentiles of a bootstrap over base samples, [3] Archer,
Saltelli, Sobol, "Sensitivity measures, ANOVA-like techniques and the use of bootstrap", J. Stat. Comput. Simul. 58
(1997). These intervals treat base samples as independent, so they are rather too wide for a Sobol sequence.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from trimtab.analysis.campaign.sampling.points import NOISE, check_factors, rows_per_base
from trimtab.analysis.campaign.statistics.intervals import as_column, check_level
from trimtab.core.errors import InputError

RESAMPLES = 1000
RESAMPLE_BATCH = 50
"""Number of bootstrap resamples computed at a time, to limit memory."""
BASE_SAMPLES_MIN = 8
"""Minimum number of base samples for a useful interval."""


class Sensitivity(NamedTuple):
    """Sobol indices of each factor with confidence intervals. Arrays have shape (factors,); NaN if nothing varies.

    factors: names of the factors. The noise, if it is a factor, is the last.  first, total: indices S and T.
    *_low, *_high: limits of the interval of each index.  variance: variance of the metric, or of its ranks with
    `by_rank`.  base: number of base samples used, a power of two.  rows: number of runs for these base samples.  note:
    reason if the indices are missing, otherwise empty.
    """

    factors: tuple[str, ...]
    first: Any
    first_low: Any
    first_high: Any
    total: Any
    total_low: Any
    total_high: Any
    variance: float
    base: int
    rows: int
    level: float
    note: str

    @property
    def order(self) -> tuple[str, ...]:
        """Return the names of the factors, sorted by total index, the largest first."""
        return tuple(self.factors[i] for i in np.argsort(-self.total, kind="stable"))


def sensitivity(
    values: Any, parameters: Sequence[str], *, noise: bool = True, level: float = 0.95, by_rank: bool = False
) -> Sensitivity:
    """Compute indices of first and total order over the rows of `saltelli(seed, 0, rows, len(parameters))`.

    Args:
        values: metric of rows 0 to n - 1, shape (n,); True and False are allowed. The number of base samples used is
            the largest power of two for which all rows are available.
        parameters: names of the parameters, in the order of the design's columns, without the noise.
        noise: True if the random numbers of the runs are a factor of the design.
        level: confidence of the intervals.
        by_rank: True to use the metric's rank among these rows. Runs without a finite value then have the highest
            ranks, and a few extreme runs do not dominate.
    """
    check_factors(parameters)
    check_level("sensitivity", level)
    size = rows_per_base(len(parameters), noise=noise)
    x = as_column(values, "sensitivity")
    if len(x) < BASE_SAMPLES_MIN * size:
        fix = f"fly at least {BASE_SAMPLES_MIN * size} runs; 1024 base samples are {1024 * size} runs"
        raise InputError(
            "sensitivity", f"got {len(x)} rows, i.e. {len(x) // size} base samples of {size} rows", fix=fix
        )
    base = 1 << int(np.log2(len(x) // size))
    x = x[: base * size]
    names = (*parameters, NOISE) if noise else tuple(parameters)
    x, note = rank_values(x) if by_rank else (x, explain_no_variance(x))
    if note:
        none = np.full(len(names), np.nan)
        return Sensitivity(names, none, none, none, none, none, none, np.nan, base, base * size, level, note)
    table = x.reshape(base, size)
    centre = table[:, [0, -1]].mean()
    a, b, ab = table[:, 0] - centre, table[:, -1] - centre, table[:, 1:-1].T - centre
    indices = stats.sobol_indices(func={"f_A": a[None], "f_B": b[None], "f_AB": ab[:, None]}, n=base)
    low, high = _bootstrap(a, b, ab, level)
    first, total = np.ravel(indices.first_order), np.ravel(indices.total_order)
    variance = float(np.var([a, b]))
    return Sensitivity(names, first, low[0], high[0], total, low[1], high[1], variance, base, base * size, level, "")


def rank_values(x: Any) -> tuple[Any, str]:
    """Return ranks in (0, 1], and the reason why the ranks cannot be used, or "".

    Non-finite values have the highest ranks.
    """
    ranked = stats.rankdata(np.where(np.isfinite(x), x, np.inf)) / len(x)
    return ranked, explain_no_variance(ranked)


def explain_no_variance(x: Any) -> str:
    """Return the reason why the variance of these values cannot be computed, or ""."""
    bad = int(np.count_nonzero(~np.isfinite(x)))
    if bad:
        return f"{bad} of {len(x)} runs have no finite value, so the variance is undefined; use ranks, or the success"
    if np.ptp(x) <= 1e-12 * np.abs(x).max():
        return "all runs gave the same value, so there is no variance to explain"
    return ""


def _bootstrap(a: Any, b: Any, ab: Any, level: float) -> tuple[Any, Any]:
    """Return percentiles (lower, upper) of first and total indices, each (2, factors), over resampled base samples."""
    n, d = len(a), len(ab)
    products = np.concatenate([b * (ab - a), 0.5 * (a - ab) ** 2, [(a + b) / 2, (a * a + b * b) / 2]]).T
    rng, drawn = np.random.default_rng(n), []
    for start in range(0, RESAMPLES, RESAMPLE_BATCH):
        count = min(RESAMPLE_BATCH, RESAMPLES - start)
        moments = rng.multinomial(n, np.full(n, 1 / n), size=count) @ products / n
        drawn.append(moments[:, : 2 * d] / (moments[:, [2 * d + 1]] - moments[:, [2 * d]] ** 2))
    tail = 50 * (1 - level)
    low, high = np.percentile(np.concatenate(drawn), [tail, 100 - tail], axis=0)
    return low.reshape(2, d), high.reshape(2, d)
