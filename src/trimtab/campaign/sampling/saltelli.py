"""The runs of a Sobol sensitivity analysis: two samples A and B, and A with one factor at a time taken from B.

Base sample j has d + 2 rows: A, then A with factor i from B for i = 0 … d - 1, then B. A and B are the halves of point
j of one Sobol sequence in 2 d dimensions, shifted digit by digit with random words of the seed. Row k depends on the
seed, k and the number of factors alone: more base samples append rows.

The random numbers of a run are one more factor, the last: A flies with one word (the `run` of its key), B with another,
and the row of that factor is A flown again with B's word. No two base samples share a word.

Source: [1] Saltelli et al., "Variance based sensitivity analysis of model output", Comput. Phys. Commun. 181 (2010),
for the rows; [2] Joe, Kuo, "Constructing Sobol sequences with better two-dimensional projections", SIAM J. Sci. Comput.
30 (2008), the sequence; [3] L'Ecuyer, Lemieux, "Recent advances in randomized quasi-Monte Carlo methods", 2002, the
shift.
"""

import zlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from trimtab.core.errors import InputError
from trimtab.core.rng import threefry2x32

NOISE = "noise"
"""Name of the factor that is a run's random numbers."""
BITS = 32
STREAM = zlib.crc32(b"campaign.sampling.saltelli")


class DesignRows(NamedTuple):
    """Rows of a design. u: of each parameter, in (0, 1), shape (rows, parameters).

    words: which random numbers a row flies with, the second word of its key, uint32, shape (rows,); all 0 where the
    noise is no factor.
    """

    u: Any
    words: Any


def check_factors(factors: Sequence[str], correlated: Iterable[Sequence[str]] = ()) -> None:
    """Refuse factors whose effects can't be told apart, before anything flies.

    Args:
        factors: names of the parameters, without the noise.
        correlated: groups of names that are drawn together.
    """
    groups = [tuple(g) for g in correlated if len(g) > 1]
    if groups:
        problem = f"{', '.join(groups[0])} are correlated: a variance of both has no share of one"
        fix = "draw them independently for the sensitivity, or fly the campaign with random sampling"
        raise InputError("sensitivity", problem, fix=fix)
    if not factors:
        raise InputError("sensitivity", "no parameter is dispersed", fix="add e.g. --spread PATH=uniform(80%, 120%)")
    twice = sorted({f for f in factors if list(factors).count(f) > 1 or f == NOISE})
    if twice:
        problem = f"the factor {twice[0]!r} is there twice, or has the name of the runs' random numbers"
        raise InputError("sensitivity", problem, fix="give each factor once, by its path")


def rows_per_base(parameters: int, *, noise: bool = True) -> int:
    """How many rows one base sample has: the factors, and A and B."""
    return parameters + int(noise) + 2


def saltelli_rows(seed: int, first: int, last: int, parameters: int, *, noise: bool = True) -> DesignRows:
    """Rows first to last - 1 of the design.

    Args:
        seed: of the campaign.
        first: number of the first row, from 0.
        last: number of the row after the last.
        parameters: how many are dispersed, at least 1, without the noise.
        noise: whether the random numbers of the runs are one more factor; False: all rows fly with the same.
    """
    if not 0 <= first < last or not 1 <= parameters <= qmc.Sobol.MAXDIM // 2:
        problem = f"rows {first} to {last} of {parameters} parameters are none"
        raise InputError("saltelli", problem, fix="0 <= first < last and at least one parameter")
    size = rows_per_base(parameters, noise=noise)
    base, place = np.divmod(np.arange(first, last), size)
    points = _shifted_points(seed, int(base[0]), int(base[-1]) + 1, 2 * parameters)[base - base[0]]
    a, b = points[:, :parameters], points[:, parameters:]
    from_b = (place[:, None] == size - 1) | (place[:, None] == np.arange(parameters) + 1)
    word = 2 * base + ((place == size - 1) | (place == parameters + 1))
    words = word if noise else np.zeros_like(word)
    return DesignRows(np.where(from_b, b, a), words.astype(np.uint32))


def _shifted_points(seed: int, first: int, last: int, dimensions: int) -> Any:
    """Points first to last - 1 of the shifted sequence, in (0, 1)."""
    engine = qmc.Sobol(dimensions, scramble=False, bits=BITS)
    if first == 0:
        points = np.concatenate([np.zeros((1, dimensions)), _later_points(engine, last - 1)])
    else:
        engine.fast_forward(first)
        points = engine.random(last - first)
    digits = (points * 2.0**BITS).astype(np.uint32)
    word = np.uint32(seed % 2**32)
    shift, _ = threefry2x32(word, np.uint32(STREAM), np.arange(dimensions), 0)
    return ((digits ^ np.asarray(shift, np.uint32)) + 0.5) * 2.0**-BITS


def _later_points(engine: qmc.Sobol, count: int) -> Any:
    """The points after the first, which is the origin; asked for in this way it doesn't mind any number of them."""
    engine.fast_forward(1)
    return engine.random(count) if count else np.empty((0, engine.d))
