"""A run that was flown before, flown again without importing JAX: its compiled programs, kept as plans."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.commands.plan import CachedRun, find_run, keep_run
from trimtab.core.quantity import Quantity
from trimtab.logs.log import to_plain
from trimtab.logs.metrics import Target
from trimtab.native.cache import find_library as find_library
from trimtab.native.compiler import cpu_identity
from trimtab.run.program import Column, Program

PROGRAM_NUMBERS = ("words", "periods", "duration", "max_step")


class RunPrograms(NamedTuple):
    """What a run of the command line needs: the programs, real and ideal, and what is shown of them."""

    name: str
    real: Program
    ideal: Program | None
    targets: tuple[Target, ...]


def program_key(scenario: str, settings: Mapping[str, str], without: Iterable[str], ideal: bool) -> dict[str, Any]:
    """What decides the programs of a run: everything but the seed and what is done with the result."""
    return {
        "scenario": scenario,
        "settings": dict(settings),
        "without": list(without),
        "ideal": ideal,
        "cpu": cpu_identity(),
    }


def load_programs(key: dict[str, Any]) -> RunPrograms | None:
    """The run as it was kept, or None where there is none or its libraries are gone."""
    plan = find_run(key)
    if plan is None:
        return None
    try:
        held = plan.content
        real, ideal = (_program_from_json(held[side], plan.arrays, side) for side in ("real", "ideal"))
        if real is None or (held["ideal"] is not None and ideal is None):
            return None
        return RunPrograms(held["name"], real, ideal, tuple(Target(*t) for t in held["targets"]))
    except (KeyError, TypeError, ValueError, IndexError):
        return None


def store_programs(key: dict[str, Any], ready: RunPrograms, files: Iterable[str]) -> bool:
    """Keep a run for the next time; whether that was done."""
    arrays = {side: p.shared_inputs for side, p in (("real", ready.real), ("ideal", ready.ideal)) if p is not None}
    content = {
        "name": ready.name,
        "targets": [[t.path, float(t.value), float(t.band)] for t in ready.targets],
        "real": _program_json(ready.real),
        "ideal": None if ready.ideal is None else _program_json(ready.ideal),
    }
    return keep_run(key, CachedRun(content, arrays), files)


def _program_json(program: Program) -> dict[str, Any]:
    numbers = {name: to_plain(name, getattr(program, name)) for name in PROGRAM_NUMBERS}
    return numbers | {
        "library": Path(program.library).stem,
        "columns": [_column_json(c) for c in program.columns],
        "final": [_column_json(c) for c in program.final],
        "metadata": to_plain("metadata", program.metadata),
    }


def _column_json(c: Column) -> dict[str, Any]:
    declared = None if c.declaration is None else to_plain(c.path, dataclasses.asdict(c.declaration))
    return {"path": c.path, "shape": list(c.shape), "dtype": c.dtype, "declared": declared}


def _program_from_json(held: Mapping[str, Any] | None, arrays: Mapping[str, Any], side: str) -> Program | None:
    """The program that was kept; None where there was none, or its library is not whole any more."""
    library = None if held is None else find_library(held["library"])
    if held is None or library is None:
        return None
    return Program(
        library=library,
        shared_inputs=arrays[side],
        words=(held["words"][0], held["words"][1]),
        periods=tuple(held["periods"]),
        duration=held["duration"],
        max_step=held["max_step"],
        columns=[_column_from_json(c) for c in held["columns"]],
        final=[_column_from_json(c) for c in held["final"]],
        metadata=dict(held["metadata"]),
    )


def _column_from_json(held: Mapping[str, Any]) -> Column:
    declared = None
    if held["declared"] is not None:
        fields = dict(held["declared"])
        declared = Quantity(**{**fields, "modes": tuple(fields["modes"]), "shape": tuple(fields["shape"])})
    return Column(held["path"], tuple(held["shape"]), held["dtype"], declared)
