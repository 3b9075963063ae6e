"""Comparison of two control laws on the same runs, by the paired t interval of the cost difference."""

from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trimtab.analysis.campaign.statistics.intervals import proportion


class Comparison(NamedTuple):
    """Comparison of two control laws, before and after a change, on the same runs.

    runs: number of runs of each law.  before, after: mean costs.  difference: after - before.  low, high: confidence
    bounds of the difference; NaN if a cost is infinite.  better, worse: number of runs with a lower and with a higher
    cost after the change.  level: confidence.  improves: True if the law after the change is significantly better.
    """

    runs: int
    before: float
    after: float
    difference: float
    low: float
    high: float
    better: int
    worse: int
    level: float
    improves: bool


def compare(before: Any, after: Any, level: float = 0.95) -> Comparison:
    """Compare the costs (n,) of the same n runs before and after a change. n must be at least 2."""
    n = len(before)
    better, worse = int((after < before).sum()), int((after > before).sum())
    if np.isfinite(before).all() and np.isfinite(after).all():
        d = after - before
        half = float(special.stdtrit(n - 1, (1 + level) / 2) * d.std(ddof=1) / np.sqrt(n))
        middle = float(d.mean())
        low, high = middle - half, middle + half
        improves = high < 0
    else:
        middle = low = high = float("nan")
        improves = better + worse > 0 and proportion(better, better + worse, level).low > 0.5
    return Comparison(
        n, float(np.mean(before)), float(np.mean(after)), middle, low, high, better, worse, level, bool(improves)
    )
