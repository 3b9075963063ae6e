"""Time a campaign with a store against one call of simulate_batch for the same runs, and measure memory.

python benchmarks/campaign.py

Both fly the zero-velocity scenario with measured links on all cores. Mass, inertia, gains, delay and navigation noise
are drawn at random. The largest yaw rates are compared, run by run. A campaign draws the parameters, logs the rows,
computes metrics and stores them on disk; simulate_batch is given the drawn parameters, and computes statistics of three
signals. Memory is the peak resident memory of a separate process.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from paired import Program, Ratio, load, machine, ratio, rounds, row

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.analysis.campaign.sampling.spread import spread_arrays
from trimtab.analysis.campaign.workers.prepare import draw_runs
from trimtab.core.time import seconds
from trimtab.run.simulate import simulate_batch

COMMAND = "python benchmarks/campaign.py"
SPREAD = {
    "world.vehicle.mass": "normal(100%, 5%)",
    "world.vehicle.inertia": "normal(100%, 10%)",
    "autopilot.law.k1": "uniform(80%, 120%)",
    "autopilot.law.k2": "uniform(80%, 120%)",
    "world.uplink.latency": "uniform(50%, 150%)",
    "world.sensors.navigation.gyro_noise": "uniform(50%, 150%)",
}
SETTINGS = {"links": "measured", "world.uplink.capacity": "32"}
METRICS = [
    f"{kind}:{of}" for of in ("surge_velocity", "sway_velocity", "yaw_rate") for kind in ("settling", "error_rms")
]
COMPARED = "most:yaw_rate"


def campaign(runs: int, seed: int) -> Campaign:
    return Campaign(
        "hovercraft/zero-velocity",
        runs=runs,
        seed=seed,
        spread=SPREAD,
        settings=SETTINGS,
        metrics=[*METRICS, COMPARED],
    )


def stored(runs: int, seed: int) -> Any:
    """Run the campaign, with its rows written to a new store on disk."""
    with tempfile.TemporaryDirectory() as folder:
        return campaign(runs, seed).run(Path(folder) / "rows.zarr").columns[COMPARED]


def worlds(runs: int, seed: int) -> tuple[Any, Any, Any, Any]:
    """Return scenario, random keys, drawn parameters and signals, as the campaign would draw them."""
    ready = campaign(runs, seed).ready
    of, values = draw_runs(ready, 0, runs)
    return ready.scenario, of.words, spread_arrays(ready.spread, ready.scenario, values), ready.logged_signals


class Raw:
    """One call of simulate_batch for all runs. The parameters are drawn before the time is measured."""

    def __init__(self, inputs: list[tuple[int, int]]) -> None:
        self._worlds = {given: worlds(*given) for given in inputs}

    def __call__(self, runs: int, seed: int) -> Any:
        scenario, words, spread, wanted = self._worlds[runs, seed]
        flown = simulate_batch(scenario, seeds=[seed] * runs, runs=words, spread=spread, signals=wanted)
        return flown.most["truth.yaw_rate"]


def compared(runs: int, count: int) -> Ratio | None:
    inputs = [(256, 0), *((runs, seed) for seed in range(1, count + 1))]
    programs = {"campaign": Program(stored, runs), "simulate_batch": Program(Raw(inputs), runs)}
    timed = rounds(programs, inputs, "simulate_batch")
    for name, times in timed.times.items():
        rates = sorted(1 / t for t in times)
        print(f"{name:16} {np.median(rates):8.0f} runs/s ({rates[0]:.0f}..{rates[-1]:.0f})")
    if timed.worst["campaign"]:
        sys.exit(f"WRONG: the campaign's rows differ by {timed.worst['campaign']:g}")
    print("all rows are equal")
    return ratio(timed, "simulate_batch", "campaign")


def resident(runs: int) -> float:
    """Return the peak memory (MB) of a process that runs a campaign with a store."""
    done = subprocess.run([sys.executable, __file__, "--once", str(runs)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def once(runs: int) -> None:
    began = time.perf_counter()
    stored(runs, 1)
    print(f"{runs} runs in {time.perf_counter() - began:.1f} s", file=sys.stderr)
    status = Path("/proc/self/status").read_text()  # getrusage would include the parent's memory at the fork
    print(int(status.split("VmHWM:")[1].split()[0]) / 1024)


def on_gpu(counts: list[int]) -> dict[int, float]:
    """Return number of runs -> runs per second of simulate_batch on JAX's device, in the second call."""
    rates = {}
    for runs in counts:
        scenario, words, spread, _ = worlds(runs, 1)
        asked: dict[str, Any] = {"seeds": [1] * runs, "runs": words, "spread": spread, "log_period": seconds(1)}
        for _ in range(2):
            began = time.perf_counter()
            simulate_batch(scenario, **asked, signals=("truth.yaw_rate",), backend="jax")
            took = time.perf_counter() - began
        rates[runs] = runs / took
        print(f"GPU: {runs} runs, {rates[runs]:.0f} runs/s", flush=True)
    return rates


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=5, help="number of pairs of campaigns (default: 5)")
    p.add_argument("--runs", type=int, default=10_000, help="number of runs of each campaign (default: 10000)")
    p.add_argument("--quick", action="store_true", help="run one small pair, only to check that the program works")
    p.add_argument("--markdown", action="store_true", help="print the rows for the documentation's table at the end")
    p.add_argument("--once", type=int, help=argparse.SUPPRESS)
    a = p.parse_args()
    if a.once:
        once(a.once)
        return
    print(f"{machine('jax', 'zarr')}\n{load()}")
    runs = 300 if a.quick else a.runs
    found = compared(runs, 1 if a.quick else a.rounds)
    print(f"simulate_batch / campaign, time: {found}", flush=True)
    counts = [100, 300] if a.quick else [1_000, 10_000, 100_000]
    memory = {n: resident(n) for n in counts}
    held = ", ".join(f"{n}: {mb:.0f} MB" for n, mb in memory.items())
    print(f"memory by number of runs: {held}\n{load()}")
    gpu = jax.default_backend() == "gpu"
    rates = on_gpu([1_000, 10_000] if a.quick else [10**k for k in range(3, 7)]) if gpu else {}
    best = f"{max(rates.values()):.0f} runs/s" if rates else "not measured: no GPU"
    print(f"GPU: {best}")
    if a.markdown:
        what = f"campaign of {runs} runs with a store: time of simulate_batch / time of the campaign"
        print(row(what, found, "≥ 0.7", COMMAND))
        print(row("campaign: largest memory use for each number of runs", held, "constant", COMMAND))
        print(row("campaign on a GPU, 10³ to 10⁶ runs: highest rate", best, "", COMMAND))


if __name__ == "__main__":
    main()
