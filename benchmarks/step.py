"""Time one step of the hovercraft's autopilot, called from Python: compiled to C, and jitted by JAX, alternately.

python benchmarks/step.py
"""

import argparse
import time

import jax
import numpy as np
from paired import Ratio, load, machine, row

from trimtab.core.record import to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import Frame
from trimtab.loop.walk import start
from trimtab.run.blocks import compile_autopilot
from trimtab.scenarios import catalogue

ROUNDS, CALLS = 21, 2000


def programs():
    """Return functions without arguments that compute one step each."""
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    world, autopilot, x = (to_arrays(v) for v in (scenario.world, scenario.autopilot, scenario.initial))
    key = Key(np.uint32(0), np.uint32(0))
    state, flying = jax.eval_shape(lambda: start(world, autopilot, x, key))
    zeros = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), (Frame(np.int64(0), state.received), flying))
    step = jax.jit(lambda t, s, frame: autopilot.step(t, s, frame))

    def jitted():
        frame, s = zeros
        jax.block_until_ready(step(np.int64(10_000), s, frame))

    compiled = compile_autopilot(scenario)
    return {"compiled C": compiled.step, "jax.jit": jitted}


def took(call):
    """Return the time of one call (s), averaged over CALLS calls."""
    began = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - began) / CALLS


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--markdown", action="store_true", help="print the row for the documentation's table at the end")
    a = p.parse_args()
    print(f"{machine('jax')}\n{load()}")
    calls = programs()
    for call in calls.values():
        took(call)
    times = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            times[name].append(took(call))
    for name, t in times.items():
        print(f"{name:12} {1e6 * np.median(t):8.2f} us a step ({1e6 * min(t):.2f}..{1e6 * max(t):.2f})")
    ratios = np.divide(times["jax.jit"], times["compiled C"])
    x = Ratio(float(np.median(ratios)), float(ratios.min()), float(ratios.max()))
    print(f"ratio        {x}\n{load()}")
    if a.markdown:
        what = "autopilot step called from Python: time of jax.jit / time of compiled C"
        print(row(what, x, "", "python benchmarks/step.py"))
