"""Workload compiled by trimtab: one run, one run with its log, and campaigns over lanes and threads."""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import spec
import workload

from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.core.rng import Key
from trimtab.core.time import Timetable, ms, timetable
from trimtab.run.inputs import RunInputs, flat_inputs, input_position
from trimtab.run.program import fly_runs, row_numbers
from trimtab.run.walk_structure import WalkStructure, build_walk_library, final_columns, lower_structure, walk_structure

NOTHING = ("truth.heading",)
"""Signal given to programs without a log. It is logged at no instant."""
ENDS = [f"truth.{n}" for n in ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading")]
SCALE = np.array([spec.M, spec.M, spec.J, 1.0, 1.0, 1.0])
"""Factors from velocities to momenta, and 1 for the other states."""


class Loop(NamedTuple):
    """Traced loop.

    whole: inputs.  table: instants.  of: structure.  at: positions of the true state in the final values.
    widths: numbers in a row of the log, and number of final values.  row: row that each instant writes.
    """

    whole: RunInputs
    table: Timetable
    of: WalkStructure
    at: Any
    widths: tuple[int, int]
    row: Any


@cache
def parts(signals: tuple[str, ...] = ()) -> Loop:
    """Return the loop with these signals logged at each instant. It is traced at the first call."""
    world, autopilot, x = workload.loop(np.array(spec.GAINS))
    whole = RunInputs(world, autopilot, x, Key(np.uint32(spec.KEY0), np.uint32(0)))
    table = timetable([*world.periods(), autopilot.period], ms(spec.N), world.max_step)
    of = walk_structure(whole, table.always, signals or NOTHING)
    names = [(c.path, int(np.prod(c.shape))) for c in final_columns(of)]
    starts = dict(zip([n for n, _ in names], np.cumsum([0, *(size for _, size in names)]).tolist(), strict=False))
    sizes = dict(names)
    at = np.concatenate([np.arange(starts[n], starts[n] + sizes[n]) for n in ENDS])
    widths = lower_structure(of).width, sum(sizes.values())
    return Loop(whole, table, of, at, widths, row_numbers(np.full(len(table.t), bool(signals))))


@cache
def inputs() -> tuple[Any, list[int]]:
    """Return the inputs of a single run, and the positions of gains and key in them."""
    whole = parts().whole
    places = [input_position(whole, p) for p in ("autopilot.law.k1", "autopilot.law.k2", "key.seed", "key.run")]
    return flat_inputs(whole), places


@cache
def library(signals: tuple[str, ...] = ()) -> Path:
    """Return the path of the scalar library. The first call compiles it."""
    return build_walk_library(parts(signals).of)


def _flown(loop: Loop, path: Path, gains: Any, key: Any, log: bool) -> Any:
    shared, places = inputs()
    mine = shared.copy()
    mine[places] = *gains, *key
    return fly_runs(path, mine, np.empty((1, 0)), loop.table, loop.row, loop.widths, log=log)


def single(gains: Any, key: Any) -> Any:
    """Return the true state at the end of one run."""
    loop = parts()
    return _flown(loop, library(), gains, key, log=False).final[0, loop.at] * SCALE


def logged(gains: Any, key: Any) -> Any:
    """Return the log of one run (instants, 11): true state before each step, estimate, thrust and rudder."""
    signals = workload.LOGGED
    return _flown(parts(signals), library(signals), gains, key, log=True).log[0]


def width() -> int:
    """Return the number of runs computed side by side in vector registers; 1 without vector registers."""
    compiler = find_compiler("c++")
    return lane_count(compiler) if compiler else 1


def _own(loop: Loop) -> frozenset[int]:
    """Return the position of the run number in the inputs, the only input that differs between runs."""
    return frozenset([len(jax.tree.leaves(loop.whole)) - 1])


def text(lanes: int) -> str:
    """Return the C text of a single run, or the C++ text of a campaign over lanes."""
    loop = parts()
    flight = lower_structure(loop.of)
    return flight.text(lanes, _own(loop)) if lanes else flight.text()


def campaign_inputs() -> Any:
    """Return the inputs that all runs of a campaign share."""
    loop = parts()
    return flat_inputs(loop.whole, _own(loop))


def campaign(runs: int, threads: int) -> Any:
    """Return the true states at the ends of many runs, simulated over lanes and threads."""
    loop, n = parts(), width()
    path = build_walk_library(loop.of, n if n > 1 else 0, _own(loop))
    numbers = np.arange(runs, dtype=np.float64)[:, None]
    flown = fly_runs(path, campaign_inputs(), numbers, loop.table, loop.row, loop.widths, log=False, threads=threads)
    return flown.final[:, loop.at] * SCALE
