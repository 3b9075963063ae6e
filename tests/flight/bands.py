"""Accepted bands of a live flight's metrics, from simulated flights over many seeds."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import replace
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import metrics
from trimtab.run.simulate import simulate_batch

DEVIATIONS = 4.0
REACHED = 0.03
"""How much earlier or later (s) a target may be reached besides: rows of simulated flights are 10 ms apart, and up to
a servo frame lies between a vehicle's release and its first command."""
NUMBERS = ("first_reach_s", "tail_mean", "tail_rms")


STALL_S = 0.1
"""A machine that keeps a process with real-time priority waiting for longer is not its own (a virtual one whose host is
busy, or one that tests something else beside); such a flight is made again, up to three times, and the last counts."""


class Band(NamedTuple):
    """Accepted range of one metric of a flight."""

    low: float
    high: float


class Links(NamedTuple):
    """Channel models that replace the link in a simulated flight."""

    downlink: Any
    uplink: Any


def merits(log, targets):
    """(signal, number) -> its value in one flight."""
    found = metrics(log, targets, [t.path for t in targets])
    return {(path, number): found[path][number] for path in found for number in NUMBERS}


def simulated(scenario, targets, links, seeds):
    """(signal, metric) -> array of its values in many simulated flights over these links."""
    delayed = replace(scenario, world=replace(scenario.world, **links._asdict()))
    batch = simulate_batch(delayed, seeds=seeds, signals=tuple(t.path for t in targets), log=True)
    t = to_seconds(batch.ticks)
    flights = [
        merits(Log(t, batch.ticks, {p: v[k] for p, v in batch.log.items()}, {}, {}, {}), targets)
        for k in range(len(batch.seeds))
    ]
    return {what: np.array([f[what] for f in flights], float) for what in flights[0]}


def bands(scenario, targets, links, seeds):
    """Band of each metric, from the fastest and the slowest links. Metrics missing in some flight are left out."""
    quick, slow = (simulated(scenario, targets, one, seeds) for one in links)
    found = {}
    for what in quick:
        both = quick[what], slow[what]
        if np.isfinite(both).all():
            low, high = sorted(float(v.mean()) for v in both)
            margin = DEVIATIONS * max(float(v.std(ddof=1)) for v in both)
            margin += REACHED if what[1] == "first_reach_s" else 0.0
            found[what] = Band(low - margin, high + margin)
    return found


def compared(flight, targets, wanted):
    """Print each metric beside its band. Return the metrics outside their bands."""
    found = merits(flight, targets)
    for target in targets:
        assert found[target.path, "first_reach_s"] is not None, target
    for (path, number), band in wanted.items():
        value = found[path, number]
        print(f"  {path:24} {number:14} {value:9.4f}  in {band.low:9.4f} .. {band.high:9.4f}")
    return {what: (found[what], band) for what, band in wanted.items() if not band.low <= found[what] <= band.high}


def released(log):
    """Return the part of a vehicle's log after its release, with time zero at the release."""
    after = ~log["firmware.held"].astype(bool)
    ticks = log.ticks[after] - log.ticks[after][0]
    signals = {p: log[p][after] for p in log.paths if p.startswith("truth.")}
    return Log(to_seconds(ticks), ticks, signals, {}, {}, {})


def kept_waiting(folder: Path) -> float:
    """Longest wakeup delay (s) of either process, according to both logs."""
    there, here = read_mcap(folder / "there" / "vehicle.mcap"), read_mcap(folder / "here" / "flight.mcap")
    return float(max(there["firmware.late"].max(), here["loop.late"].max()))
