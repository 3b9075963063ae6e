"""Probability of a rare failure, estimated by generalised splitting over parameters and noise.

A run is a point (z, w). The standard normal numbers z (d,) determine the parameters of the run. Each of the words w
(m,), random keys, is the seed of one part of the noise. The margin g(z, w) is below 0 if the run fails. Levels g1 > g2
> … > gK = 0 approach the failure step by step:

    P(g < 0) = P(g < g1) P(g < g2 | g < g1) … P(g < 0 | g < g(K-1))

**Pilot.** A subset simulation. The next level is the margin below which a share 1/SPLIT of `size` points lies. Each of
these points starts a Markov chain of SPLIT points below the new level. All chains together are the points for the next
level. The pilot determines the levels and the step sizes, which are fixed afterwards.

**Splitting.** Roots are points drawn independently. A point below level k starts a Markov chain of SPLIT points,
including itself, that all stay below this level. The chain's kernel preserves the distribution below the level. A root
with c failing descendants gives the estimate

    c / SPLIT^(K - 1)

of the failure probability. The mean of this estimate is exactly P(g < 0), because levels, chain lengths and kernels do
not depend on these roots. The estimates of the roots are independent and unbiased. The confidence interval is computed
from the means of batches of roots.

**Kernel** (one step of a chain). Parameters make a preconditioned Crank-Nicolson step, z' = sqrt(1 - s^2) z + s xi with
xi standard normal. Each word is drawn again with probability q, which resamples one part of the noise and leaves the
others unchanged. Half of the steps change parameters and noise, a quarter only parameters, a quarter only noise. A step
to a point above the level is rejected. Both kinds of change preserve the unconditional distribution, whatever that of
the noise is.

Source: Botev, Kroese, "Efficient Monte Carlo simulation via the generalized splitting method", Statistics and Computing
22 (2012), algorithm 2.1 and its unbiasedness, pilot by their algorithm 4.1; Au, Beck, "Estimation of small failure
probabilities in high dimensions by subset simulation", Probabilistic Engineering Mechanics 16 (2001), levels;
Papaioannou, Betz, Zwirglmaier, Straub, "MCMC algorithms for subset simulation", Probabilistic Engineering Mechanics 41
(2015), the step in normal space and its adaptation.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.statistics.intervals import Mean, mean

SPLIT = 10
"""Number of points in a Markov chain. A share 1/SPLIT of the pilot's points lies below the next level."""
MOST_LEVELS = 40
ACCEPTANCE = 0.44
"""Target for the share of accepted steps. The pilot adapts the step sizes until the target is reached."""
CORRELATION = 3.0
"""Factor by which correlation in chains increases the variance, observed for linear margins in 1 to 32 dimensions."""
BOTH, PARAMETERS, NOISE = range(3)
Margins = Callable[[Any, Any], Any]
"""Function that computes the margins (n,) of n runs from normal numbers z (n, d) and noise seeds (n, m), uint32."""


