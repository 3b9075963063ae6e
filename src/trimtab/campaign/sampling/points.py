"""Where in the unit cube each run of a campaign lies, from the campaign's seed and the run's number.

    random   each number its own Philox stream of (seed, path): run k has its k-th number
    sobol    scrambled Sobol points, in order
    latin    a Latin hypercube of all the runs, which therefore can't become more
    saltelli, morris   the designs of the sensitivity analyses (saltelli.py, morris.py): the noise is a factor, too

Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox); Owen, "Randomly permuted
(t,m,s)-nets", 1995 (scrambling), and McKay, Beckman, Conover, Technometrics 21 (1979) (Latin), both by scipy.stats.qmc.
"""

import warnings
import zlib
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.sampling.morris import morris_rows
from trimtab.campaign.sampling.saltelli import check_factors, saltelli_rows
from trimtab.core.errors import InputError

DESIGNS = ("saltelli", "morris")
"""Designs whose rows are no independent worlds: they say what matters, not how often."""
SAMPLINGS = ("random", "sobol", "latin", *DESIGNS)


class Points(NamedTuple):
    """u: (n, d) in (0, 1).  words: (n,), second word of each run's key: which random numbers it flies with."""

    u: Any
    words: Any


def points(sampling: str, seed: int, names: tuple[str, ...], runs: int, first: int, last: int) -> Points:
    """The points of runs first … last - 1.

    Args:
        sampling: one of SAMPLINGS.
        seed: of the campaign.
        names: of what is drawn, one for each column.
        runs: of the whole campaign; matters to a Latin hypercube only.
        first, last: which runs.
    """
    if sampling not in SAMPLINGS:
        raise InputError("--sampling", f"{sampling!r} is not a sampling", choices=SAMPLINGS, fix="--sampling random")
    words = np.arange(first, last, dtype=np.uint32)
    if sampling in DESIGNS:
        check_factors(names)
        made = (saltelli_rows if sampling == "saltelli" else morris_rows)(seed, first, last, len(names))
        return Points(made.u, made.words)
    if not names:
        return Points(np.empty((last - first, 0)), words)
    if sampling == "random":
        u = np.stack([_stream(seed, name, first, last) for name in names], axis=1)
    elif sampling == "sobol":
        u = _sobol(seed, len(names), first, last)
    else:
        from scipy.stats import qmc

        u = qmc.LatinHypercube(len(names), rng=np.random.default_rng(seed)).random(runs)[first:last]
    return Points(np.clip(u, 2.0**-54, 1 - 2.0**-53), words)


def _stream(seed: int, name: str, first: int, last: int) -> Any:
    bits = np.random.Philox(key=np.array([seed, zlib.crc32(name.encode())], np.uint64))
    bits.advance(first // 4)  # a counter of Philox gives four words
    return np.random.Generator(bits).random(last - first + first % 4)[first % 4 :]


def _sobol(seed: int, d: int, first: int, last: int) -> Any:
    from scipy.stats import qmc

    engine = qmc.Sobol(d, rng=np.random.default_rng(seed))
    if first:
        engine.fast_forward(first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about balance, which the whole campaign has or has not
        return engine.random(last - first)
