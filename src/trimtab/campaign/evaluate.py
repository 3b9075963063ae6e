"""Runs at chosen points: what a search asks for, where a campaign draws."""

from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.campaign.block import Ready, measured
from trimtab.campaign.spread import arrays_of, values_of
from trimtab.core.errors import InputError
from trimtab.core.record import Option, Quantity, leaves, with_leaf
from trimtab.loop.scenario import Scenario
from trimtab.run.batch import simulate_batch


def fly_points(
    ready: Ready,
    u: Any,
    words: Any,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Columns of the runs at points u (n, d) of the spread, with the random numbers that words (n,) name."""
    found: list[dict[str, Any]] = []
    for first in range(0, len(words), max(ready.block, 1)):
        part = slice(first, first + max(ready.block, 1))
        batch = simulate_batch(
            ready.scenario,
            seeds=[ready.plan.seed] * len(words[part]),
            runs=words[part],
            spread=arrays_of(ready.spread, ready.scenario, values_of(ready.spread, ready.scenario, u[part])),
            signals=ready.wanted,
            log_period=ready.plan.log_period,
            log=True,
            backend=backend,
            threads=threads,
        )
        found.append(measured(ready, batch))
        if progress is not None:
            progress(len(words[part]))
    return {name: np.concatenate([f[name] for f in found]) for name in found[0]}


def parameters_at(ready: Ready, u: Any) -> dict[str, Any]:
    """Path -> value of each parameter of the spread at the point u (d,), to the bit as it flies there."""
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    arrays = arrays_of(ready.spread, ready.scenario, values_of(ready.spread, ready.scenario, u[None]))
    return {path: _typed(array[0], declared[path]) for path, array in arrays.items()}


def scenario_at(ready: Ready, u: Any) -> Scenario:
    """The scenario at the point u (d,) of the spread."""
    scenario = ready.scenario
    for path, value in parameters_at(ready, u).items():
        scenario = with_leaf(scenario, path, lambda _old, _declared, value=value: value)
    return scenario


def _typed(value: Any, declared: Quantity | Option) -> Any:
    dtype = declared.dtype() if isinstance(declared, Quantity) else np.float64
    return np.asarray(value).astype(dtype)[()]


def refuse_options(ready: Ready, part: str) -> None:
    """Refuse a spread of what shapes the program: a search moves numbers."""
    declared = {path: d for path, _, d in leaves(ready.scenario)}
    for factor in ready.spread.factors:
        if isinstance(declared[factor.path], Option):
            problem = f"{factor.path} shapes the program, and a search moves numbers"
            fix = f"one search each, e.g. --set '{factor.path}={factor.distribution.choices[0]}'"
            raise InputError(f"{part} {factor.text}", problem, fix=fix)


def check_ends(ready: Ready, ends: Any, part: str) -> None:
    """Refuse bounds beyond what a part can be flown with: each parameter at its ends, and all at once.

    Args:
        ready: the campaign.
        ends: (2, d), the least and the largest point.
        part: what the refusal names.
    """
    middle, names = ends.mean(axis=0), [f.text for f in ready.spread.factors]
    corners = [(ends[side], "all at one end") for side in (0, 1)]
    for i, name in enumerate(names):
        for side in (0, 1):
            point = middle.copy()
            point[i] = ends[side, i]
            corners.insert(0, (point, name))
    for point, name in corners:
        try:
            scenario_at(ready, point).check()
        except InputError as error:
            problem = f"can't be flown at its end: {error.part}: {error.problem}"
            raise InputError(f"{part} {name}", problem, choices=error.choices, fix="narrower bounds") from None
