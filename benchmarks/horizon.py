"""Measure a plan of the receding-horizon law: time on this machine, instructions on an emulated Cortex-M7.

    python benchmarks/horizon.py               a minute; --no-board leaves the board out

On this machine, only the compiled law runs, along a circle, with one step every 20 ms. On the board, the whole
autopilot of hovercraft/track with its INS runs, one step per millisecond, until it has planned a few times. QEMU counts
instructions, not the processor's cycles (docs/export/boards.md).
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
from paired import machine

import trimtab
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.export.export_c import export_c
from trimtab.flight.boards.microcontrollers import TARGETS, emulate, missing_tools
from trimtab.laws.pose import READS
from trimtab.laws.receding_horizon import RecedingHorizon
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import HovercraftState

BOARD = "cortex-m7"


def time_steps(count):
    """Return the times (us) of steps that compute a plan, and of steps that keep the last plan."""
    law = RecedingHorizon()
    state = jax.tree.map(np.asarray, law.init(key(0)))

    def step(t, state, x):
        there = HovercraftState(**dict(zip(READS, x, strict=True)))
        return law.step(t, state, Estimate(t=t, age=0.0, fresh=True, valid=True, state=there))

    compiled = trimtab.compile(step, np.int64(0), state, np.zeros(6))
    rng, took = np.random.default_rng(0), {True: [], False: []}
    for k in range(2 * count):
        x = np.array([0.0, 0.4, 0.3, 0.03 * k, 1.4, 0.05 * k]) + rng.normal(0, 0.02, 6)
        begin = time.perf_counter()
        state, _ = compiled(np.int64(100_000 * k), state, x)
        took[k % 2 == 0].append(1e6 * (time.perf_counter() - begin))
    return took[True], took[False]


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--no-board", action="store_true", help="measure only the time on this machine")
    p.add_argument("--steps", type=int, default=400, help="number of steps on the board (%(default)s)")
    a = p.parse_args()
    print(machine("jax"))
    for name, times in zip(("plans", "holds"), time_steps(500), strict=True):
        print(
            f"a step that {name}: median {np.median(times):.0f} us, 99 of 100 within {np.quantile(times, 0.99):.0f} us"
        )
    if a.no_board:
        return 0
    if missing := missing_tools():
        print(f"not installed: {', '.join(missing)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        scenario = build("hovercraft/track", {"law": "horizon"})
        export_c(scenario, Path(folder), name="autopilot", real=TARGETS[BOARD].real, steps=a.steps)
        flown = emulate(Path(folder), BOARD, steps=a.steps)
    plans = flown.instructions > 1_000_000
    for name, which in (("plans", plans), ("holds", ~plans)):
        n = flown.instructions[which]
        print(f"{BOARD}, a step that {name}: {len(n)} steps, {np.median(n):.0f} ({n.min()}..{n.max()}) instructions")
    print(f"flash {flown.flash_bytes} B, RAM {flown.ram_bytes} B, stack {flown.stack_bytes} B")
    return 0


if __name__ == "__main__":
    sys.exit(main())
