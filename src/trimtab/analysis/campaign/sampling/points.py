"""Sampling points of the runs in the unit cube, computed from the campaign's seed and the run's number.

    random   each parameter has its own Philox stream, seeded by (seed, path); run k uses the k-th number
    sobol    scrambled Sobol points, in order
    latin    a Latin hypercube of all runs, to which no runs can be added later

Two designs are for sensitivity analysis, not for probabilities, because their rows (runs) are not independent samples.
In these designs, the random numbers of a run, called noise, are an additional factor, the last one. Row k depends only
on the seed, k and the number of factors, so that a larger design only appends rows.

    saltelli   two samples A and B, and A with one factor at a time taken from B
    morris     trajectories that change one factor at a time

**saltelli**: base sample j has d + 2 rows: A, then A with factor i from B for i = 0 … d - 1, then B. A and B are the
halves of point j of one Sobol sequence in 2 d dimensions, shifted digit by digit with random numbers that depend on
the seed. The noise of a run is selected by a random key, called word. A flies with one word and B with another. The row
for the factor noise repeats A with the word of B. No two base samples share a word.

**morris**: a trajectory has d + 1 rows. It starts at a random point of a grid with four levels. It changes each factor
once, in random order, by MORRIS_STEP up or down. The step of the factor noise flies the same point with other noise.
The levels avoid 0 and 1, where the quantile of a normal distribution is infinite.

Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox); Owen, "Randomly permuted
(t,m,s)-nets", 1995 (scrambling), and McKay, Beckman, Conover, Technometrics 21 (1979) (Latin), both by scipy.stats.qmc;
Saltelli et al., "Variance based sensitivity analysis of model output", Comput. Phys. Commun. 181 (2010), for its rows;
Joe, Kuo, "Constructing Sobol sequences with better two-dimensional projections", SIAM J. Sci. Comput. 30 (2008), the
sequence; L'Ecuyer, Lemieux, "Recent advances in randomized quasi-Monte Carlo methods", 2002, the shift; Morris,
"Factorial sampling plans for preliminary computational experiments", Technometrics 33 (1991).
"""

import warnings
import zlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.rng import threefry2x32

DESIGNS = ("saltelli", "morris")
"""Sampling designs for sensitivity analysis. The runs of such a design are not independent samples."""
SAMPLINGS = ("random", "sobol", "latin", *DESIGNS)
NOISE = "noise"
"""Name of the factor that represents a run's random numbers."""
BITS = 32
SALTELLI_STREAM = zlib.crc32(b"campaign.saltelli")
MORRIS_STREAM = zlib.crc32(b"campaign.morris")
MORRIS_LEVELS = np.array([0.05, 0.35, 0.65, 0.95])
MORRIS_STEP = 0.6
"""Step of a Morris trajectory: two of the grid's four levels. With this step, each level is visited equally often."""


class Points(NamedTuple):
    """Sampling points of n runs. u: probabilities (n, d) of the varied parameters, in (0, 1).

    words: (n,), random key that selects the noise of each run. All words are 0 in a sensitivity design in which the
    noise is not a factor.
    """

    u: Any
    words: Any


def points(sampling: str, seed: int, names: tuple[str, ...], runs: int, first: int, last: int) -> Points:
    """Return the sampling points of runs first … last - 1.

    Args:
        sampling: one of SAMPLINGS.
        seed: seed of the campaign.
        names: names of the varied parameters, one for each column of u.
        runs: number of runs of the whole campaign, used only by a Latin hypercube.
        first, last: first run, and last run + 1.
    """
    if sampling not in SAMPLINGS:
        raise InputError(
            argument_name("sampling"),
            f"unknown sampling {sampling!r}",
            choices=SAMPLINGS,
            fix=argument("sampling", "random"),
        )
    if sampling in DESIGNS:
        check_factors(names)
        return (saltelli_rows if sampling == "saltelli" else morris_rows)(seed, first, last, len(names))
    words = np.arange(first, last, dtype=np.uint32)
    if not names:
        return Points(np.empty((last - first, 0)), words)
    if sampling == "random":
        u = np.stack([_stream(seed, name, first, last) for name in names], axis=1)
    elif sampling == "sobol":
        u = _sobol(seed, len(names), first, last)
    else:
        u = qmc.LatinHypercube(len(names), rng=np.random.default_rng(seed)).random(runs)[first:last]
    return Points(inside_cube(u), words)


def inside_cube(x: Any) -> Any:
    """Map points x in [0, 1] to points u in (0, 1), at which all quantiles are finite."""
    return np.clip(x, 2.0**-54, 1 - 2.0**-53)


