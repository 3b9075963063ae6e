"""What a run starts from: two sides, a first state and a key, as numbers by path; and what differs between runs."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.record import part, record, to_arrays
from trimtab.core.rng import Key
from trimtab.loop.autopilot import AutopilotState
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import drop_derived_outputs, start
from trimtab.loop.world import WorldState
from trimtab.run.program import check_seed


@record
class RunInputs:
    """All that a run starts from, as numbers of fixed types. Source: docs page, Simulate."""

    world: Any = part("Vehicle, sensors, links and actuators.")
    autopilot: Any = part("What flies it.")
    initial: Any = part("First state of the vehicle.")
    key: Any = part("Seed and run of the random numbers.")

    def initial_states(self) -> tuple[WorldState, AutopilotState]:
        """States of the two sides before the first instant."""
        return start(self.world, self.autopilot, self.initial, self.key)

    def drop_derived_outputs(self, s: Any, a: Any, always: frozenset[int]) -> tuple[WorldState, AutopilotState]:
        """The two states as a loop carries them, see `loop.walk`; always: periods that are due at every instant."""
        return drop_derived_outputs(self.world, self.autopilot, s, a, always)


def run_inputs(scenario: Scenario, seed: int = 0, run: int = 0) -> RunInputs:
    """What a run of a scenario starts from."""
    return RunInputs(
        world=to_arrays(scenario.world),
        autopilot=to_arrays(scenario.autopilot),
        initial=to_arrays(scenario.initial),
        key=Key(np.uint32(seed), noise_words(scenario, np.uint32(run))),
    )


def noise_words(scenario: Scenario, numbers: Any) -> Any:
    """Second key words of runs of these numbers (…): the numbers, or with words of the scenario's own (…, m).

    Those of run 0 are then the words themselves, and every other number names other noise.
    """
    numbers = np.asarray(numbers, np.uint32)
    return numbers[..., None] + np.asarray(scenario.words, np.uint32) if len(scenario.words) else numbers


def leaf_paths(tree: Any) -> list[str]:
    """The dotted path of each leaf, in the order of JAX, as a log names them: world.vehicle.mass, …, key.run."""
    named = jax.tree_util.tree_flatten_with_path(tree)[0]
    return [jax.tree_util.keystr(keys, simple=True, separator=".") for keys, _ in named]


def flat_inputs(inputs: RunInputs, own: frozenset[int] = frozenset()) -> Any:
    """The inputs that all runs share, float64, as a library reads them; own: positions of those that differ."""
    shared = [np.ravel(v).astype(np.float64) for i, v in enumerate(jax.tree.leaves(inputs)) if i not in own]
    return np.concatenate([np.zeros(0), *shared])


def input_position(inputs: RunInputs, path: str) -> int:
    """Where the first number of an input stands in `flat_inputs(inputs)`."""
    sizes = [int(np.size(v)) for v in jax.tree.leaves(inputs)]
    return sum(sizes[: leaf_paths(inputs).index(path)])


def own_inputs(
    inputs: RunInputs, seeds: list[int], runs: Iterable[int] | None = None, spread: Mapping[str, Any] | None = None
) -> dict[int, Any]:
    """Position of each input that differs -> its values, the run as first axis; arguments as of `simulate_batch`."""
    paths, shared = leaf_paths(inputs), jax.tree.leaves(inputs)
    own: dict[int, Any] = {paths.index("key.seed"): np.asarray(seeds, np.uint32)}
    if runs is not None:
        own[paths.index("key.run")] = _run_words(shared[paths.index("key.run")], len(seeds), runs)
    for path, values in (spread or {}).items():
        if path not in paths or path.startswith("key."):
            near = closest(path, paths, 6) or paths[:6]
            raise InputError(f"spread {path!r}", "there is no such parameter", choices=near, fix=f"spread {near[0]!r}")
        at = paths.index(path)
        array, shape = np.asarray(values), (len(seeds), *np.shape(shared[at]))
        if array.shape != shape:
            problem = f"has shape {array.shape}, wanted is {shape}: a value for each run"
            raise InputError(f"spread {path!r}", problem, fix=f"give {len(seeds)} values, one for each seed")
        if not np.isfinite(array).all():
            raise InputError(f"spread {path!r}", "not every value is finite", fix="leave NaN and infinity out")
        own[at] = array.astype(shared[at].dtype)
    return dict(sorted(own.items()))


def own_rows(own: dict[int, Any], runs: int) -> Any:
    """The inputs that differ, float64 (runs, k), as a library reads them."""
    columns = [np.asarray(v, np.float64).reshape(runs, -1) for v in own.values()]
    return np.concatenate([np.zeros((runs, 0)), *columns], axis=1)


def _run_words(first: Any, count: int, runs: Iterable[Any]) -> Any:
    """Second key words of so many runs: their numbers, or the words that each has; first: those of run 0."""
    words = np.asarray(runs if isinstance(runs, np.ndarray) else list(runs), np.int64)
    if len(words) != count or words.ndim > 1 + np.ndim(first):
        fix = "give each run a seed and a number"
        raise InputError("simulate_batch", f"{len(words)} numbers of runs for {count} seeds", fix=fix)
    if words.ndim == 2 and words.shape[1:] != np.shape(first):
        problem = f"{words.shape[1]} words for each run, where the scenario has {np.size(first)}"
        raise InputError("simulate_batch", problem, fix="as many as its `words`")
    for number in (words.min(), words.max()) if words.size else ():
        check_seed(int(number))
    words = words.astype(np.uint32)
    return words if words.ndim > np.ndim(first) else words[:, None] + np.asarray(first, np.uint32)
