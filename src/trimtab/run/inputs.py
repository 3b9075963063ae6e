"""Inputs of a run: all numbers of world, autopilot, initial state and random key. Some may differ from run to run."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import part, record, to_arrays
from trimtab.core.rng import Key
from trimtab.core.suggestions import closest
from trimtab.loop.autopilot import AutopilotState
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import drop_derived_outputs, start
from trimtab.loop.world import WorldState
from trimtab.run.program import check_seed


@record
class RunInputs:
    """Inputs of a run, as arrays of fixed data types. Source: docs page, Simulate."""

    world: Any = part("Vehicle, sensors, links and actuators.")
    autopilot: Any = part("Autopilot: estimator, law and allocation.")
    initial: Any = part("Initial state of the vehicle.")
    key: Any = part("Seed and run number, from which the random numbers are generated.")

    def initial_states(self) -> tuple[WorldState, AutopilotState]:
        """Return the states of world and autopilot before the first instant."""
        return start(self.world, self.autopilot, self.initial, self.key)

    def drop_derived_outputs(self, s: Any, a: Any, always: frozenset[int]) -> tuple[WorldState, AutopilotState]:
        """Return the states of world and autopilot without outputs that are recomputed at every instant.

        s, a: states of world and autopilot.  always: periods of the blocks that are computed at every instant.
        """
        return drop_derived_outputs(self.world, self.autopilot, s, a, always)


def run_inputs(scenario: Scenario, seed: int = 0, run: int = 0) -> RunInputs:
    """Return the inputs of a run of a scenario."""
    return RunInputs(
        world=to_arrays(scenario.world),
        autopilot=to_arrays(scenario.autopilot),
        initial=to_arrays(scenario.initial),
        key=Key(np.uint32(seed), noise_words(scenario, np.uint32(run))),
    )


def noise_words(scenario: Scenario, numbers: Any) -> Any:
    """Return the second part of the random keys of runs. numbers: run numbers, an array of any shape (…).

    For a scenario without `words`, this part is the run number. For a scenario with m `words`, it is an array (…, m) of
    these words plus the run number. Then run 0 has the noise that the words select, and every other run has different
    noise.
    """
    numbers = np.asarray(numbers, np.uint32)
    return numbers[..., None] + np.asarray(scenario.words, np.uint32) if len(scenario.words) else numbers


def leaf_paths(tree: Any) -> list[str]:
    """Return the path of each leaf of a tree, in JAX's order of leaves, e.g. world.vehicle.mass."""
    named = jax.tree_util.tree_flatten_with_path(tree)[0]
    return [jax.tree_util.keystr(keys, simple=True, separator=".") for keys, _ in named]


def flat_inputs(inputs: RunInputs, own: frozenset[int] = frozenset()) -> Any:
    """Return the inputs that are equal in all runs as a vector, float64, in the order that the compiled library needs.

    own: positions, among the leaves, of the inputs that differ from run to run.
    """
    shared = [np.ravel(v).astype(np.float64) for i, v in enumerate(jax.tree.leaves(inputs)) if i not in own]
    return np.concatenate([np.zeros(0), *shared])


def input_position(inputs: RunInputs, path: str) -> int:
    """Return the index, in the vector `flat_inputs(inputs)`, of the first number of the input with this path."""
    sizes = [int(np.size(v)) for v in jax.tree.leaves(inputs)]
    return sum(sizes[: leaf_paths(inputs).index(path)])


def own_inputs(
    inputs: RunInputs, seeds: list[int], runs: Iterable[int] | None = None, spread: Mapping[str, Any] | None = None
) -> dict[int, Any]:
    """Return the inputs that differ from run to run: position among the leaves -> values, with the run as first axis.

    seeds, runs, spread: as in `simulate_batch`.
    """
    paths, shared = leaf_paths(inputs), jax.tree.leaves(inputs)
    own: dict[int, Any] = {paths.index("key.seed"): np.asarray(seeds, np.uint32)}
    if runs is not None:
        own[paths.index("key.run")] = _run_words(shared[paths.index("key.run")], len(seeds), runs)
    for path, values in (spread or {}).items():
        if path not in paths or path.startswith("key."):
            near = closest(path, paths, 6) or paths[:6]
            raise InputError(f"spread {path!r}", "unknown parameter", choices=near, fix=f"spread {near[0]!r}")
        at = paths.index(path)
        array, shape = np.asarray(values), (len(seeds), *np.shape(shared[at]))
        if array.shape != shape:
            problem = f"must have shape {shape}, with one value for each run, but has shape {array.shape}"
            raise InputError(f"spread {path!r}", problem, fix=f"use {len(seeds)} values, one for each seed")
        if not np.isfinite(array).all():
            raise InputError(
                f"spread {path!r}",
                "all values of a spread must be finite",
                fix="replace NaN and infinity by finite values",
            )
        own[at] = array.astype(shared[at].dtype)
    return dict(sorted(own.items()))


def own_rows(own: dict[int, Any], runs: int) -> Any:
    """Return the inputs that differ from run to run, float64 (runs, k), in the order that the compiled library
    needs."""
    columns = [np.asarray(v, np.float64).reshape(runs, -1) for v in own.values()]
    return np.concatenate([np.zeros((runs, 0)), *columns], axis=1)


def _run_words(first: Any, count: int, runs: Iterable[Any]) -> Any:
    """Return the second part of the random keys of `count` runs.

    runs: for each run, the run number or the second part of the random key.  first: second part of run 0's key.
    """
    words = np.asarray(runs if isinstance(runs, np.ndarray) else list(runs), np.int64)
    if len(words) != count or words.ndim > 1 + np.ndim(first):
        fix = "use as many run numbers as seeds"
        raise InputError("simulate_batch", f"run numbers: {len(words)}, seeds: {count}", fix=fix)
    if words.ndim == 2 and words.shape[1:] != np.shape(first):
        problem = f"random key words for each run: {words.shape[1]}, in the scenario: {np.size(first)}"
        raise InputError("simulate_batch", problem, fix="use one number for each entry in the scenario's field `words`")
    for number in (words.min(), words.max()) if words.size else ():
        check_seed(int(number))
    words = words.astype(np.uint32)
    return words if words.ndim > np.ndim(first) else words[:, None] + np.asarray(first, np.uint32)
