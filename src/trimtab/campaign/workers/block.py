"""Runs flown together, those of a campaign or at points that a search asks for, and what the metrics say of them."""

import itertools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trimtab.campaign.sampling.spread import arrays_of, values_of
from trimtab.campaign.statistics.measure import measured
from trimtab.campaign.workers.ready import Ready, drawn, options_of, variant
from trimtab.native.compiler import NoCompiler, search
from trimtab.run import compiled
from trimtab.run.batch import simulate_batch
from trimtab.run.prepare import inputs, prepared, use_c


def fly_block(
    ready: Ready,
    first: int,
    last: int,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Rows first … last - 1: by name what differs, then each metric, `success` and `lost`, each (n,)."""
    of, values = drawn(ready, first, last)
    flags = {"backend": backend, "threads": threads, "progress": progress}
    return {**values, **_fly(ready, values, of.words, flags)}


def fly_points(
    ready: Ready,
    u: Any,
    words: Any,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Metrics, `success` and `lost` at points u (n, d) of the spread, with the random numbers that words (n,) name.

    progress: is given how many more were flown, from time to time.
    """
    found: list[dict[str, Any]] = []
    for first in range(0, len(words), max(ready.block, 1)):
        part = slice(first, first + max(ready.block, 1))
        values = values_of(ready.spread, ready.scenario, u[part])
        found.append(_fly(ready, values, words[part], {"backend": backend, "threads": threads}))
        if progress is not None:
            progress(len(words[part]))
    return {name: np.concatenate([f[name] for f in found]) for name in found[0]}


def _fly(ready: Ready, values: Mapping[str, Any], words: Any, flags: dict[str, Any]) -> dict[str, Any]:
    """What metrics say of runs with these values, by what was written, each (n,)."""
    arrays = arrays_of(ready.spread, ready.scenario, values)
    kept: dict[str, Any] = {m.name: np.empty(len(words)) for m in ready.metrics}
    kept |= {"success": np.empty(len(words), bool), "lost": np.empty(len(words), bool)}
    for picks, chosen in _groups(values, list(options_of(ready)), len(words)):
        batch = simulate_batch(
            variant(ready, picks),
            seeds=[ready.plan.seed] * len(chosen),
            runs=words[chosen],
            spread={path: array[chosen] for path, array in arrays.items()},
            signals=ready.wanted,
            log_period=ready.plan.log_period,
            log=True,
            **flags,
        )
        for name, column in measured(ready, batch).items():
            kept[name][chosen] = column
    return kept


def flies_c(ready: Ready, backend: str) -> bool:
    """Whether C flies the runs: where it is asked for, or a compiler is here and the loop can be written in C."""

    def can() -> None:
        found = search("c")
        if found.compiler is None:
            raise NoCompiler("compiler", found.problem, fix=found.fix)
        _, table, _ = prepared(ready.scenario, [], None, ready.plan.log_period)
        compiled.lowered(compiled.structure(inputs(ready.scenario, 0, 0), table.always, ready.wanted))

    return use_c(backend, can)


def _groups(values: Mapping[str, Any], options: list[str], n: int) -> list[tuple[dict[str, int], Any]]:
    """Runs of one program: what was picked for each option, and their places in the block."""
    if not options:
        return [({}, np.arange(n))]
    found = []
    for picks in itertools.product(*(np.unique(values[o]) for o in options)):
        inside = np.all([values[o] == p for o, p in zip(options, picks, strict=True)], axis=0)
        if inside.any():
            found.append(({o: int(p) for o, p in zip(options, picks, strict=True)}, np.flatnonzero(inside)))
    return found