def _stream(seed: int, name: str, first: int, last: int) -> Any:
    bits = np.random.Philox(key=np.array([seed, zlib.crc32(name.encode())], np.uint64))
    bits.advance(first // 4)  # one count of Philox's counter yields four random words
    return np.random.Generator(bits).random(last - first + first % 4)[first % 4 :]


def _sobol(seed: int, d: int, first: int, last: int) -> Any:
    engine = qmc.Sobol(d, rng=np.random.default_rng(seed))
    if first:
        engine.fast_forward(first)
    with warnings.catch_warnings(
        action="ignore", category=UserWarning
    ):  # the warning about balance does not apply, because the campaign as a whole is balanced
        return engine.random(last - first)


def check_factors(factors: Sequence[str], correlated: Iterable[Sequence[str]] = ()) -> None:
    """Raise InputError if a sensitivity design cannot separate the effects of the factors.

    Args:
        factors: names of the varied parameters. The noise is not included.
        correlated: groups of parameter names that are correlated.
    """
    groups = [tuple(g) for g in correlated if len(g) > 1]
    if groups:
        problem = f"{', '.join(groups[0])} are correlated, so the variance cannot be divided between them"
        fix = "draw these parameters independently, or fly the campaign with random sampling"
        raise InputError("sensitivity", problem, fix=fix)
    if not factors:
        raise InputError(
            "sensitivity",
            "no parameter varies",
            fix=f"add e.g. {argument('spread', 'uniform(80%, 120%)', 'PATH')}",
        )
    twice = sorted({f for f in factors if list(factors).count(f) > 1 or f == NOISE})
    if twice:
        problem = f"the factor {twice[0]!r} is given twice, or has the name reserved for the runs' random numbers"
        raise InputError("sensitivity", problem, fix="name each factor only once, by the path")


def rows_per_base(parameters: int, *, noise: bool = True) -> int:
    """Return the number of rows of one base sample of Saltelli's design: A, B, and one row for each factor."""
    return parameters + int(noise) + 2


def saltelli_rows(seed: int, first: int, last: int, parameters: int, *, noise: bool = True) -> Points:
    """Return the sampling points of rows (runs) first to last - 1 of Saltelli's design.

    Args:
        seed: seed of the campaign.
        first, last: numbers of the first row, from 0, and of the row after the last.
        parameters: number of varied parameters, at least 1, without the noise.
        noise: True if the random numbers of the runs are a factor; False if all rows use the same random numbers.
    """
    if not 0 <= first < last or not 1 <= parameters <= qmc.Sobol.MAXDIM // 2:
        problem = f"not a valid range of rows: first {first}, last {last}, with {parameters} parameters"
        raise InputError("saltelli", problem, fix="give 0 <= first < last and at least one parameter")
    size = rows_per_base(parameters, noise=noise)
    base, place = np.divmod(np.arange(first, last), size)
    cube = _shifted_points(seed, int(base[0]), int(base[-1]) + 1, 2 * parameters)[base - base[0]]
    a, b = cube[:, :parameters], cube[:, parameters:]
    from_b = (place[:, None] == size - 1) | (place[:, None] == np.arange(parameters) + 1)
    word = 2 * base + ((place == size - 1) | (place == parameters + 1))
    words = word if noise else np.zeros_like(word)
    return Points(np.where(from_b, b, a), words.astype(np.uint32))


def _shifted_points(seed: int, first: int, last: int, dimensions: int) -> Any:
    """Return points first to last - 1 of the randomly shifted Sobol sequence, in (0, 1)."""
    engine = qmc.Sobol(dimensions, scramble=False, bits=BITS)
    engine.fast_forward(max(first, 1))  # without the first point, any number of points is allowed
    cube = engine.random(last - max(first, 1)) if last > 1 else np.empty((0, dimensions))
    if first == 0:
        cube = np.concatenate([np.zeros((1, dimensions)), cube])
    digits = (cube * 2.0**BITS).astype(np.uint32)
    word = np.uint32(seed % 2**32)
    shift, _ = threefry2x32(word, np.uint32(SALTELLI_STREAM), np.arange(dimensions), 0)
    return ((digits ^ np.asarray(shift, np.uint32)) + 0.5) * 2.0**-BITS


def rows_per_trajectory(parameters: int, *, noise: bool = True) -> int:
    """Return the number of rows of one Morris trajectory: the start, and one step for each factor."""
    return parameters + int(noise) + 1


def morris_rows(seed: int, first: int, last: int, parameters: int, *, noise: bool = True) -> Points:
    """Return the sampling points of rows first to last - 1 of Morris's design. Arguments as for `saltelli_rows`."""
    if not 0 <= first < last or parameters < 1:
        problem = f"not a valid range of rows: first {first}, last {last}, with {parameters} parameters"
        raise InputError("morris", problem, fix="give 0 <= first < last and at least one parameter")
    trajectory, place = np.divmod(np.arange(first, last), rows_per_trajectory(parameters, noise=noise))
    begin, when, up = morris_trajectories(seed, trajectory, parameters + int(noise))
    stepped = when < place[:, None]
    level = begin + 2 * (stepped == up)  # a step up leads two levels up, a step down two levels down
    words = 2 * trajectory + stepped[:, -1] if noise else np.zeros_like(trajectory)
    return Points(MORRIS_LEVELS[level[:, :parameters]], words.astype(np.uint32))


def morris_trajectories(seed: int, trajectory: Any, factors: int) -> tuple[Any, Any, Any]:
    """Return the steps of Morris trajectories, as three arrays (trajectories, factors).

    The arrays contain the lower level of the step (0 or 1), the step's position in the trajectory (from 0), and True
    for a step up.
    """
    word = np.uint32(seed % 2**32)
    drawn = threefry2x32(word, np.uint32(MORRIS_STREAM), trajectory[:, None], np.arange(factors)[None])
    bits, order = (np.asarray(w, np.uint32) for w in drawn)
    when = np.argsort(np.argsort(order, axis=1, kind="stable"), axis=1, kind="stable")
    return (bits & 1).astype(int), when, (bits >> 1) & 1 == 1
