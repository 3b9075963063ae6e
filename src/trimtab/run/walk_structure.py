"""Structure of a simulated loop: all data on which the loop's C text depends. Also log columns and C program of a
loop."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.walk_program import WalkProgram, build_program, lower_walk
from trimtab.core.time import Instant
from trimtab.loop.autopilot import AutopilotState
from trimtab.loop.structure import cast_like
from trimtab.loop.walk import Signals, instant, logged_signals, signals
from trimtab.loop.world import WorldState
from trimtab.run.inputs import RunInputs, leaf_paths
from trimtab.run.program import Column


class WalkStructure(NamedTuple):
    """All data that determine the compiled text of a loop.

    tree: tree structure of the inputs.  shapes: shape and data type of each input.  always: periods of the blocks that
    are computed at every instant.  signals: paths of the logged signals.
    """

    tree: Any
    shapes: tuple[tuple[tuple[int, ...], str], ...]
    always: frozenset[int]
    signals: tuple[str, ...]

    def zero_inputs(self) -> RunInputs:
        """Return inputs with this structure, with every number zero."""
        return jax.tree.unflatten(self.tree, [np.zeros(shape, dtype) for shape, dtype in self.shapes])


def walk_structure(inputs: RunInputs, always: frozenset[int], signals: tuple[str, ...]) -> WalkStructure:
    """Return the structure of a loop with the given inputs.

    always: periods of the blocks that are computed at every instant.  signals: paths of the signals to log.
    """
    leaves, tree = jax.tree.flatten(inputs)
    return WalkStructure(tree, tuple((np.shape(v), str(np.asarray(v).dtype)) for v in leaves), always, signals)


@jax.jit
def _initial_states(inputs: RunInputs) -> tuple[WorldState, AutopilotState]:
    """Return the states of world and autopilot before the first instant.

    JAX traces this function only once for inputs with the same structure.
    """
    return inputs.initial_states()


@functools.lru_cache(maxsize=32)
def _first_instant(of: WalkStructure) -> tuple[WorldState, Signals]:
    """Return shapes and data types of the world's state and of the signals. JAX traces the loop once per structure."""

    def begin(inputs: RunInputs) -> tuple[WorldState, Signals]:
        states = _initial_states(inputs)
        return states[0], signals(*states)

    return jax.eval_shape(begin, of.zero_inputs())


def signal_structure(inputs: RunInputs) -> Signals:
    """Return shapes and data types of the signals of a run, without executing the run."""
    return _first_instant(walk_structure(inputs, frozenset(), ()))[1]


@functools.lru_cache(maxsize=32)
def row_columns(of: WalkStructure) -> list[Column]:
    """Return the columns of a log row of a loop."""
    _, structure = _first_instant(of._replace(always=frozenset(), signals=()))
    return [Column(p, v.shape, str(v.dtype), declared) for p, v, declared in logged_signals(structure, of.signals)]


@functools.lru_cache(maxsize=32)
def final_columns(of: WalkStructure) -> list[Column]:
    """Return the columns of the final values of a run: the true state, and the integration report of the last step."""
    s, _ = _first_instant(of._replace(always=frozenset(), signals=()))
    last = {"truth": s.x, "world": s.integrated}
    return [
        Column(".".join(filter(None, [name, path])), v.shape, str(v.dtype))
        for name, tree in last.items()
        for path, v in zip(leaf_paths(tree), jax.tree.leaves(tree), strict=True)
    ]


@functools.lru_cache(maxsize=32)
def lower_structure(of: WalkStructure) -> WalkProgram:
    """Return the program of a loop. It depends only on the loop's structure, and not on the values of the inputs."""
    begin, step, count = _trace_closed_loop(of.zero_inputs(), of.always, of.signals)
    return lower_walk(begin, step, count)


@functools.lru_cache(maxsize=64)
def build_walk_library(of: WalkStructure, lanes: int = 0, own: frozenset[int] = frozenset()) -> Path:
    """Build the shared library of a loop, and return the path of the library.

    lanes: number of runs that the library computes at a time (0: one run).  own: positions of the inputs that differ
    from run to run.
    """
    return build_program(lower_structure(of), lanes, own)


def _trace_closed_loop(inputs: RunInputs, always: frozenset[int], names: tuple[str, ...]) -> tuple[Any, Any, int]:
    """Return the traced functions "begin" and "step" of a loop, and the number of final values.

    The final values are the first leaves of the state that "step" returns: true state and integration report.
    """

    def flat(inputs: RunInputs, s: Any, a: Any) -> Any:
        return (s.x, s.integrated), *inputs.drop_derived_outputs(s, a, always)

    def begin(inputs: RunInputs) -> Any:
        return flat(inputs, *_initial_states(inputs))

    def step(inputs: RunInputs, state: Any, t: Any, h: Any) -> Any:
        _, s, a = state
        new_s, new_a, seen = instant(inputs.world, inputs.autopilot, Instant(t, always), h, s, a)
        seen = jax.tree.map(jax.numpy.asarray, seen)
        row = [value.astype(np.float64) for _, value, _ in logged_signals(seen, names)]
        return cast_like(flat(inputs, new_s, new_a), state), row

    t = np.int64(0)
    program, state = jax.make_jaxpr(begin, return_shape=True)(inputs)
    return program, jax.make_jaxpr(step)(inputs, state, t, t), len(jax.tree.leaves(state[0]))
