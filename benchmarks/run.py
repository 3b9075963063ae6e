"""Time trimtab's walk beside a bare JAX scan and a numpy loop on the same workload, in one run, as ratios.

    python benchmarks/run.py               about a minute; exits with 1 if a result is wrong
    python benchmarks/run.py --rounds 41   steadier medians

The programs run in turn, in a new order each round, on the same input; a ratio is taken within a round, and the median
over the rounds is printed. First calls (tracing and compilation) are kept apart. The workload: benchmarks/README.md.
"""

import argparse
import random
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "reference")]
import hover_jax
import hover_np
import spec
import workload

LOGGED = ("truth", "actuators.thrust", "actuators.rudder", "estimate.state.surge_velocity")
LOGGED += ("estimate.state.sway_velocity", "estimate.state.yaw_rate")


def rounds(programs, count, seed=0):
    """Times per program (s, without the first call), first calls (s), and the largest difference to the reference."""
    order, rng = list(programs), random.Random(seed)
    times, firsts, worst = {n: [] for n in order}, {}, dict.fromkeys(order, 0.0)
    for i in range(count + 1):
        key, found = np.array([spec.KEY0, i], np.uint32), {}
        for name in rng.sample(order, len(order)):
            start = time.perf_counter()
            found[name] = np.asarray(programs[name](np.array(spec.GAINS), key))
            took = time.perf_counter() - start
            if i:
                times[name].append(took)
            else:
                firsts[name] = took
        for name in order:
            worst[name] = max(worst[name], float(np.abs(found[name] - found["JAX scan"]).max()))
    return times, firsts, worst


def main() -> int:
    """Print the table; 1 when a program's result differs from the reference by more than 1e-9."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=15, help="rounds that count (default 15)")
    count = options.parse_args().rounds
    programs = {
        "JAX scan": hover_jax.single,
        "trimtab walk": workload.single,
        "JAX scan, log of 11": scan_with_log(),
        "trimtab walk, log of 11": lambda gains, key: workload.logged(LOGGED)(gains, key)[0],
        "numpy loop": hover_np.single,
    }
    times, firsts, worst = rounds(programs, count)
    print(f"{'one run of 15 s':26}{'median ms':>10}{'us/step':>9}{'x JAX scan':>12}{'first s':>9}{'max diff':>10}")
    for name, t in times.items():
        base = "JAX scan, log of 11" if "log" in name else "JAX scan"
        ratio = np.median(np.divide(t, times[base]))
        ms = 1e3 * np.median(t)
        print(f"{name:26}{ms:10.1f}{ms / spec.N * 1e3:9.2f}{ratio:12.2f}{firsts[name]:9.2f}{worst[name]:10.0e}")
    return int(max(worst.values()) > 1e-9)


def scan_with_log():
    """The bare scan with its own log of 11 numbers per step."""
    import jax
    import jax.numpy as jnp

    @jax.jit
    def flown(gains, key):
        s, log = hover_jax.simulate(gains, key)
        return jnp.concatenate([s.x, s.hx, s.nx]), log

    return lambda gains, key: jax.block_until_ready(flown(gains, key))[0]


if __name__ == "__main__":
    sys.exit(main())
