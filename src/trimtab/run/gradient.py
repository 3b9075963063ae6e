"""Gradients of the cost of a run with respect to parameters, by forward differentiation in the compiled loop."""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.compiler.walk_program import WalkProgram, build_program, lower_walk
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.time import Instant, Timetable, ms, to_seconds
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import Signals, instant
from trimtab.run.inputs import RunInputs, flat_inputs, leaf_paths, own_inputs, own_rows, run_inputs
from trimtab.run.program import fly_runs, row_numbers, thread_count
from trimtab.run.runner import prepare_run
from trimtab.run.walk_structure import WalkStructure, walk_structure

Cost = Callable[[Signals], Any]


class Gradient(NamedTuple):
    """Cost of one run, and derivatives of the cost.

    cost: integral of the running cost over the run (unit of the running cost x s).  slope: path of a parameter ->
    derivative of the cost, in the shape of the parameter. If the loop contains switches, the cost may jump when a
    parameter changes. The derivative does not include such jumps.
    """

    cost: float
    slope: dict[str, Any]


def gradient(
    scenario: Scenario, cost: Cost, paths: tuple[str, ...], *, seed: int = 0, duration: int | None = None
) -> Gradient:
    """Return the integral of a running cost over one run, and the derivatives of this integral by parameters.

    The derivatives are computed in C, by automatic differentiation in forward mode.

    Args:
        scenario: scenario. It is checked completely before the run.
        cost: running cost, a JAX function from the signals of an instant (`loop.walk.Signals`) to a scalar, e.g.
            ``lambda s: s.truth.yaw_rate**2``. Define the function only once, because each new function is compiled.
        paths: paths of parameters that are real numbers, e.g. ("autopilot.law.k1", "autopilot.law.k2").
        seed: seed of the random numbers.
        duration: duration of the run, integer time. None: the scenario's duration.

    Raises:
        InputError: as for `simulate`. Also if a path is not that of a real parameter, or if no C compiler is found.
    """
    scenario, table, _ = prepare_run(scenario, [seed], duration, ms(1))
    inputs = run_inputs(scenario, seed)
    at, shapes = _find_parameters(inputs, paths)
    sizes = [int(np.prod(shape)) for shape in shapes]
    final = _fly_directions(inputs, {}, table, at, cost, (0,), np.eye(sum(sizes)), None)
    slopes = np.split(final[:, 1], np.cumsum(sizes)[:-1])
    by_path = {path: slope.reshape(shape) for path, shape, slope in zip(paths, shapes, slopes, strict=True)}
    return Gradient(float(final[0, 0]), by_path)


class Gradients(NamedTuple):
    """Costs of n runs, and derivatives of the costs.

    costs: k costs of each run (n, k).  slopes: derivatives of the costs by d parameters (n, k, d).
    """

    costs: Any
    slopes: Any


def gradients(
    scenario: Scenario,
    cost: Cost,
    along: Iterable[tuple[str, tuple[int, ...]]],
    *,
    seeds: Iterable[int],
    runs: Iterable[int],
    spread: Mapping[str, Any] | None = None,
    since: tuple[int, ...] = (0,),
    threads: int | None = None,
) -> Gradients:
    """Return costs of many runs, and the derivatives of the costs. The runs differ in random numbers and parameters.

    Args:
        scenario: scenario.
        cost: running costs, a JAX function from the signals of an instant to an array (k,). Define the function only
            once, as for `gradient`.
        along: parameters by which the costs are differentiated. Each entry is a path and the index of one element of
            the parameter, () for a scalar.
        seeds, runs: seed and run number of each run, which together select its random numbers.
        spread: path of a parameter -> values of the parameter in n runs (n, …), as in `simulate_batch`.
        since: start time of the integral of each of the k costs (100 ns).
        threads: number of threads. None: the number of cores.
    """
    chosen, entries = list(seeds), list(along)
    scenario, table, _ = prepare_run(scenario, chosen, None, ms(1))
    inputs = run_inputs(scenario)
    paths = tuple(dict.fromkeys(path for path, _ in entries))
    at, shapes = _find_parameters(inputs, paths)
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    directions = np.zeros((len(entries), ends[-1]))
    for row, (path, index) in enumerate(entries):
        k = paths.index(path)
        directions[row, ends[k] + int(np.ravel_multi_index(index, shapes[k]) if index else 0)] = 1.0
    own = own_inputs(inputs, chosen, runs, spread)
    final = _fly_directions(inputs, own, table, at, cost, since, directions, threads)
    n, k, d = len(chosen), len(since), len(entries)
    by_run = final.reshape(n, d, 2 * k)
    return Gradients(by_run[:, 0, :k], np.swapaxes(by_run[:, :, k:], 1, 2))


def _fly_directions(
    inputs: RunInputs,
    own: dict[int, Any],
    table: Timetable,
    at: tuple[int, ...],
    cost: Cost,
    since: tuple[int, ...],
    directions: Any,
    threads: int | None,
) -> Any:
    """Return the costs and the derivatives of the costs (runs x directions, 2 k).

    Each run is flown once for each direction in the space of the parameters.
    """
    of = walk_structure(inputs, table.always, ())
    count = len(of.shapes)
    varying = frozenset(own) | frozenset(range(count, count + len(at)))
    runs = len(next(iter(own.values()))) if own else 1
    mine = np.repeat(own_rows(own, runs), len(directions), axis=0)
    rows = np.concatenate([mine, np.tile(directions, (runs, 1))], axis=1)
    compiler = find_compiler("c++")
    n = lane_count(compiler) if compiler is not None and len(rows) > 1 else 1
    path = build_program(_lower_dual(of, at, cost, since), n if n > 1 else 0, varying)
    nowhere = row_numbers(np.zeros(len(table.t), bool))
    widths = 1, 2 * len(since)
    shared = flat_inputs(inputs, frozenset(own))
    return fly_runs(path, shared, rows, table, nowhere, widths, log=False, threads=thread_count(threads)).final


