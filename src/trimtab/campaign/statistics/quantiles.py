"""Quantiles of a metric over many runs, with bands that assume nothing about its distribution.

How many of n independent values lie below the p-quantile is binomial, so that order statistics bound it:

    P(X(l) > q_p) <= P(B <= l - 1) <= tail        P(X(u) < q_p) <= P(B >= u) <= tail        B ~ Bin(n, p)

with X(1) <= ... <= X(n), the largest such l and the smallest such u. It holds for any distribution, with steps too.

Source: [1] Thompson, "On confidence ranges for the median and other expectation distributions", Ann. Math. Statist. 7
(1936); [2] David, Nagaraja, "Order Statistics", 3rd ed., Wiley 2003, section 7.1; the quantile itself is the inverse of
the empirical distribution, definition 1 of [3] Hyndman, Fan, "Sample quantiles", American Statistician 50 (1996).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from trimtab.campaign.statistics.anytime import least_trials_anytime, ranks_anytime
from trimtab.core.errors import InputError


class Quantile(NamedTuple):
    """A quantile of the runs flown, and the band that holds the quantile of all worlds in `level` of all campaigns.

    p: which quantile.  value: the smallest value that at least p of the runs don't exceed: always one that a run had.
    low, high: the band; -inf or inf where so few runs have no bound on that side.  trials: how many runs.
    not_finite: how many of them had no finite value.  wanted: how many runs a band with both bounds takes at least.
    """

    p: float
    value: float
    low: float
    high: float
    level: float
    trials: int
    not_finite: int
    needed_runs: int

    @property
    def name(self) -> str:
        """As in "p95"."""
        return f"p{100 * self.p:.10g}"

    def __str__(self) -> str:
        """As in "p95 8.31 (8.02 to 8.77)"."""
        few = "" if self.trials >= self.needed_runs else f"; both bounds want {self.needed_runs} runs"
        return f"{self.name} {self.value:.4g} ({self.low:.4g} to {self.high:.4g}{few})"


def quantile(
    values: Any, p: float, level: float = 0.95, *, missing: float = math.inf, anytime: bool = False
) -> Quantile:
    """A quantile with its band; several quantiles of one metric each hold at `level`, not all together.

    Args:
        values: the metric of each run, shape (n,); runs are independent.
        p: which quantile, between 0 and 1.
        level: of confidence, between 0 and 1; half of the rest on each side.
        missing: what a run counts as that gave NaN (it ran away, or never settled): worse than every other, inf. For a
            metric of which little is bad, -inf.
        anytime: whether the band must hold at every number of runs at once, for stopping on what it says.
    """
    if not 0 < p < 1:
        raise InputError("quantile", f"{p} is no share of the runs", fix="give e.g. 0.95")
    if not 0 < level < 1:
        raise InputError("quantile: level", f"{level} is no confidence", fix="give e.g. 0.95")
    x = as_column(values, "quantile")
    n = len(x)
    ordered = np.sort(np.where(np.isnan(x), missing, x))
    below, above = (ranks_anytime if anytime else ranks)(n, p, level)
    low = float(ordered[below - 1]) if below >= 1 else -math.inf
    high = float(ordered[above - 1]) if above <= n else math.inf
    value = float(ordered[max(math.ceil(n * p * (1 - 1e-14)), 1) - 1])
    not_finite = int(np.count_nonzero(~np.isfinite(x)))
    return Quantile(p, value, low, high, level, n, not_finite, least_trials(p, level, anytime=anytime))


def ranks(trials: int, p: float, level: float) -> tuple[int, int]:
    """Which order statistics (1 the smallest) hold the p-quantile between them, in `level` of all campaigns.

    0 for the first, or trials + 1 for the second, says that so few runs have no bound on that side.
    """
    tail = (1 - level) / 2
    return int(stats.binom.ppf(tail, trials, p)), int(stats.binom.isf(tail, trials, p)) + 1


def least_trials(p: float, level: float, *, anytime: bool = False) -> int:
    """How many runs it takes at least until the band has both bounds: p^n and (1 - p)^n at most (1 - level)/2."""
    tail, rare = (1 - level) / 2, max(p, 1 - p)
    return least_trials_anytime(rare, tail) if anytime else math.ceil(math.log(tail) / math.log(rare))


def as_column(values: Any, part: str) -> Any:
    """Values of runs as float64, shape (n,), at least one; refuses what is none."""
    x = np.asarray(values)
    if x.ndim != 1 or not len(x) or x.dtype.kind not in "biuf":
        problem = f"an array of shape {x.shape} and type {x.dtype} is no column of runs"
        raise InputError(part, problem, fix="give one number for each run, of at least one run")
    return x.astype(np.float64)
