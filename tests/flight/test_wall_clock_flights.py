"""Whole flights in wall-clock time: two programs over a real transport reach the targets as simulated flights do.

The vehicle's own log is compared, in its logged time, from its release on. The band of each metric comes from
simulated flights over many seeds with the remaining delay of the link. This delay varies: commands are sent each
20 ms and the servos read them each 20 ms, with the random phase of the two programs, and an ordinary machine
wakes them late. So there are two simulations: without delay, and with one servo frame (20 ms) up and one period
of the downlink (6 ms) down. A band reaches from the lower mean of the two to the higher, and four
standard deviations of a flight beyond each. A normally distributed metric of a simulated flight would be outside
once in sixteen thousand flights.
"""

import threading
import time

import pytest
from flight.bands import STALL_S, Links, bands, compared, kept_waiting, released
from flight.pair import fly_pair
from flight.transports.ends import free_port
from flight.transports.relays import SerialPair

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms, to_seconds
from trimtab.links.wire import DelayChain
from trimtab.logs.mcap import read_mcap
from trimtab.scenarios import catalogue

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
HOVERCRAFT = sorted(n for n in catalogue.scenario_names() if n.startswith("hovercraft/"))
KINDS = ("errors", "ins")
NAVIGATED = [(n, kind) for n in HOVERCRAFT for kind in KINDS if kind in catalogue.scenario_choices(n)["navigation"]]
"""Each with what it can navigate by: those that need to know where they are have no model of errors."""
SEEDS = range(100, 160)
WATCHED_S = 0.005
REMAINS = tuple(Links(DelayChain(period=ms(6), steps=n), DelayChain(period=ms(20), steps=n)) for n in (0, 1))
"""What a line in this machine leaves of the delays: nothing, or one unit each way."""


class OwnWaiting:
    """Longest wakeup delay (s) of a thread of this process."""

    longest = 0.0

    def __enter__(self):
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def _watch(self):
        before = time.monotonic()
        while not self._ended.wait(WATCHED_S):
            now = time.monotonic()
            self.longest, before = max(self.longest, now - before - WATCHED_S), now


def check(folder, name, navigation, listen, link, bus="none"):
    """Fly a scenario and compare it with simulated flights."""
    settings = {"navigation": navigation, "supervisor": "automatic", "bus": bus}
    scenario, _ = catalogue.load_scenario(name, settings)
    targets = [t for t in scenario.targets if t.path.startswith("truth.")]
    length = f"{to_seconds(scenario.duration)} s"
    both = ("--set", f"navigation={navigation}", "--set", f"bus={bus}")
    for attempt in range(3):
        own = folder / str(attempt)
        own.mkdir()
        with OwnWaiting() as waiting:  # a cable is a thread of this process, whose waiting neither log shows
            there, here = fly_pair(own, name, listen, link, *both, vehicle=("--duration", length))
        if max(kept_waiting(own), waiting.longest) < STALL_S:
            break
    assert (there[0], here[0]) == (0, 0), (there, here)
    said = f"{here[1]['deadlines']} {here[1]['line']} {here[2]}"
    flight = released(read_mcap(own / "there" / "vehicle.mcap"))
    assert flight.t[-1] > to_seconds(scenario.duration) - 0.1, said
    wanted = bands(scenario, targets, REMAINS, SEEDS)
    assert len(wanted) >= 2 * len(targets)
    print(f"\n{name}, {navigation}")
    assert not compared(flight, targets, wanted), said


@pytest.mark.parametrize(("name", "navigation"), NAVIGATED)
def test_targets_are_reached_over_udp_as_in_simulation(name, navigation, tmp_path):
    port = free_port()
    check(tmp_path, name, navigation, f"udp://127.0.0.1:{port}", f"udp://127.0.0.1:{port}")


def test_targets_are_reached_over_serial_as_in_simulation(tmp_path):
    with SerialPair(tmp_path) as cable:
        check(tmp_path, "hovercraft/forward", "errors", *cable.uris)


def test_targets_are_reached_with_a_slow_vehicle_bus(tmp_path):
    line = f"udp://127.0.0.1:{free_port()}"
    check(tmp_path, "hovercraft/forward", "ins", line, line, bus="slave")