def _find_parameters(inputs: RunInputs, paths: tuple[str, ...]) -> tuple[tuple[int, ...], list[tuple[int, ...]]]:
    """Return the positions of parameters among the inputs of a run, and the shapes of the parameters.

    Raise InputError if a path is not that of a real parameter.
    """
    known, values = leaf_paths(inputs), jax.tree.leaves(inputs)
    real = [p for p, v in zip(known, values, strict=True) if np.asarray(v).dtype == np.float64]
    if not paths:
        raise InputError("gradient", "at least one parameter is needed", choices=real[:8], fix=f"paths=({real[0]!r},)")
    for path in paths:
        if path not in real:
            near = closest(path, real, 6) or real[:6]
            problem = f"{path!r} is not the path of a real parameter"
            raise InputError("gradient", problem, choices=near, fix=f"paths=({near[0]!r},)")
    at = tuple(known.index(p) for p in paths)
    return at, [np.shape(values[i]) for i in at]


@functools.lru_cache(maxsize=16)
def _lower_dual(of: WalkStructure, at: tuple[int, ...], cost: Cost, since: tuple[int, ...]) -> WalkProgram:
    """Return a program that steps cost and state of a run together with their derivatives.

    The derivatives are along one direction in the space of the parameters. The inputs of the program are the inputs of
    the run and this direction.
    """
    example = jax.tree.leaves(of.zero_inputs())
    dual = _DualRun(of.tree, of.always, at, cost, since)
    direction = [example[i] for i in at]
    begin, state = jax.make_jaxpr(dual.initial_state, return_shape=True)(example, direction)
    t = np.int64(0)
    return lower_walk(begin, jax.make_jaxpr(dual.step)(example, direction, state, t, t), 2 * len(since))


class _DualRun:
    """Run, together with the derivatives of cost and state along one direction in the space of the parameters.

    Only real numbers have a derivative.
    """

    def __init__(
        self, tree: Any, always: frozenset[int], at: tuple[int, ...], cost: Cost, since: tuple[int, ...]
    ) -> None:
        self.tree, self.always, self.at, self.cost, self.since = tree, always, at, cost, since
        self.structure: Any = None

    def insert_values(self, leaves: list[Any], chosen: list[Any]) -> RunInputs:
        mine = list(leaves)
        for i, value in zip(self.at, chosen, strict=True):
            mine[i] = value
        return jax.tree.unflatten(self.tree, mine)

    def split(self, state: Any) -> tuple[list[Any], list[Any]]:
        """Return the real numbers in a state, and all other values. Store the state's structure for `join_leaves`."""
        values, tree = jax.tree.flatten(state)
        real = [np.issubdtype(jax.numpy.result_type(v), np.floating) for v in values]
        self.structure = tree, real
        pairs = list(zip(values, real, strict=True))
        return [v for v, r in pairs if r], [v for v, r in pairs if not r]

    def join_leaves(self, reals: list[Any], others: list[Any]) -> Any:
        tree, real = self.structure
        a, b = iter(reals), iter(others)
        return jax.tree.unflatten(tree, [next(a) if r else next(b) for r in real])

    def initial_state(self, leaves: list[Any], direction: list[Any]) -> Any:
        def first(chosen: list[Any]) -> Any:
            inputs = self.insert_values(leaves, chosen)
            return self.split(inputs.drop_derived_outputs(*inputs.initial_states(), self.always))

        chosen = [leaves[i] for i in self.at]
        reals, slopes, others = jax.jvp(first, (chosen,), (direction,), has_aux=True)
        none = [0.0] * len(self.since)
        return none, none, reals, slopes, others

    def step(self, leaves: list[Any], direction: list[Any], state: Any, t: Any, h: Any) -> Any:
        total, slope, reals, slopes, others = state

        def one(chosen: list[Any], reals: list[Any]) -> Any:
            inputs = self.insert_values(leaves, chosen)
            s, a = self.join_leaves(reals, others)
            s, a, seen = instant(inputs.world, inputs.autopilot, Instant(t, self.always), h, s, a)
            rate = jax.numpy.ravel(jax.numpy.asarray(self.cost(seen), np.float64)) * to_seconds(h)
            now = [jax.numpy.where(t >= first, rate[i], 0.0) for i, first in enumerate(self.since)]
            new, rest = self.split(inputs.drop_derived_outputs(s, a, self.always))
            new = [jax.numpy.asarray(v, np.float64) for v in new]
            rest = [jax.numpy.asarray(v, old.dtype) for v, old in zip(rest, others, strict=True)]
            return (now, new), rest

        chosen = [leaves[i] for i in self.at]
        (now, new), (rate, change), rest = jax.jvp(one, (chosen, reals), (direction, slopes), has_aux=True)
        total = [a + b for a, b in zip(total, now, strict=True)]
        slope = [a + b for a, b in zip(slope, rate, strict=True)]
        return (total, slope, new, change, rest), []
