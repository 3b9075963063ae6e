"""Time Crazyflow's own simulation step, run by Crazyflow and compiled by trimtab, for one world and for many.

    pip install "trimtab[foreign]"
    python benchmarks/crazyflow.py                   1, 1024 and 16384 worlds: ten minutes
    python benchmarks/crazyflow.py --worlds 1 1024   other numbers of worlds
    python benchmarks/crazyflow.py --rounds 2        fewer rounds

Crazyflow 0.4 simulates Crazyflie quadrotors and the controller of their firmware in JAX, in float32. Its function
`Sim._step` is compiled as it is: no line of it is changed, and its state, with its random key, is the argument. Each
call computes 500 steps of 2 ms, from the ground to a place 0.5 m above it. The calls include the conversion of the
arguments and results, and the wait for the results. Both use all cores. In each round, the programs run in random
order.

Exits with 1 if the positions differ by more than float32 rounding, with --strict also if a target is missed.
"""

import argparse
import os
import sys
from typing import Any

os.environ["SCIPY_ARRAY_API"] = "1"  # Crazyflow refuses to be imported without it
os.environ.setdefault("JAX_PLATFORMS", "cpu")

HERE = sys.path.pop(0)  # this file has the name of the package
import jax
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim

sys.path.insert(0, HERE)
from paired import Program, cores, load, machine, ratio, rounds, row, show

import trimtab

STEPS, TOLERANCE = 500, 2e-6
"""Number of steps of a call, and accepted difference of the positions (m): 16 units in the last place at 1 m."""
TARGETS = {1: 8.0, 1024: 10.0, 16384: 10.0}
COMMAND = "python benchmarks/crazyflow.py"


def simulation(worlds: int) -> Sim:
    """Return Crazyflow's simulation of one drone in each world, with a place to fly to."""
    sim = Sim(n_worlds=worlds, n_drones=1, control=Control.state, freq=500, state_freq=100, attitude_freq=500)
    command = np.zeros((worlds, 1, 16))
    command[..., 0], command[..., 2], command[..., 12] = 0.3, 0.5, 1.0
    sim.state_control(command)
    return sim


def is_key(x: Any) -> bool:
    """Return True for an array of random keys."""
    return jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)


def programs(worlds: int) -> dict[str, Program]:
    """Return both programs. The state of one world is the example; many worlds are runs of the compiled function."""
    one, many = simulation(1), simulation(worlds)
    step = one._step

    def fly(data: Any) -> Any:
        return step(data, n_steps=STEPS)

    compiled = trimtab.compile(fly, one.data, threads=cores())
    given, call = one.data, compiled
    if worlds > 1:
        keys = jax.random.split(jax.random.key(0), worlds)
        given = jax.tree.map(lambda x: keys if is_key(x) else np.repeat(np.asarray(x)[None], worlds, 0), one.data)
        call = compiled.lanes
    shape = (worlds, 1, 3)
    return {
        "Crazyflow": Program(
            lambda: jax.block_until_ready(many._step(many.data, n_steps=STEPS)),
            worlds,
            lambda d: np.asarray(d.states.pos),
        ),
        "trimtab": Program(lambda: call(given), worlds, lambda d: np.reshape(d.states.pos, shape)),
    }


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--worlds", type=int, nargs="+", default=list(TARGETS), help="numbers of worlds")
    p.add_argument("--rounds", type=int, default=9, help="number of rounds, after a first one that compiles")
    p.add_argument("--markdown", action="store_true", help="print rows of the table in docs/benchmarks.md")
    p.add_argument("--strict", action="store_true", help="exit with 1 if a target is missed")
    a = p.parse_args()
    print(f"{machine('jax', 'crazyflow')}\n{load()}")
    bad = missed = False
    lines = []
    for worlds in a.worlds:
        timed = rounds(programs(worlds), [()] * (a.rounds + 1), "Crazyflow")
        worlds_text = "1 world" if worlds == 1 else f"{worlds} worlds"
        show(f"{worlds_text}, {STEPS} steps; times of one world", timed, "trimtab", STEPS)
        found, target = ratio(timed, "Crazyflow", "trimtab"), TARGETS.get(worlds)
        bad |= not timed.worst["trimtab"] <= TOLERANCE
        missed |= target is not None and found is not None and found.median < target
        what = f"Crazyflow 0.4, {worlds_text}: time of Crazyflow / time of its step compiled by trimtab"
        lines.append(row(what, found, f"≥ {target:g}" if target else "", COMMAND))
    print("\n" + "\n".join(lines if a.markdown else [line.strip("| ").replace(" | ", "   ") for line in lines]))
    if bad:
        print(f"the positions differ by more than {TOLERANCE:g} m")
    sys.exit(bad or (a.strict and missed))


if __name__ == "__main__":
    main()
