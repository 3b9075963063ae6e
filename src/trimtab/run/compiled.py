"""From a scenario to its compiled program: traced by JAX, written as C, built by the machine's compiler, remembered."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import logged_signals
from trimtab.native.build import build_library
from trimtab.native.compiler import find_compiler
from trimtab.run.program import Column, Program, describe_scenario
from trimtab.run.walk_program import WalkProgram, lower_closed_loop


class Structure(NamedTuple):
    """What decides the compiled text: tree, shapes and types of the inputs, due periods, signals."""

    tree: Any
    shapes: tuple[tuple[tuple[int, ...], str], ...]
    always: frozenset[int]
    signals: tuple[str, ...]


def program_structure(fly: Any, always: frozenset[int], wanted: tuple[str, ...]) -> Structure:
    """The structure of (world, autopilot, first state, key)."""
    found, tree = jax.tree.flatten(fly)
    return Structure(tree, tuple((np.shape(v), str(np.asarray(v).dtype)) for v in found), always, wanted)


@functools.lru_cache(maxsize=32)
def lower_structure(of: Structure) -> WalkProgram:
    """The flight of a structure; the numbers of its inputs play no part."""
    zeros = [np.zeros(shape, dtype) for shape, dtype in of.shapes]
    world, autopilot, x, key = jax.tree.unflatten(of.tree, zeros)
    return lower_closed_loop(world, autopilot, x, key, of.always, of.signals)


@functools.lru_cache(maxsize=64)
def build_walk_library(of: Structure, lanes: int = 0, own: frozenset[int] = frozenset()) -> Path:
    """The shared library of a flight: scalar, or over lanes with the inputs at `own` different in each."""
    return build_library(lower_structure(of).text(lanes, own), "c++" if lanes else "c", extra=("-pthread",))


def input_paths(fly: Any) -> list[str]:
    """The dotted path of each input, in order: world.vehicle.mass, …, key.seed, key.run."""
    names = ("world", "autopilot", "initial", "key")
    found = []
    for keys, _ in jax.tree_util.tree_flatten_with_path(fly)[0]:
        rest = [str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", "")))) for k in keys[1:]]
        found.append(".".join([names[keys[0].idx], *rest]))
    return found


def flat_inputs(fly: Any, own: frozenset[int] = frozenset()) -> Any:
    """The inputs that all runs share, as the library reads them."""
    kept = [np.ravel(v).astype(np.float64) for i, v in enumerate(jax.tree.leaves(fly)) if i not in own]
    return np.concatenate([np.zeros(0), *kept])


def input_position(fly: Any, path: str) -> int:
    """Where the first number of an input stands in `flat_inputs(fly)`."""
    sizes = [int(np.size(v)) for v in jax.tree.leaves(fly)]
    return sum(sizes[: input_paths(fly).index(path)])


def row_columns(flight: WalkProgram, wanted: tuple[str, ...]) -> list[Column]:
    """What the numbers of a row are."""
    return [Column(p, v.shape, str(v.dtype), declared) for p, v, declared in logged_signals(flight.signals, wanted)]


def final_columns(flight: WalkProgram) -> list[Column]:
    """What the last values are: the truth, then the states of the sensors."""
    found = jax.tree_util.tree_flatten_with_path(flight.final_structure)[0]
    names = ("truth", "sensors")
    made = []
    for keys, value in found:
        rest = [str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", "")))) for k in keys[1:]]
        made.append(Column(".".join([names[keys[0].idx], *rest]), value.shape, str(value.dtype)))
    return made


def compile_program(scenario: Scenario, fly: Any, always: frozenset[int], wanted: tuple[str, ...]) -> Program:
    """A checked scenario, compiled for single runs."""
    of = program_structure(fly, always, wanted)
    path, flight = build_walk_library(of), lower_structure(of)
    return Program(
        library=path,
        shared_inputs=flat_inputs(fly),
        words=(input_position(fly, "key.seed"), input_position(fly, "key.run")),
        periods=(*scenario.world.periods(), scenario.autopilot.period),
        duration=scenario.duration,
        max_step=scenario.world.max_step,
        columns=row_columns(flight, wanted),
        final=final_columns(flight),
        metadata=describe_scenario(scenario),
    )


def has_compiler() -> bool:
    """Whether this machine can compile C."""
    return find_compiler("c") is not None
