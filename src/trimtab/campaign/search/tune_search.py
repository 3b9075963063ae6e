"""Tuning without derivatives: CMA-ES over the mean cost of many runs, the same ones for every candidate.

A candidate in which some runs cost infinitely much is worse than any in which none does, and worse the more do.

Source: Hansen, Ostermeier, Evolutionary Computation 9 (2001); common random numbers: Law, "Simulation modeling and
analysis", 5th ed. 2015, section 11.2.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.search.evolution import evolve

STEP, POPULATION = 0.25, 8


class Step(NamedTuple):
    """flown: runs until then.  cost: mean of its runs.  x: (d,), where the gains were."""

    flown: int
    cost: float
    x: Any


def merit(costs: Any, reference: float) -> Any:
    """What orders candidates by their costs (n, runs): z/(1 + z) in units of a reference; 1 and more where inf."""
    finite = np.isfinite(costs)
    share = 1 - finite.mean(axis=1)
    z = np.where(finite, costs, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1) / max(abs(reference), 1e-12)
    return share + np.where(finite.any(axis=1), z / (1 + np.abs(z)), 1.0)


def search(
    costs: Callable[[Any], Any],
    start: Any,
    runs: int,
    iterations: int,
    seed: int,
) -> tuple[Any, list[Step]]:
    """The best gains found, and how it went.

    Args:
        costs: places (n, d) in [0, 1] -> costs (n, runs), of the same runs each time.
        start: (d,), the scenario's own.
        runs: of a candidate.
        iterations: generations of the first restart's size.
        seed: of the search.
    """
    first = costs(start[None])
    finite = first[np.isfinite(first)]
    reference = float(finite.mean()) if finite.size else 1.0
    best, least = start, float(merit(first, reference)[0])
    steps, flown = [Step(runs, float(first.mean()), start)], runs
    rng = np.random.default_rng(seed)

    def begin(restart: int) -> Any:
        return start if restart == 0 else rng.random(len(start))

    of_cost = {"now": first}

    def of(x: Any) -> Any:
        of_cost["now"] = costs(x)
        return merit(of_cost["now"], reference)

    generations = evolve(of, begin, step=STEP, population=POPULATION, budget=iterations * POPULATION, seed=seed)
    last: Any = None
    for generation in generations:
        flown += generation.f.size * runs
        i = int(np.argmin(generation.f))
        if generation.f[i] < least:
            best, least = generation.x[i], float(generation.f[i])
        steps.append(Step(flown, float(of_cost["now"][i].mean()), generation.x[i]))
        last = generation
    if last is not None:
        centre = costs(last.mean[None])
        flown += runs
        if float(merit(centre, reference)[0]) <= least:
            best = last.mean
            steps.append(Step(flown, float(centre.mean()), best))
    return best, steps
