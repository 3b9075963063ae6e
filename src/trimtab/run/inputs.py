"""Inputs of a run: numbers of world, autopilot, initial state and random key. Some may differ between runs."""

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
    """Inputs of a run, as numbers of fixed types. Source: docs page, Simulate."""

    world: Any = part("Vehicle, sensors, links and actuators.")
    autopilot: Any = part("Autopilot: estimator, law and allocation.")
    initial: Any = part("Initial state of the vehicle.")
    key: Any = part("Seed and run number, from which the random numbers are generated.")

    def initial_states(self) -> tuple[WorldState, AutopilotState]:
        """Return the states of world and autopilot before the first instant."""
        return start(self.world, self.autopilot, self.initial, self.key)

    def drop_derived_outputs(self, s: Any, a: Any, always: frozenset[int]) -> tuple[WorldState, AutopilotState]:
        """Return the states of world and autopilot without outputs that the loop can compute again, see `loop.walk`.

        s, a: states of world and autopilot.  always: periods of the blocks that are due at every
        instant.
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
    """Return the second words of the random keys of runs with these numbers (…).

    If the scenario has no random key words, they are the run numbers themselves. If it has m words, they are its words
    plus the run number, (…, m). Run 0 then has the scenario's words, and every other run has different noise.
    """
    numbers = np.asarray(numbers, np.uint32)
    return numbers[..., None] + np.asarray(scenario.words, np.uint32) if len(scenario.words) else numbers


def leaf_paths(tree: Any) -> list[str]:
    """Return the dotted path of each leaf, in the order of JAX, as in a log: world.vehicle.mass, …, key.run."""
    named = jax.tree_util.tree_flatten_with_path(tree)[0]
    return [jax.tree_util.keystr(keys, simple=True, separator=".") for keys, _ in named]


def flat_inputs(inputs: RunInputs, own: frozenset[int] = frozenset()) -> Any:
    """Return the inputs that all runs share as a vector, float64, in the order of the compiled library.

    own: positions of the inputs that differ between runs.
    """
    shared = [np.ravel(v).astype(np.float64) for i, v in enumerate(jax.tree.leaves(inputs)) if i not in own]
    return np.concatenate([np.zeros(0), *shared])


def input_position(inputs: RunInputs, path: str) -> int:
    """Return the index in `flat_inputs(inputs)` of the first number of the input at a path."""
    sizes = [int(np.size(v)) for v in jax.tree.leaves(inputs)]
    return sum(sizes[: leaf_paths(inputs).index(path)])


def own_inputs(
    inputs: RunInputs, seeds: list[int], runs: Iterable[int] | None = None, spread: Mapping[str, Any] | None = None
) -> dict[int, Any]:
    """Return position -> values of each input that differs between runs. The first axis of the values is the run.

    The arguments are those of `simulate_batch`.
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
            problem = f"must have shape {shape}, a value for each run, but has shape {array.shape}"
            raise InputError(f"spread {path!r}", problem, fix=f"give {len(seeds)} values, one for each seed")
        if not np.isfinite(array).all():
            raise InputError(
                f"spread {path!r}",
                "all values of a spread must be finite",
                fix="replace NaN and infinity by finite values",
            )
        own[at] = array.astype(shared[at].dtype)
    return dict(sorted(own.items()))


def own_rows(own: dict[int, Any], runs: int) -> Any:
    """Return the inputs that differ between runs, float64 (runs, k), in the order of the compiled library."""
    columns = [np.asarray(v, np.float64).reshape(runs, -1) for v in own.values()]
    return np.concatenate([np.zeros((runs, 0)), *columns], axis=1)


def _run_words(first: Any, count: int, runs: Iterable[Any]) -> Any:
    """Return the second words of the random keys of `count` runs.

    runs: run number, or the random key words, of each run.  first: random key words of run 0.
    """
    words = np.asarray(runs if isinstance(runs, np.ndarray) else list(runs), np.int64)
    if len(words) != count or words.ndim > 1 + np.ndim(first):
        fix = "give each run a seed and a number"
        raise InputError("simulate_batch", f"{len(words)} run numbers for {count} seeds", fix=fix)
    if words.ndim == 2 and words.shape[1:] != np.shape(first):
        problem = f"{words.shape[1]} random key words for each run, but the scenario has {np.size(first)}"
        raise InputError("simulate_batch", problem, fix="give one word for each entry of the scenario's `words`")
    for number in (words.min(), words.max()) if words.size else ():
        check_seed(int(number))
    words = words.astype(np.uint32)
    return words if words.ndim > np.ndim(first) else words[:, None] + np.asarray(first, np.uint32)
