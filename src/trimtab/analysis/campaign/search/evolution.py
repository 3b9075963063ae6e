"""Search by CMA-ES in the unit cube. Restarts double the population (IPOP). Each generation is one batch of runs.

Source: Hansen, Ostermeier, "Completely derandomized self-adaptation in evolution strategies", Evolutionary Computation
9 (2001); restarts: Auger, Hansen, "A restart CMA evolution strategy with increasing population size", CEC 2005; both by
the package `cma`, bounds by the smooth transformation in `cma`.
"""

import importlib
import math
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

SETTINGS = {
    "bounds": [0, 1],
    "verbose": -9,
    "verb_log": 0,
    "verb_disp": 0,
    "tolfun": 1e-4,
    "tolfunhist": 1e-4,
    "tolx": 1e-4,
}
FLAT_GENERATIONS_MAX = 8
"""Number of successive generations with equal values after which CMA-ES restarts."""


class Generation(NamedTuple):
    """One generation of the evolution strategy.

    x: (n, d), candidates.  f: (n,), values of the minimised function.  mean: (d,), centre of the search distribution.
    restart: number of the restart, from 0.
    """

    x: Any
    f: Any
    mean: Any
    restart: int


def evolve(
    of: Callable[[Any], Any],
    start: Callable[[int], Any],
    *,
    step: float,
    population: int,
    budget: int,
    seed: int,
) -> Iterator[Generation]:
    """Yield the generations of a search until `budget` points are used up. The caller may stop earlier.

    Args:
        of: function to minimise, from points (n, d) in [0, 1] to finite values (n,). Only the order of the values
            matters.
        start: function from the number of a restart to the starting point (d,).
        step: initial standard deviation of the candidates, as a fraction of the cube's width.
        population: minimum number of candidates in a generation of the first search. Each restart doubles this number.
        budget: maximum number of points that are evaluated.
        seed: seed of the random numbers of the search.
    """
    cma: Any = importlib.import_module("cma")  # cma is needed only for a search
    spent, restart, rng = 0, 0, np.random.default_rng(seed)
    while True:
        x0 = np.asarray(start(restart), np.float64)
        d = len(x0)
        size = max(population, 4 + int(3 * math.log(max(d, 2)))) * 2**restart
        if spent + size > budget:
            return
        randn = np.random.RandomState(int(rng.integers(1, 2**31))).randn
        options = SETTINGS | {"popsize": size, "tolflatfitness": FLAT_GENERATIONS_MAX, "seed": math.nan, "randn": randn}
        with warnings.catch_warnings(action="ignore"):
            es = cma.CMAEvolutionStrategy(np.append(x0, 0.5) if d == 1 else x0, step, options)
        while spent + size <= budget and not es.stop():
            with warnings.catch_warnings(action="ignore"):
                candidates = es.ask()
            x = np.clip(np.array(candidates)[:, :d], 0.0, 1.0)
            f = np.asarray(of(x), np.float64)
            with warnings.catch_warnings(action="ignore"):
                es.tell(candidates, f.tolist())
            spent += len(x)
            yield Generation(x, f, np.clip(np.asarray(es.result.xfavorite)[:d], 0.0, 1.0), restart)
        restart += 1
