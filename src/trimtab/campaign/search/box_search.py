"""What a falsifier has tried in the box of a spread: points flown, their margins, and where to start next."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import special

from trimtab.campaign.search.margin import margins
from trimtab.campaign.workers.block import fly_points
from trimtab.campaign.workers.ready import Ready

TAIL = float(special.ndtr(-3.0))
"""What is left out at each end of a distribution without bounds."""
TOGETHER = 64
"""Runs that fly at once, at least: fewer would not fill the lanes."""
APART = 0.3
"""How far apart, in the largest coordinate, two starts lie."""


def levels(ready: Ready, x: Any) -> Any:
    """Points u of the spread at points x in [0, 1]^d: tails of what has no bounds are left out."""
    tail = np.array([TAIL if f.distribution.kind in ("normal", "lognormal") else 0.0 for f in ready.spread.factors])
    return np.clip(tail + (1 - 2 * tail) * x, 2.0**-54, 1 - 2.0**-53)


class Search:
    """What has been flown; called with points (n, d) it flies them and gives what is to be small, (n,)."""

    def __init__(self, ready: Ready, words: int, over: Callable[[Any], Any], how: Mapping[str, Any]) -> None:
        self.ready, self.words, self.over, self.how = ready, words, over, how
        self.restart = -1
        self.points: list[Any] = []
        self.margins: list[Any] = []
        self.restarts: list[Any] = []
        self.firsts: list[Any] = []
        self.failed = False
        self.starts: list[Any] = []

    def __call__(self, x: Any) -> Any:
        """What is to be small at points x (n, d): all fly with the same words."""
        return self.over(self.fly(x, np.zeros(len(x), np.uint32)))

    def fly(self, x: Any, first: Any) -> Any:
        """Margins (n, words) at points x (n, d), each with so many words from its first (n,) on."""
        u = np.repeat(levels(self.ready, x), self.words, axis=0)
        words = first[:, None] + np.arange(self.words, dtype=np.uint32)
        found = margins(fly_points(self.ready, u, words.ravel(), **self.how)).reshape(words.shape)
        self.points.append(x)
        self.margins.append(found)
        self.firsts.append(first)
        self.restarts.append(np.full(len(x), self.restart))
        self.failed |= bool((found < 0).any())
        return found

    def harden(self, n: int) -> None:
        """Fly the worst candidate n times more, each time with words that are new."""
        x, m = np.concatenate(self.points), self.over(np.concatenate(self.margins))
        first = self.words * np.arange(1, n + 1, dtype=np.uint32)
        self.restart += 1
        self.fly(np.repeat(x[[np.argmin(m)]], n, axis=0), first)

    def left(self, runs: int) -> int:
        """Candidates that may still fly."""
        return runs // self.words - sum(map(len, self.points))

    def cover(self, n: int, until_first: bool) -> None:
        """Sobol points over the whole box, in parts."""
        from scipy.stats import qmc

        d = len(self.ready.spread.factors)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about balance: any number of points will do
            points = qmc.Sobol(d, rng=np.random.default_rng(self.ready.plan.seed)).random(n)
        for part in np.array_split(points, max(n * self.words // 512, 1)):
            self(part)
            if self.failed and until_first:
                return

    def start(self, restart: int) -> Any:
        """Where the next start is: the worst candidate of all that is not near an earlier start."""
        self.restart = restart
        x, m = np.concatenate(self.points), self.over(np.concatenate(self.margins))
        for i in np.argsort(m, kind="stable"):
            if all(np.abs(x[i] - s).max() > APART for s in self.starts):
                self.starts.append(x[i])
                return x[i]
        rng = np.random.default_rng(self.ready.plan.seed + len(self.starts))
        self.starts.append(rng.random(x.shape[1]))
        return self.starts[-1]
