"""The mean of a metric over many runs, with an interval that minds its skewness.

Metrics of runs are skew (a few settle very late), and for one-sided bounds Student's t is then off by the order of
1/sqrt(n). A cubic transformation takes the skewness g of the runs out, which leaves an error of the order of 1/n:

    h(w) = w + g w^2/3 + g^2 w^3/27 + g/(6 n)        w = (mean - mu)/s        sqrt(n) h(w) about as Student's t

It is monotonic and has an inverse, so that bounds follow: mu = mean - s h^-1(t/sqrt(n)).

Source: [1] Hall, "On the removal of skewness by transformation", J. R. Statist. Soc. B 54 (1992), eq. 2.6 and the
bounds after it; Student's quantiles in place of the normal ones are ours: for g = 0 it is Student's interval.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from trimtab.campaign.statistics.quantiles import as_column
from trimtab.core.errors import InputError

LEAST = 30
"""Fewer runs say too little of their skewness: then there is no interval."""


class Mean(NamedTuple):
    """The mean of the runs flown and an interval of that of all worlds; without bounds where the runs don't tell any.

    not_finite: how many runs had no finite value; one is enough to make the mean infinite.
    """

    value: float
    low: float
    high: float
    level: float
    trials: int
    not_finite: int

    def __str__(self) -> str:
        """As in "4.21 (4.05 to 4.4)"."""
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"


def mean(values: Any, level: float = 0.95) -> Mean:
    """The mean with its interval; approximate (docs/campaign/mean.md has the coverage), unlike that of a quantile.

    Runs without a finite value make it inf, without an interval. Below 30 runs, or when all gave the same value, the
    bounds are -inf and inf.

    Args:
        values: the metric of each run, shape (n,); runs are independent.
        level: of confidence, between 0 and 1; half of the rest on each side.
    """
    if not 0 < level < 1:
        raise InputError("mean: level", f"{level} is no confidence", fix="give e.g. 0.95")
    x = as_column(values, "mean")
    n, bad = len(x), int(np.count_nonzero(~np.isfinite(x)))
    if bad:
        return Mean(math.inf, -math.inf, math.inf, level, n, bad)
    centre = float(x.mean())
    deviation = float(x.std(ddof=1)) if n > 1 else 0.0
    if n < LEAST or deviation <= 1e-12 * abs(centre):
        return Mean(centre, -math.inf, math.inf, level, n, 0)
    skewness = float(np.mean(((x - centre) / x.std()) ** 3))
    t = float(stats.t.ppf((1 + level) / 2, n - 1)) / math.sqrt(n)
    low, high = (centre - deviation * _invert_skewness(y, skewness, n) for y in (t, -t))
    return Mean(centre, low, high, level, n, 0)


def _invert_skewness(y: float, skewness: float, n: int) -> float:
    if abs(skewness) < 1e-6:
        return y
    return 3 / skewness * float(np.cbrt(1 + skewness * (y - skewness / (6 * n))) - 1)
