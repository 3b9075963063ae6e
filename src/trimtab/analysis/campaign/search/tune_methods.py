"""Methods of tuning: CMA-ES, which needs no derivatives, and gradient descent with derivatives of the simulated loop.

**Search**: CMA-ES minimises the mean cost of many runs, which are the same for every candidate. A candidate with fewer
runs of infinite cost is always better, see `merit`.

**Gradient**, smoothed over switches: the cost is averaged over nearby gains and over runs.

    f_s(x) = E over eps ~ N(0, I) and runs of f(fold(x + s eps))           smooth, even if the loop switches

In a loop that switches, the cost may jump as a gain changes. The derivative of a single run ignores the jump. The mean
f_s has no jump. Each pair x ± s eps, flown with the same random numbers, gives two estimates of the slope:

    first order    (g+ + g-)/2            mean of the runs' own derivatives: little scatter, ignores jumps
    zeroth order   (f+ - f-) eps/(2 s)    a difference: includes jumps, no bias, more scatter

    g = g0 + a (g1 - g0)      a = -cov(g0, D)/(var(D) + b^2) in [0, 1],   D = g1 - g0,  b^2 = (mean(D)^2 - var(D))+

where g0 and g1 are the means of the zeroth-order and the first-order estimates, and var and cov are those of means.
The weight a gives the least estimated mean square error. If both estimates agree within their scatter, the first-order
estimate dominates, otherwise the zeroth-order estimate. Steps are those of Adam, limited to the ranges. The result is
the mean of the last third of the steps (Polyak). Gains beyond their range are folded back, so that f stays continuous.

Source: Hansen, Ostermeier, Evolutionary Computation 9 (2001); common random numbers: Law, "Simulation modeling and
analysis", 5th ed. 2015, section 11.2; Suh, Simchowitz, Zhang, Tedrake, "Do differentiable simulators give better policy
gradients?", ICML 2022; Green, Strawderman, "A James-Stein type estimator for combining unbiased and possibly biased
estimators", Journal of the ASA 86 (1991), for the weight; Nesterov, Spokoiny, Foundations of Computational Mathematics
17 (2017), for f_s; Kingma, Ba, ICLR 2015 (Adam); Polyak, Juditsky, SIAM Journal on Control and Optimization 30 (1992).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.search.evolution import evolve
from trimtab.core.errors import InputError, argument, argument_name

STEP, POPULATION = 0.25, 8
"""Initial standard deviation of CMA-ES, as a fraction of the ranges, and minimum population of CMA-ES."""
RATE, BETA1, BETA2 = 0.06, 0.8, 0.95
"""Parameters of Adam: learning rate and decay rates."""
PairFlights = Callable[[Any, int], tuple[Any, Any]]
"""Function that flies pairs of runs.

