"""Whole flights in wall-clock time: two programs over a real transport reach the targets as simulated flights do.

What is compared is the vehicle's own log, in its logged time, from its release on. The band of each number comes from
simulated flights over many seeds with what is left of the line's delay. That isn't one number: commands go out each
20 ms and the servos take them each 20 ms, in whatever phase the two programs happened to start, and an ordinary machine
wakes them late. So there are two simulations, with no delay and with one servo frame (20 ms) on the way up and one look
of the downlink (6 ms) on the way down, and a band reaches from the lower mean of the two to the higher, and four
standard deviations of a flight beyond each: were a flight one of the simulated ones, a normal number would be outside
once in sixteen thousand times.
"""

from typing import NamedTuple

import numpy as np
import pytest
from links.ends import free_port
from links.relays import SerialPair
from live.pair import fly_pair

from trimtab.core.record import replace
from trimtab.core.time import ms, to_seconds
from trimtab.export.compiler import find_compiler
from trimtab.links.delay_chain import DelayChain
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import metrics
from trimtab.run.batch import simulate_batch
from trimtab.scenarios import catalogue

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here"),
]
HOVERCRAFT = sorted(n for n in catalogue.names() if n.startswith("hovercraft/"))
SEEDS, DEVIATIONS = range(100, 160), 4.0
REACHED = 0.03
"""How much earlier or later (s) a target may be reached besides: rows of simulated flights are 10 ms apart, and up to
a servo frame lies between a vehicle's release and its first command."""
NUMBERS = ("first_reach_s", "tail_mean", "tail_rms")


class Band(NamedTuple):
    """Where a number of a flight has to be."""

    low: float
    high: float


def merits(log, targets):
    """(signal, number) -> its value in one flight."""
    found = metrics(log, targets, [t.path for t in targets])
    return {(path, number): found[path][number] for path in found for number in NUMBERS}


def simulated(scenario, targets, steps):
    """The same of each of many flights, with so many unit delays each way."""
    links = {"downlink": DelayChain(period=ms(6), steps=steps), "uplink": DelayChain(period=ms(20), steps=steps)}
    delayed = replace(scenario, world=replace(scenario.world, **links))
    batch = simulate_batch(delayed, seeds=SEEDS, signals=tuple(t.path for t in targets), log=True)
    t = to_seconds(batch.ticks)
    flights = [
        merits(Log(t, batch.ticks, {p: v[k] for p, v in batch.log.items()}, {}, {}, {}), targets)
        for k in range(len(batch.seeds))
    ]
    return {what: np.array([f[what] for f in flights], float) for what in flights[0]}


def bands(scenario, targets):
    """The band of each number; a target that not every simulated flight reaches has none."""
    at_once, late = (simulated(scenario, targets, steps) for steps in (0, 1))
    found = {}
    for what in at_once:
        both = at_once[what], late[what]
        if np.isfinite(both).all():
            low, high = sorted(float(v.mean()) for v in both)
            margin = DEVIATIONS * max(float(v.std(ddof=1)) for v in both)
            margin += REACHED if what[1] == "first_reach_s" else 0.0
            found[what] = Band(low - margin, high + margin)
    return found


def released(log):
    """A vehicle's log from its release on, its time counted from there."""
    after = ~log["firmware.held"].astype(bool)
    ticks = log.ticks[after] - log.ticks[after][0]
    signals = {p: log[p][after] for p in log.paths if p.startswith("truth.")}
    return Log(to_seconds(ticks), ticks, signals, {}, {}, {})


def check(folder, name, navigation, listen, link):
    """Fly it, and compare it."""
    settings = {"navigation": navigation, "supervisor": "automatic"}
    scenario, _ = catalogue.load(name, settings)
    targets = [t for t in scenario.targets if t.path.startswith("truth.")]
    length = f"{to_seconds(scenario.duration)} s"
    both = ("--set", f"navigation={navigation}")
    there, here = fly_pair(folder, name, listen, link, *both, vehicle=("--duration", length))
    assert (there[0], here[0]) == (0, 0), (there, here)
    said = f"{here[1]['deadlines']} {here[1]['line']} {here[2]}"
    flight = released(read_mcap(folder / "there" / "vehicle.mcap"))
    assert flight.t[-1] > to_seconds(scenario.duration) - 0.1, said
    found = merits(flight, targets)
    for target in targets:
        assert found[target.path, "first_reach_s"] is not None, (target, said)
    wanted = bands(scenario, targets)
    assert len(wanted) >= 2 * len(targets)
    print(f"\n{name}, {navigation}")
    for (path, number), band in wanted.items():
        value = found[path, number]
        print(f"  {path:24} {number:14} {value:9.4f}  in {band.low:9.4f} .. {band.high:9.4f}")
    outside = {what: (found[what], band) for what, band in wanted.items() if not band.low <= found[what] <= band.high}
    assert not outside, said


@pytest.mark.parametrize("navigation", ["errors", "ins"])
@pytest.mark.parametrize("name", HOVERCRAFT)
def test_over_udp_targets_are_reached_as_in_simulated_flights(name, navigation, tmp_path):
    port = free_port()
    check(tmp_path, name, navigation, f"udp://127.0.0.1:{port}", f"udp://127.0.0.1:{port}")


def test_over_a_serial_cable_targets_are_reached_as_in_simulated_flights(tmp_path):
    with SerialPair(tmp_path) as cable:
        check(tmp_path, "hovercraft/forward", "errors", *cable.uris)
