"""How far a compiled function is from jax.jit, on random inputs: one by one, and over lanes."""

from typing import Any, NamedTuple

import jax
import numpy as np
from xla_settings import choose_emitters

import trimtab
from compiler.foreign.case import Case

jax.config.update("jax_enable_x64", True)

CLOSE = 1e-13
"""Relative to scale: what counts as agreeing."""
RUNS = 9
"""Inputs drawn: more than the lanes carry."""


class Agreement(NamedTuple):
    """What was found.

    apart: the largest difference in any result and run, relative to the result's scale: its largest magnitude over all
    runs. Infinite where shapes, types, integers, truth values, NaN or infinities differ.
    same_in_lanes: whether lanes give the bits of single calls.
    """

    apart: float
    same_in_lanes: bool


def draw_runs(case: Case) -> list[tuple[Any, ...]]:
    """Arguments for each run."""
    return [case.arguments(np.random.default_rng(k)) for k in range(RUNS)]


def jit_case(case: Case) -> Any:
    """The case by jax.jit, as XLA comes: its older way, which an environment may ask for, is less exact."""
    options = choose_emitters(newer=True)
    return jax.jit(lambda *arguments: case.function(*arguments), compiler_options=options)


def compute_leaves(function: Any, runs: list[tuple[Any, ...]]) -> list[list[Any]]:
    """The arrays that a function gives in each run."""
    return [[np.asarray(x) for x in jax.tree.leaves(function(*arguments))] for arguments in runs]


def measure_agreement(case: Case) -> Agreement:
    """Compile a case and compare it; raises InputError where it is refused."""
    runs = draw_runs(case)
    compiled = trimtab.compile(case.function, *runs[0])
    single, wanted = compute_leaves(compiled, runs), compute_leaves(jit_case(case), runs)
    many = jax.tree.leaves(compiled.lanes(*jax.tree.map(lambda *x: np.stack(x), *runs)))
    bits = [
        np.array_equal(one, all_runs[k], equal_nan=one.dtype.kind == "f")
        for k, leaves in enumerate(single)
        for one, all_runs in zip(leaves, many, strict=True)
    ]
    return Agreement(difference(single, wanted), all(bits))


def difference(found: list[list[Any]], wanted: list[list[Any]]) -> float:
    """The largest difference relative to scale; see `Agreement`."""
    pairs = zip(zip(*found, strict=True), zip(*wanted, strict=True), strict=True)
    return max((_difference_of_one(np.stack(f), np.stack(w)) for f, w in pairs), default=0.0)


def _difference_of_one(found: Any, wanted: Any) -> float:
    if found.shape != wanted.shape or found.dtype != wanted.dtype:
        return np.inf
    if wanted.dtype.kind != "f":
        return 0.0 if np.array_equal(found, wanted) else np.inf
    finite = np.isfinite(wanted)
    if not np.array_equal(found[~finite], wanted[~finite], equal_nan=True) or not np.isfinite(found[finite]).all():
        return np.inf
    apart = np.max(np.abs(found[finite] - wanted[finite]), initial=0.0)
    return float(apart / (np.max(np.abs(wanted[finite]), initial=0.0) or 1.0))


def measure_sensitivity(case: Case) -> float:
    """How far jax.jit's own results move where every float among the inputs moves by one unit in its last place."""
    runs, function = draw_runs(case), jit_case(case)
    wanted = compute_leaves(function, runs)
    return max(difference(compute_leaves(function, _nudge(runs, to)), wanted) for to in (-np.inf, np.inf))


def _nudge(runs: list[tuple[Any, ...]], to: float) -> list[tuple[Any, ...]]:
    def leaf(x: Any) -> Any:
        return np.nextafter(x, to) if np.asarray(x).dtype.kind == "f" else x

    return [jax.tree.map(leaf, arguments) for arguments in runs]
