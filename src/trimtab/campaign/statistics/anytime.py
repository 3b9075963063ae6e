"""Intervals of a probability and of a quantile that hold at every number of runs at once.

An interval made for a fixed number of runs holds the truth less often when one looks again and again and stops on what
one sees. These hold it at all numbers of runs together in `level` of all campaigns: stop when you like, for any reason,
go on later, look after every block.

With k successes in n runs, the evidence that the probability is above p, as a martingale under p (so that Ville's
inequality bounds how often it ever reaches 1/tail), with theta spread uniformly over what is above p:

    M(k, n, p) = 1/(1 - p) * integral over theta from p to 1 of (theta/p)^k ((1 - theta)/(1 - p))^(n - k)
               = B(k + 1, n - k + 1) (1 - I_p(k + 1, n - k + 1)) / ((1 - p) p^k (1 - p)^(n - k))

The lower bound is the p at which M = 1/tail; the upper one follows with successes and failures exchanged. Bounds of a
quantile are order statistics: how many values lie below the quantile is such a count, with a known p.

Source: [1] Ville, "Etude critique de la notion de collectif", 1939; [2] Robbins, "Statistical methods related to the
law of the iterated logarithm", Ann. Math. Statist. 41 (1970), for mixtures; [3] Howard, Ramdas, "Sequential estimation
of quantiles", Bernoulli 28 (2022), for the way from counts to quantiles.
"""

from bisect import bisect_left
from typing import Any

import numpy as np
from scipy import special

HALVINGS = 60
"""Steps of the bisection: bounds are exact to 2^-60."""
MOST = 1 << 62
"""Where the search for a number of runs ends."""


def log_evidence(k: Any, n: Any, p: Any) -> Any:
    """The logarithm of M(k, n, p): how strongly k of n say that the probability is above p; arrays of any shape."""
    k, n, p = (np.asarray(a, np.float64) for a in (k, n, p))
    with np.errstate(divide="ignore"):
        mass = special.betaln(k + 1, n - k + 1) + np.log(special.betaincc(k + 1, n - k + 1, p))
    return mass - np.log1p(-p) - special.xlogy(k, p) - special.xlog1py(n - k, -p)


def lower_bound(k: Any, n: Any, tail: float) -> Any:
    """Below it the truth ever lies in at most `tail` of all campaigns; k of n succeeded, arrays of any shape."""
    k, n = np.broadcast_arrays(np.asarray(k, np.float64), np.asarray(n, np.float64))
    low, high = np.zeros(k.shape), k / n
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        with np.errstate(invalid="ignore", divide="ignore"):
            ruled_out = log_evidence(k, n, middle) >= -np.log(tail)
        low, high = np.where(ruled_out, middle, low), np.where(ruled_out, high, middle)
    return low


def ranks_anytime(trials: int, p: float, level: float) -> tuple[int, int]:
    """Which order statistics (1 the smallest) hold the p-quantile between them at every number of runs at once.

    0 for the first, or trials + 1 for the second, says that so few runs have no bound on that side.
    """
    enough = -np.log((1 - level) / 2)
    counts = range(trials + 1)
    low = bisect_left(counts, True, key=lambda k: bool(log_evidence(trials - k, trials, 1 - p) < enough))
    high = bisect_left(counts, True, key=lambda k: bool(log_evidence(k, trials, p) >= enough))
    return low, high


def least_trials_anytime(p: float, tail: float) -> int:
    """How many runs, all good, it takes at least until the lower bound of their probability reaches p."""
    enough = -np.log(tail)
    return bisect_left(range(MOST), True, lo=1, key=lambda n: bool(log_evidence(n, n, p) >= enough))
