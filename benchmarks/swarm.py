"""Measure the simulation speed of a swarm by number of craft, and the collision rate of five craft.

python benchmarks/swarm.py                        5, 10, 100 craft: compile time, speed per CPU second, distances
python benchmarks/swarm.py --runs 10000           five craft with random starts: two minutes
"""

import argparse
import time
from typing import Any

import numpy as np

from trimtab import Campaign, build
from trimtab.analysis.campaign.statistics.intervals import proportion
from trimtab.core.time import ms, to_seconds
from trimtab.run.simulate import compile_scenario

TOUCH = 0.64
"""Distance (m) at which two craft touch. Each is a disc with its rudder's arm (0.32 m) as radius."""
SPACING, FORMATION_ERROR = "least:sensors.arena.value.spacing", "final:sensors.arena.value.formation_error"


def starts(scenario: Any, room: float = 0.15) -> dict[str, str]:
    """Return spreads of each craft's start: position up to `room` (m) off in both directions, any heading."""
    spread = {}
    for i in range(len(scenario.initial.north)):
        for name in ("north", "east"):
            x = float(getattr(scenario.initial, name)[i])
            spread[f"initial.{name}[{i}]"] = f"uniform({x - room:.3f}, {x + room:.3f})"
        spread[f"initial.heading[{i}]"] = "uniform(-3.14, 3.14)"
    return spread


def time_swarms() -> None:
    """Print a table with one row for each number of craft."""
    last = "formation error at end (m)"
    print(f"{'craft':>6} {'ready (s)':>10} {'s per CPU s':>16} {'least distance (m)':>19} {last:>26}")
    for n in (5, 10, 100):
        scenario, signals = build("swarm/formation", {"craft": str(n)}), ("sensors.arena",)
        begin = time.perf_counter()
        program = compile_scenario(scenario, signals=signals)
        ready, begin = time.perf_counter() - begin, time.process_time()
        log = program.fly(0, 0, ms(20))
        factor = to_seconds(scenario.duration) / (time.process_time() - begin)
        spacing, formation_error = (log[f"sensors.arena.value.{name}"] for name in ("spacing", "formation_error"))
        print(f"{n:6} {ready:10.1f} {factor:16.1f} {spacing.min():19.2f} {formation_error[-1]:26.2f}", flush=True)


def fly_campaign(runs: int) -> None:
    """Print the share of successful runs, with confidence intervals."""
    scenario = build("swarm/formation")
    metrics = [SPACING, FORMATION_ERROR]
    success = [f"{SPACING} >= {TOUCH}"]
    found = Campaign(
        "swarm/formation", runs=runs, seed=1, spread=starts(scenario), metrics=metrics, success=success
    ).run()
    spacing, formation_error = (np.asarray(found.columns[m]) for m in metrics)
    apart, formed = int((spacing >= TOUCH).sum()), int((formation_error <= 1).sum())
    for what, good in (("never nearer than 0.64 m", apart), ("in formation within 1 m at 60 s", formed)):
        share = proportion(good, runs)
        print(f"{what}: {good} of {runs}, {100 * share.low:.3f} % to {100 * share.high:.3f} % (95 %)")
    print(f"least distance: {spacing.min():.3f} m; a thousandth of the runs below {np.quantile(spacing, 0.001):.3f} m")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, help="fly a campaign with this number of runs instead")
    chosen = parser.parse_args()
    if chosen.runs:
        fly_campaign(chosen.runs)
    else:
        time_swarms()
