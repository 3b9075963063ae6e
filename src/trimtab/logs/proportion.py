"""How often something succeeds, and how well so many trials tell it.

Source: [7] Clopper, Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
Biometrika 26 (1934); the bounds as quantiles of a beta distribution: [8] Johnson, Kemp, Kotz, "Univariate discrete
distributions", Wiley 2005, section 3.8.3.
"""

from typing import NamedTuple

from scipy import special

from trimtab.core.errors import InputError


class Proportion(NamedTuple):
    """A share of successes. low, high: its exact interval; the true probability lies within in `level` of all cases."""

    successes: int
    trials: int
    share: float
    low: float
    high: float
    level: float

    def __str__(self) -> str:
        """In per cent, as in "97.3 % (96.1 to 98.2)"."""
        return f"{100 * self.share:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


def proportion(successes: int, trials: int, level: float = 0.95) -> Proportion:
    """The share of successes among independent trials, with the interval of Clopper and Pearson.

        low:  P(X >= k | low) = (1 - level)/2          high: P(X <= k | high) = (1 - level)/2          X ~ Bin(n, p)

    It never promises too much: it holds the truth at least as often as `level` says, for any probability and any number
    of trials, also when all trials succeed.

    Args:
        successes: k, how many succeeded.
        trials: n, how many there were, at least one.
        level: of confidence, between 0 and 1.
    """
    k, n = int(successes), int(trials)
    if n < 1 or not 0 <= k <= n or (k, n) != (successes, trials):
        problem = f"{successes} of {trials} is no count of successes"
        raise InputError("proportion", problem, fix="give whole numbers, 0 <= successes <= trials, trials at least 1")
    if not 0 < level < 1:
        raise InputError("proportion: level", f"{level} is no confidence", fix="give e.g. 0.95")
    tail = (1 - level) / 2
    low = float(special.betaincinv(k, n - k + 1, tail)) if k > 0 else 0.0
    high = float(special.betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
    return Proportion(k, n, k / n, low, high, level)
