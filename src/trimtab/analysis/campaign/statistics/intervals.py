"""Confidence intervals of a probability, a quantile and a mean, estimated from independent runs.

**Probability**: Clopper and Pearson's interval, whose bounds are quantiles of a beta distribution,

    low:  P(X >= k | low) = (1 - level)/2          high: P(X <= k | high) = (1 - level)/2          X ~ Bin(n, p)

**Quantile**: the number of values, out of n, below the p-quantile is binomial, so that order statistics bound it,

    P(X(l) > q_p) <= P(B <= l - 1) <= tail        P(X(u) < q_p) <= P(B >= u) <= tail        B ~ Bin(n, p)

with X(1) <= ... <= X(n). The largest such l and the smallest such u are used. The bounds hold for any distribution,
also one with steps.

**Mean**: metrics of runs are skew (a few settle very late). One-sided bounds by Student's t are then wrong by the order
of 1/sqrt(n). A cubic transformation removes the runs' skewness g, which leaves an error of the order of 1/n:

    h(w) = w + g w^2/3 + g^2 w^3/27 + g/(6 n)        w = (mean - mu)/s        sqrt(n) h(w): roughly Student's t

h is monotonic. Its inverse yields the bounds mu = mean - s h^-1(t/sqrt(n)).

**Anytime**: an interval for a fixed number of runs contains the true value less often if a campaign stops as soon as
the interval looks good. With `anytime`, the intervals of a probability and of a quantile are valid at all numbers of
runs
together: in a share `level` of all campaigns, no interval misses the true value. You may then stop for any reason,
resume later, and look at the interval after every block of runs.

The evidence M that the success probability is above p, from k successes in n runs, is a martingale if the probability
is p. Ville's inequality therefore bounds how often M ever reaches 1/tail. With theta uniform on [p, 1]:

    M(k, n, p) = 1/(1 - p) * integral over theta from p to 1 of (theta/p)^k ((1 - theta)/(1 - p))^(n - k)
               = B(k + 1, n - k + 1) (1 - I_p(k + 1, n - k + 1)) / ((1 - p) p^k (1 - p)^(n - k))

The lower bound is the p at which M = 1/tail. The upper bound follows with successes and failures exchanged. Bounds of a
quantile are order statistics: the number of values below the quantile is a number of successes, with a known p.

Source: [1] Clopper, Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
Biometrika 26 (1934); beta quantiles: [2] Johnson, Kemp, Kotz, "Univariate discrete distributions", Wiley 2005, section
3.8.3; [3] Thompson, "On confidence ranges for the median and other expectation distributions", Ann. Math. Statist. 7
(1936); [4] David, Nagaraja, "Order Statistics", 3rd ed., Wiley 2003, section 7.1; the quantile itself is the inverse of
the empirical distribution, definition 1 of [5] Hyndman, Fan, "Sample quantiles", American Statistician 50 (1996);
[6] Hall, "On the removal of skewness by transformation", J. R. Statist. Soc. B 54 (1992), eq. 2.6 and the bounds after
it; Student's quantiles replace the normal ones here: for g = 0 it is Student's interval;
[7] Ville, "Etude critique de la notion de collectif", 1939; [8] Robbins, "Statistical methods related to the
law of the iterated logarithm", Ann. Math. Statist. 41 (1970), for mixtures; [9] Howard, Ramdas, "Sequential estimation
of quantiles", Bernoulli 28 (2022), for the way from counts to quantiles.
"""

import math
from bisect import bisect_left
from typing import Any, NamedTuple

import numpy as np
from scipy import special, stats

from trimtab.core.errors import InputError

HALVINGS = 60
"""Number of bisection steps in the search for a confidence bound, which is then exact to 2^-60."""
RUNS_MAX = 1 << 62
"""Upper limit in the search for the minimum number of runs."""
LEAST_FOR_MEAN = 30
"""Minimum number of runs for an interval of the mean. The skewness cannot be estimated from fewer runs."""


def check_level(part: str, level: float) -> None:
    """Raise InputError unless the confidence is between 0 and 1."""
    if not 0 < level < 1:
        raise InputError(f"{part}: level", f"the confidence must be between 0 and 1, got {level}", fix="give e.g. 0.95")


