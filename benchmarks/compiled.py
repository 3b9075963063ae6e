"""The workload, compiled: `single` and `campaign` as shared/bench's compare.py and this folder's compare.py call them."""

from functools import cache
from typing import Any

import jax
import numpy as np
import spec
import workload

from trimtab.core.rng import Key
from trimtab.core.time import ms, timetable
from trimtab.export.compiler import find_compiler, lanes
from trimtab.export.library import fly, rows_of
from trimtab.run import compiled

SIGNALS = ("truth.heading",)
"""Logged at no instant: only the end is wanted."""


@cache
def parts() -> Any:
    """Inputs, timetable, structure and library widths; the first call traces, the library compiles."""
    world, autopilot, x = workload.loop(np.array(spec.GAINS))
    whole = (world, autopilot, x, Key(np.uint32(spec.KEY0), np.uint32(0)))
    table = timetable([*world.periods(), autopilot.period], ms(spec.N), world.max_step)
    of = compiled.structure(whole, table.always, SIGNALS)
    last = compiled.last(compiled.lowered(of))
    names = [c.path for c in last for _ in range(int(np.prod(c.shape)))]
    at = [names.index(f"truth.{n}") for n in ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading")]
    first = names.index("sensors.navigation.hx"), names.index("sensors.navigation.nx")
    at += [first[0], first[0] + 1, *range(first[1], first[1] + 6)]
    return whole, table, of, np.array(at), len(names), rows_of(np.zeros(len(table.t), bool))


SCALE = np.array([spec.M, spec.M, spec.J] + [1.0] * 11)


@cache
def inputs() -> Any:
    """The shared inputs, and where gains and key stand in them."""
    whole = parts()[0]
    places = [compiled.position(whole, p) for p in ("autopilot.law.k1", "autopilot.law.k2", "key.seed", "key.run")]
    return compiled.flat(whole), places


def single(gains: Any, key: Any) -> Any:
    """The 14 numbers of one run."""
    _, table, of, at, count, row = parts()
    shared, places = inputs()
    mine = shared.copy()
    mine[places] = *gains, *key
    flown = fly(compiled.library(of), mine, np.empty((1, 0)), table, row, (1, count), log=False)
    return flown.final[0, at] * SCALE


def campaign(runs: int, threads: int) -> Any:
    """The 14 numbers of each of many runs, over lanes and threads."""
    whole, table, of, at, count, row = parts()
    own = frozenset([len(jax.tree.leaves(whole)) - 1])
    compiler = find_compiler("c++")
    n = lanes(compiler) if compiler else 1
    path = compiled.library(of, n if n > 1 else 0, own)
    columns = np.arange(runs, dtype=np.float64)[:, None]
    shared = compiled.flat(whole, own)
    return fly(path, shared, columns, table, row, (1, count), log=False, threads=threads).final[:, at] * SCALE
