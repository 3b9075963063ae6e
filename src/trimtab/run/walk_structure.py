"""Structure of a flown walk: what its compiled text depends on, its columns, and its program."""

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
    """Everything that determines the compiled text: tree, shapes and types of inputs, due periods, signals."""

    tree: Any
    shapes: tuple[tuple[tuple[int, ...], str], ...]
    always: frozenset[int]
    signals: tuple[str, ...]

    def zero_inputs(self) -> RunInputs:
        """Return inputs of this structure, every number zero."""
        return jax.tree.unflatten(self.tree, [np.zeros(shape, dtype) for shape, dtype in self.shapes])


def walk_structure(inputs: RunInputs, always: frozenset[int], signals: tuple[str, ...]) -> WalkStructure:
    """Return the structure of a walk from these inputs. always: periods that are due at every instant."""
    leaves, tree = jax.tree.flatten(inputs)
    return WalkStructure(tree, tuple((np.shape(v), str(np.asarray(v).dtype)) for v in leaves), always, signals)


@jax.jit
def _initial_states(inputs: RunInputs) -> tuple[WorldState, AutopilotState]:
    """Return the states before the first instant; JAX traces this function once for each structure."""
    return inputs.initial_states()


@functools.lru_cache(maxsize=32)
def _first_instant(of: WalkStructure) -> tuple[WorldState, Signals]:
    """Return the world's state and the signals before the first instant, for their structure; traced only once."""

    def begin(inputs: RunInputs) -> tuple[WorldState, Signals]:
        states = _initial_states(inputs)
        return states[0], signals(*states)

    return jax.eval_shape(begin, of.zero_inputs())


def signal_structure(inputs: RunInputs) -> Signals:
    """Return the signals of a run, for their structure; nothing flies."""
    return _first_instant(walk_structure(inputs, frozenset(), ()))[1]


@functools.lru_cache(maxsize=32)
def row_columns(of: WalkStructure) -> list[Column]:
    """Return the columns of a row."""
    _, structure = _first_instant(of._replace(always=frozenset(), signals=()))
    return [Column(p, v.shape, str(v.dtype), declared) for p, v, declared in logged_signals(structure, of.signals)]


@functools.lru_cache(maxsize=32)
def final_columns(of: WalkStructure) -> list[Column]:
    """Return the columns of the last values: the truth, and the integration's report on its last step."""
    s, _ = _first_instant(of._replace(always=frozenset(), signals=()))
    last = {"truth": s.x, "world": s.integrated}
    return [
        Column(".".join(filter(None, [name, path])), v.shape, str(v.dtype))
        for name, tree in last.items()
        for path, v in zip(leaf_paths(tree), jax.tree.leaves(tree), strict=True)
    ]


@functools.lru_cache(maxsize=32)
def lower_structure(of: WalkStructure) -> WalkProgram:
    """Return the program of a structure; it doesn't depend on the numbers of the inputs."""
    begin, step, count = _trace_closed_loop(of.zero_inputs(), of.always, of.signals)
    return lower_walk(begin, step, count)


@functools.lru_cache(maxsize=64)
def build_walk_library(of: WalkStructure, lanes: int = 0, own: frozenset[int] = frozenset()) -> Path:
    """Return the shared library of a walk: scalar, or over lanes with the inputs at `own` different in each."""
    return build_program(lower_structure(of), lanes, own)


def _trace_closed_loop(inputs: RunInputs, always: frozenset[int], names: tuple[str, ...]) -> tuple[Any, Any, int]:
    """Return the programs of start and instant, and the number of leaves of the state, from the first, to return.

    The state is flattened with the truth and the integration first.
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