class Proportion(NamedTuple):
    """Share of successful runs, with a confidence interval of the success probability.

    low, high: ends of the interval, which contains the true probability with a confidence of at least `level`.
    """

    successes: int
    trials: int
    share: float
    low: float
    high: float
    level: float

    def __str__(self) -> str:
        """Return the share in per cent, as in "97.3 % (96.1 to 98.2)"."""
        return f"{100 * self.share:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


def proportion(successes: int, trials: int, level: float = 0.95, *, anytime: bool = False) -> Proportion:
    """Return the share of successes among independent trials, with the interval of Clopper and Pearson.

    The interval is conservative: its confidence is at least `level` for any probability and any number of trials, also
    if all trials succeed.

    Args:
        successes: k, number of successes.
        trials: n, number of trials, at least one.
        level: confidence, between 0 and 1. The probabilities of the two tails are equal.
        anytime: True if the intervals must be valid at all numbers of runs together, for a campaign that may stop
            because of them. The trials must then be runs 0 to n - 1, in order, without gaps.
    """
    k, n = int(successes), int(trials)
    if n < 1 or not 0 <= k <= n or (k, n) != (successes, trials):
        problem = f"{successes} successes in {trials} trials are not possible"
        raise InputError("proportion", problem, fix="pass whole numbers with 0 <= successes <= trials and trials >= 1")
    check_level("proportion", level)
    tail = (1 - level) / 2
    if anytime:
        low, high = float(lower_bound(k, n, tail)), 1.0 - float(lower_bound(n - k, n, tail))
    else:
        low = float(special.betaincinv(k, n - k + 1, tail)) if k > 0 else 0.0
        high = float(special.betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
    return Proportion(k, n, k / n, low, high, level)


class Quantile(NamedTuple):
    """Quantile of a metric over the runs flown, with a confidence band for the true quantile.

    p: level of the quantile.  value: smallest value that at least a share p of the runs do not exceed.  low, high:
    bounds of the band; -inf or inf if the runs are too few for this bound.  level: confidence of the band.
    trials: number of runs.  not_finite: number of runs without a finite value.  needed_runs: minimum number of runs for
    a band with both bounds.
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
        """Return the name of the quantile, as in "p95"."""
        return f"p{100 * self.p:.10g}"

    def __str__(self) -> str:
        """Return the quantile and the confidence band as text, as in "p95 8.31 (8.02 to 8.77)"."""
        few = "" if self.trials >= self.needed_runs else f"; both bounds need {self.needed_runs} runs"
        return f"{self.name} {self.value:.4g} ({self.low:.4g} to {self.high:.4g}{few})"


def quantile(
    values: Any, p: float, level: float = 0.95, *, missing: float = math.inf, anytime: bool = False
) -> Quantile:
    """Return a quantile of a metric with a confidence band.

    The confidence `level` applies to each band alone, not to the bands of several quantiles together.

    Args:
        values: the metric of each run, shape (n,); runs are independent.
        p: level of the quantile, between 0 and 1.
        level: confidence, between 0 and 1. The probabilities of the two tails are equal.
        missing: value for a run whose metric is NaN (the run diverged, or the signal never settled). Use inf if large
            values of the metric are bad, -inf if small values are bad.
        anytime: True if the bands must be valid at all numbers of runs together, for a campaign that may stop because
            of them.
    """
    if not 0 < p < 1:
        raise InputError("quantile", f"p must be between 0 and 1, got {p}", fix="give e.g. 0.95")
    check_level("quantile", level)
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
    """Return the ranks of two run values that bound the p-quantile with confidence `level`. Rank 1: smallest value.

    A lower rank of 0, or an upper rank of trials + 1, means that the runs are too few for this bound.
    """
    tail = (1 - level) / 2
    return int(stats.binom.ppf(tail, trials, p)), int(stats.binom.isf(tail, trials, p)) + 1


def ranks_anytime(trials: int, p: float, level: float) -> tuple[int, int]:
    """Return ranks as `ranks` does, but for bounds that are valid at all numbers of runs together."""
    enough = -np.log((1 - level) / 2)
    counts = range(trials + 1)
    low = bisect_left(counts, True, key=lambda k: bool(log_evidence(trials - k, trials, 1 - p) < enough))
    high = bisect_left(counts, True, key=lambda k: bool(log_evidence(k, trials, p) >= enough))
    return low, high


def least_trials(p: float, level: float, *, anytime: bool = False) -> int:
    """Return the minimum number of runs n for a band with both bounds: p^n and (1 - p)^n at most (1 - level)/2."""
    tail, rare = (1 - level) / 2, max(p, 1 - p)
    return least_trials_anytime(rare, tail) if anytime else math.ceil(math.log(tail) / math.log(rare))


def least_trials_anytime(p: float, tail: float) -> int:
    """Return the minimum number of successful runs for which the lower bound of the probability reaches p."""
    enough = -np.log(tail)
    return bisect_left(range(RUNS_MAX), True, lo=1, key=lambda n: bool(log_evidence(n, n, p) >= enough))


def log_evidence(k: Any, n: Any, p: Any) -> Any:
    """Return the logarithm of M(k, n, p), the evidence that the probability is above p, for arrays of any shape."""
    k, n, p = (np.asarray(a, np.float64) for a in (k, n, p))
    with np.errstate(divide="ignore"):
        mass = special.betaln(k + 1, n - k + 1) + np.log(special.betaincc(k + 1, n - k + 1, p))
    return mass - np.log1p(-p) - special.xlogy(k, p) - special.xlog1py(n - k, -p)


def lower_bound(k: Any, n: Any, tail: float) -> Any:
    """Return a lower bound of the success probability for k successes in n runs. k and n: arrays of any shape.

    The bounds are valid at all numbers of runs n together, except in a share `tail` of all campaigns.
    """
    k, n = np.broadcast_arrays(np.asarray(k, np.float64), np.asarray(n, np.float64))
    low, high = np.zeros(k.shape), k / n
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        with np.errstate(invalid="ignore", divide="ignore"):
            ruled_out = log_evidence(k, n, middle) >= -np.log(tail)
        low, high = np.where(ruled_out, middle, low), np.where(ruled_out, high, middle)
    return low


def as_column(values: Any, part: str) -> Any:
    """Convert the values of n runs to float64, shape (n,). Raise InputError unless each run has exactly one number."""
    x = np.asarray(values)
    if x.ndim != 1 or not len(x) or x.dtype.kind not in "biuf":
        problem = f"got an array of shape {x.shape} and type {x.dtype}"
        raise InputError(part, problem, fix="pass one number for each run, and at least one run")
    return x.astype(np.float64)


class Mean(NamedTuple):
    """Mean of a metric over the runs flown, with a confidence interval for the true mean.

    low, high: bounds of the interval; infinite if the bounds cannot be computed from these runs.
    not_finite: number of runs without a finite value. A single run of this kind makes the mean infinite.
    """

    value: float
    low: float
    high: float
    level: float
    trials: int
    not_finite: int

    def __str__(self) -> str:
        """Return the mean and the confidence interval as text, as in "4.21 (4.05 to 4.4)"."""
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"


def mean(values: Any, level: float = 0.95) -> Mean:
    """Return the mean with an approximate interval. Its coverage is measured in docs/campaign/intervals.md.

    If a run has no finite value, the mean is infinite, and the bounds are -inf and inf. The bounds are also -inf and
    inf with fewer than 30 runs, or if all values are equal.

    Args:
        values: the metric of each run, shape (n,); runs are independent.
        level: confidence, between 0 and 1. The probabilities of the two tails are equal.
    """
    check_level("mean", level)
    x = as_column(values, "mean")
    n, bad = len(x), int(np.count_nonzero(~np.isfinite(x)))
    if bad:
        return Mean(math.inf, -math.inf, math.inf, level, n, bad)
    centre = float(x.mean())
    deviation = float(x.std(ddof=1)) if n > 1 else 0.0
    if n < LEAST_FOR_MEAN or deviation <= 1e-12 * abs(centre):
        return Mean(centre, -math.inf, math.inf, level, n, 0)
    skewness = float(np.mean(((x - centre) / x.std()) ** 3))
    t = float(stats.t.ppf((1 + level) / 2, n - 1)) / math.sqrt(n)
    low, high = (centre - deviation * _invert_skewness(y, skewness, n) for y in (t, -t))
    return Mean(centre, low, high, level, n, 0)


def _invert_skewness(y: float, skewness: float, n: int) -> float:
    if abs(skewness) < 1e-6:
        return y
    return 3 / skewness * float(np.cbrt(1 + skewness * (y - skewness / (6 * n))) - 1)