class ChainStates(NamedTuple):
    """States of n Markov chains.

    z: standard normal numbers of the parameters (n, d).  words: seeds of the noise (n, m), uint32.  margin: margins
    (n,).
    root: index of the root from which each state descends (n,).
    """

    z: Any
    words: Any
    margin: Any
    root: Any

    def __getitem__(self, which: Any) -> "ChainStates":  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the states with these indices."""
        return ChainStates(self.z[which], self.words[which], self.margin[which], self.root[which])


class Ladder(NamedTuple):
    """Result of the pilot. levels: decreasing margins (K,), of which the last is 0.

    steps: step size s of each parameter below each level (K - 1, d).  refresh: probability q of drawing a noise
    seed again below each level (K - 1,).  estimate: failure probability from the pilot alone, which is biased.  flown:
    number of pilot runs.
    """

    levels: Any
    steps: Any
    refresh: Any
    estimate: float
    flown: int

    @property
    def roots_cost(self) -> float:
        """Return the expected number of runs for one root and the chains that descend from it."""
        return 1 + (len(self.levels) - 1) * (SPLIT - 1) / SPLIT


class Stalled(Exception):
    """Error if the pilot makes no progress. level: margin at which the pilot's points stay.

    flown: number of runs flown.
    """

    def __init__(self, level: float, flown: int) -> None:
        super().__init__(f"the margins stay at {level:.6g}")
        self.level, self.flown = level, flown


def _draw_words(rng: np.random.Generator, shape: tuple[int, ...]) -> Any:
    return rng.integers(0, 2**32, shape, dtype=np.uint32)


def draw_roots(margins: Margins, rng: np.random.Generator, n: int, d: int, m: int) -> ChainStates:
    """Draw n independent points with d parameters and m noise seeds, and compute their margins."""
    z, words = rng.standard_normal((n, d)), _draw_words(rng, (n, m))
    return ChainStates(z, words, margins(z, words), np.arange(n))


def take_step(
    margins: Margins, rng: np.random.Generator, at: ChainStates, level: float, steps: Any, refresh: float
) -> tuple[ChainStates, Any, Any]:
    """Make one step of each chain. Steps to points above the level are rejected.

    Return the new states, the kind of each step, and True for each accepted step.
    """
    (n, d), m = at.z.shape, at.words.shape[1]
    kinds = rng.choice(3, n, p=[0.5, 0.25, 0.25]) if d and m else np.full(n, PARAMETERS if d else NOISE)
    s = np.where((kinds != NOISE)[:, None], steps, 0.0)
    z = np.sqrt(1 - s * s) * at.z + s * rng.standard_normal((n, d))
    fresh = rng.random((n, m)) < refresh
    if m:
        fresh[np.arange(n), rng.integers(0, m, n)] = True
    fresh &= (kinds != PARAMETERS)[:, None]
    words = np.where(fresh, _draw_words(rng, (n, m)), at.words)
    margin = margins(z, words)
    taken = margin < level
    moved = ChainStates(
        z=np.where(taken[:, None], z, at.z),
        words=np.where(taken[:, None], words, at.words),
        margin=np.where(taken, margin, at.margin),
        root=at.root,
    )
    return moved, kinds, taken


def _join(parts: list[ChainStates]) -> ChainStates:
    return ChainStates(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


class _Pace:
    """Step sizes of the kernel, adapted until the share of accepted steps is ACCEPTANCE.

    s: step size of a parameter, in standard deviations.  q: probability of drawing a noise seed again.
    """

    def __init__(self) -> None:
        self.s, self.q = 0.6, 0.3

    def adapt(self, kinds: Any, taken: Any, times: int) -> None:
        """Adapt the step sizes after step number `times` of a level.

        They grow if the share of accepted steps is above ACCEPTANCE.
        """
        for kind in (PARAMETERS, NOISE):
            if (kinds == kind).any():
                change = math.exp(2 * (float(taken[kinds == kind].mean()) - ACCEPTANCE) / math.sqrt(times))
                if kind == PARAMETERS:
                    self.s = min(max(self.s * change, 1e-3), 5.0)
                else:
                    self.q = min(max(self.q * change, 1e-3), 1.0)


def set_ladder(margins: Margins, rng: np.random.Generator, size: int, d: int, m: int) -> Ladder:
    """Run the pilot with `size` points for each level. Return levels and step sizes. Raises: Stalled."""
    points, pace = draw_roots(margins, rng, size, d, m), _Pace()
    levels: list[float] = []
    steps: list[Any] = []
    refresh: list[float] = []
    estimate, flown = 1.0, size
    while True:
        level = float(np.partition(points.margin, len(points.margin) // SPLIT)[len(points.margin) // SPLIT])
        below = points.margin < max(level, 0.0)
        stuck = bool(levels) and level >= levels[-1]
        if level > 0 and (stuck or below.mean() < 0.2 / SPLIT or len(levels) == MOST_LEVELS):
            raise Stalled(level, flown)
        estimate *= float(below.mean())
        levels.append(max(level, 0.0))
        if level <= 0:
            return Ladder(np.array(levels), np.reshape(steps, (len(steps), d)), np.array(refresh), estimate, flown)
        chains = points[below]
        spread, parts = np.minimum(chains.z.std(axis=0), 1.0), [chains]
        for times in range(1, SPLIT):
            chains, kinds, taken = take_step(margins, rng, chains, level, np.minimum(pace.s * spread, 1.0), pace.q)
            pace.adapt(kinds, taken, times)
            parts.append(chains)
            flown += len(taken)
        steps.append(np.minimum(pace.s * spread, 1.0))
        refresh.append(pace.q)
        points = _join(parts)


class Descent(NamedTuple):
    """Result of splitting n roots. counts: number of failing descendants of each root (n,).

    survivors: number of points below each level (K,).  taken: share of accepted steps below each level (K - 1,).
    failures: points that fail.  flown: number of runs.
    """

    counts: Any
    survivors: Any
    taken: Any
    failures: ChainStates
    flown: int


def descend(margins: Margins, rng: np.random.Generator, ladder: Ladder, n: int, d: int, m: int) -> Descent:
    """Fly n roots, and start chains from the points below each level of a ladder, the fixed result of the pilot."""
    points, flown = draw_roots(margins, rng, n, d, m), n
    survivors, accepted = np.zeros(len(ladder.levels), np.int64), np.zeros(len(ladder.levels) - 1)
    for k, level in enumerate(ladder.levels):
        chains = points[points.margin < level]
        points = chains
        survivors[k] = len(chains.root)
        if not survivors[k] or k == len(ladder.levels) - 1:
            break
        parts = [chains]
        for _ in range(1, SPLIT):
            chains, _kinds, taken = take_step(margins, rng, chains, level, ladder.steps[k], ladder.refresh[k])
            accepted[k] += taken.mean() / (SPLIT - 1)
            parts.append(chains)
            flown += len(taken)
        points = _join(parts)
    return Descent(np.bincount(points.root, minlength=n), survivors, accepted, points, flown)


def probability(sums: Any, roots: int, ladder: Ladder, level: float = 0.95) -> Mean:
    """Return the failure probability and its confidence interval.

    sums: number of failing descendants in each batch. roots: number of roots in a batch.
    """
    found = mean(np.asarray(sums, np.float64) / roots / float(SPLIT) ** (len(ladder.levels) - 1), level)
    return found._replace(low=max(found.low, 0.0))


def expected_width(ladder: Ladder, roots: int) -> float:
    """Return the approximate half-width of the interval for a number of roots, as a fraction of the probability.

    The relative variance of the share p of points below a level is assumed to be CORRELATION (1 - p)/(p n).
    """
    own = (SPLIT - 1) * CORRELATION * (len(ladder.levels) - 1)
    return 2 * math.sqrt((own + SPLIT - 1) / roots)