It maps scaled gains (n, d) and the first run number to costs (n,) and slopes (n, d).
"""


class TuningStep(NamedTuple):
    """One step of a tuning method.

    flown_runs: number of runs up to this step.  cost: mean cost of the step's runs.  x: (d,), gains, scaled to [0, 1].
    """

    flown_runs: int
    cost: float
    x: Any


def merit(costs: Any, reference: float) -> Any:
    """Return a score (n,) of candidates from their costs (n, runs). A lower score is better.

    A candidate with fewer infinite costs is always better. Among candidates with equally many infinite costs, the lower
    mean of the finite costs is better. The score is twice the number of infinite costs plus z/(1 + |z|), which is
    between -1 and 1. Here z is the mean finite cost divided by the reference.
    """
    finite = np.isfinite(costs)
    z = np.where(finite, costs, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1) / max(abs(reference), 1e-12)
    return 2 * np.sum(~finite, axis=1) + np.where(finite.any(axis=1), z / (1 + np.abs(z)), 1.0)


def search_gains(
    costs: Callable[[Any], Any], start: Any, runs: int, iterations: int, seed: int
) -> tuple[Any, list[TuningStep]]:
    """Search for the best gains by CMA-ES. Return the best gains (d,), scaled to [0, 1], and the steps of the search.

    Args:
        costs: function from scaled gains (n, d) to costs (n, runs) in the same runs.
        start: (d,), the scenario's own gains, scaled to [0, 1].
        runs: number of runs of a candidate.
        iterations: number of generations with the minimum population. Larger generations count as several.
        seed: seed of the search.
    """
    first = costs(start[None])
    finite = first[np.isfinite(first)]
    reference = float(finite.mean()) if finite.size else 1.0
    best, least = start, float(merit(first, reference)[0])
    steps, flown = [TuningStep(runs, float(first.mean()), start)], runs
    rng = np.random.default_rng(seed)

    def begin(restart: int) -> Any:
        return start if restart == 0 else rng.random(len(start))

    latest = first

    def merit_at(x: Any) -> Any:
        nonlocal latest
        latest = costs(x)
        return merit(latest, reference)

    budget, last = iterations * POPULATION, None
    for generation in evolve(merit_at, begin, step=STEP, population=POPULATION, budget=budget, seed=seed):
        flown += generation.f.size * runs
        i = int(np.argmin(generation.f))
        if generation.f[i] < least:
            best, least = generation.x[i], float(generation.f[i])
        steps.append(TuningStep(flown, float(latest[i].mean()), generation.x[i]))
        last = generation
    if last is not None:
        centre = costs(last.mean[None])
        flown += runs
        if float(merit(centre, reference)[0]) <= least:
            best = last.mean
            steps.append(TuningStep(flown, float(centre.mean()), best))
    return best, steps


class Slope(NamedTuple):
    """Slope (d,) of the cost. weight: weight (d,) of the first-order estimate.

    first, zeroth: first-order and zeroth-order estimates (d,) of the slope.
    """

    slope: Any
    weight: Any
    first: Any
    zeroth: Any


def fold_points(y: Any) -> tuple[Any, Any]:
    """Fold any numbers into [0, 1] by reflection at 0 and 1. Return the folded numbers and the slopes (1, -1)."""
    z = np.mod(y, 2.0)
    return np.where(z > 1, 2 - z, z), np.where(z > 1, -1.0, 1.0)


def combine_estimates(first: Any, zeroth: Any) -> Slope:
    """Combine samples (pairs, d) of the first-order and the zeroth-order estimate into one slope.

    The weights minimise the estimated mean square error.
    """
    n = len(first)
    difference = first - zeroth
    mean, spread = difference.mean(axis=0), difference.var(axis=0, ddof=1) / n
    shared = np.mean((zeroth - zeroth.mean(axis=0)) * (difference - mean), axis=0) / (n - 1)
    bias = np.maximum(mean**2 - spread, 0.0)
    weight = np.clip(-shared / np.maximum(spread + bias, 1e-300), 0.0, 1.0)
    return Slope(zeroth.mean(axis=0) + weight * mean, weight, first.mean(axis=0), zeroth.mean(axis=0))


def estimate_slope(flights: PairFlights, x: Any, eps: Any, width: float, first_run: int) -> tuple[float, Slope]:
    """Estimate mean cost and slope at scaled gains x (d,) from pairs of runs at x ± width eps.

    eps: (pairs, d), standard normal numbers.  first_run: number of the first run.
    """
    high, s_high = fold_points(x + width * eps)
    low, s_low = fold_points(x - width * eps)
    costs, slopes = flights(np.stack([high, low], axis=1).reshape(-1, len(x)), first_run)
    f, g = costs.reshape(-1, 2), slopes.reshape(-1, 2, len(x))
    if not (np.isfinite(f).all() and np.isfinite(g).all()):
        return np.inf, Slope(*[np.full(len(x), np.nan)] * 4)
    first = (s_high * g[:, 0] + s_low * g[:, 1]) / 2
    zeroth = (f[:, :1] - f[:, 1:]) * eps / (2 * width)
    return float(f.mean()), combine_estimates(first, zeroth)


def descend_gradient(
    flights: PairFlights, start: Any, runs: int, iterations: int, width: float, seed: int
) -> tuple[Any, list[TuningStep], list[Slope]]:
    """Minimise the cost by gradient descent. Return scaled gains (d,), steps, slopes. Every iteration flies new runs.

    Args:
        flights: function that flies pairs of runs, see `PairFlights`.
        start: (d,), the scenario's own gains, scaled to [0, 1].
        runs: number of runs in an iteration, i.e. runs/2 pairs.
        iterations: number of steps.
        width: width s over which the cost is smoothed, as a fraction of the ranges.
        seed: seed of the random differences eps.
    """
    rng, pairs = np.random.default_rng(seed), runs // 2
    x, m, v, rate = np.array(start), np.zeros(len(start)), np.zeros(len(start)), RATE
    before, steps, slopes, done = x, [], [], 0
    for k in range(iterations):
        cost, slope = estimate_slope(flights, x, rng.standard_normal((pairs, len(x))), width, k * pairs)
        if not np.isfinite(cost):
            if k == 0:
                problem = "some runs near the scenario's own gains have infinite cost, and therefore no slope"
                raise InputError(
                    argument_name("method", "gradient"),
                    problem,
                    fix=(f"{argument('method', 'search')}, or start from other gains with {argument_name('settings')}"),
                )
            x, rate = before, rate / 2
            continue
        steps.append(TuningStep((k + 1) * 2 * pairs, cost, x))
        slopes.append(slope)
        done += 1
        m = BETA1 * m + (1 - BETA1) * slope.slope
        v = BETA2 * v + (1 - BETA2) * slope.slope**2
        step = (m / (1 - BETA1**done)) / np.maximum(np.sqrt(v / (1 - BETA2**done)), 1e-300)
        before, x = x, np.clip(x - rate * (1 - 0.9 * k / iterations) * step, 0.0, 1.0)
    last = [s.x for s in steps[-max(len(steps) // 3, 1) :]]
    return np.mean([*last, x], axis=0), steps, slopes
