"""Vehicle and autopilot as two programs in lockstep over real transports reproduce `simulate` bit for bit."""

import threading

import numpy as np
import pytest
from flight.pair import fly_pair
from flight.transports.ends import free_port
from flight.transports.relays import SerialPair, UdpRelay

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.flight.lockstep import LockstepAutopilot, LockstepVehicle
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.transports.open_link import open_link
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.metrics import metrics
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
SEEDS = {"errors": 1, "ins": 2}
"""Worlds in which every law reaches its targets."""
HOVERCRAFT = sorted(n for n in catalogue.scenario_names() if n.startswith("hovercraft/"))
NAVIGATED = [(n, kind) for n in HOVERCRAFT for kind in SEEDS if kind in catalogue.scenario_choices(n)["navigation"]]
"""Each with what it can navigate by: those that need to know where they are have no model of errors."""


def same(log, simulated, *, age=True):
    """Assert that every signal of a log equals the simulation at every instant of the log."""
    rows = np.searchsorted(simulated.ticks, log.ticks)
    np.testing.assert_array_equal(simulated.ticks[rows], log.ticks)
    compared = [p for p in log.paths if not p.startswith("log.") and not p.endswith(".fresh")]
    assert len(compared) > 10
    for path in compared:
        np.testing.assert_array_equal(log[path], simulated[path][rows], err_msg=path)


def test_lockstep_over_serial_cable_matches_simulation(tmp_path):
    with SerialPair(tmp_path) as cable:
        left, right = cable.uris
        more = ("--lockstep", "--duration", "2", "--seed", "4")
        there, here = fly_pair(tmp_path, "hovercraft/zero-velocity", left, right, *more)
    assert (there[0], here[0]) == (0, 0), (there, here)
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    simulated = simulate(replace(scenario, duration=seconds(2)), seed=4, backend="c")
    logs = [read_mcap(tmp_path / "there" / "vehicle.mcap"), read_mcap(tmp_path / "here" / "flight.mcap")]
    for log in logs:
        assert len(log) == 2000
        same(log, simulated)
    assert dict(logs[0].final) == {p: simulated.final[p] for p in logs[0].final}


def test_lockstep_over_lossy_udp_matches_simulation(tmp_path):
    """One packet in fifty is lost and all are delayed. The results are unchanged."""
    port = free_port()
    with UdpRelay(("127.0.0.1", port), delay=0.001, jitter=0.0005, loss=0.02, seed=1) as relay:
        near, far = f"udp://127.0.0.1:{relay.port}", f"udp://127.0.0.1:{port}"
        there, here = fly_pair(tmp_path, "hovercraft/spin", far, near, "--lockstep", "--duration", "0.5")
    assert (there[0], here[0]) == (0, 0), (there, here)
    scenario, _ = catalogue.load_scenario("hovercraft/spin")
    simulated = simulate(replace(scenario, duration=seconds(0.5)), backend="c")
    assert any(p.delay is None for p in relay.passages)
    for file in ("there/vehicle.mcap", "here/flight.mcap"):
        log = read_mcap(tmp_path / file)
        assert len(log) == 500
        same(log, simulated)


def in_step(scenario, folder, seed, line=None, *, flown=None):
    """Run both ends in this process, over a given link or a loopback. Return the two logs.

    line: vehicle's end, autopilot's end. flown: scenario of the autopilot, if it differs.
    """
    key = passphrase_key("correct-horse-battery-staple")
    name = f"loopback://{folder.name}"
    vehicle = LockstepVehicle(scenario, lambda d: Endpoint(d, 1, 1, key), seed=seed)
    pilot = LockstepAutopilot(flown or scenario, lambda d: Endpoint(d, 1, 191, key), seed=seed)
    there, here = line or (open_link(name, listen=True), open_link(name))
    leading = threading.Thread(target=vehicle.run, args=(there, folder / "vehicle.mcap"))
    leading.start()
    try:
        pilot.run(here, folder / "flight.mcap")
        leading.join()
    finally:
        here.close()
        there.close()
    return read_mcap(folder / "vehicle.mcap"), read_mcap(folder / "flight.mcap")


class LosingLink:
    """A link that loses the packets with given numbers."""

    def __init__(self, link, lost):
        self._link, self._lost, self._count = link, lost, 0

    def __getattr__(self, name):
        return getattr(self._link, name)

    def send(self, packet):
        self._count += 1
        return self._count in self._lost or self._link.send(packet)


def test_lost_packets_are_resent_without_changing_results(tmp_path):
    """Samples and instants of the vehicle and answers of the autopilot are lost once each and resent."""
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    scenario = replace(scenario, duration=seconds(0.1))
    name = f"loopback://{tmp_path.name}-losing"
    there = LosingLink(open_link(name, listen=True), {21, 46, 71, 90})
    vehicle, flight = in_step(scenario, tmp_path, 4, (there, LosingLink(open_link(name), {31})))
    simulated = simulate(scenario, seed=4, backend="c")
    for log in (vehicle, flight):
        assert len(log) == 100
        same(log, simulated)


def test_lost_last_command_is_resent(tmp_path):
    """Every other packet of the autopilot is lost: the first attempt of each command, including the last one."""
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    scenario = replace(scenario, duration=seconds(0.02))
    name = f"loopback://{tmp_path.name}-losing"
    line = open_link(name, listen=True), LosingLink(open_link(name), range(1, 10_000, 2))
    vehicle, flight = in_step(scenario, tmp_path, 4, line)
    simulated = simulate(scenario, seed=4, backend="c")
    for log in (vehicle, flight):
        assert len(log) == 20
        same(log, simulated)


def test_predictor_runs_on_the_autopilot_only(tmp_path):
    """The vehicle runs without a predictor. Predictions appear in the flight's log."""
    plain, flown = (
        replace(build("hovercraft/zero-velocity", {"predictor": word}), duration=seconds(0.5)) for word in ("off", "on")
    )
    vehicle, flight = in_step(plain, tmp_path, 4, flown=flown)
    simulated = simulate(flown, seed=4, backend="c")
    assert any(p.startswith("predictor.state.") for p in flight.paths)
    for log in (vehicle, flight):
        assert len(log) == 500
        same(log, simulated)


@pytest.mark.parametrize(("name", "navigation"), NAVIGATED)
def test_every_hovercraft_scenario_meets_its_targets_in_lockstep(name, navigation, tmp_path):
    """Each metric of the flight equals that of `simulate`."""
    scenario, _ = catalogue.load_scenario(name, {"navigation": navigation})
    seed = SEEDS[navigation]
    vehicle, flight = in_step(scenario, tmp_path, seed)
    simulated = simulate(scenario, seed=seed, backend="c")
    same(vehicle, simulated)
    same(flight, simulated)
    targets = [t for t in scenario.targets if t.path.startswith("truth.")]
    paths = [t.path for t in targets]
    found, wanted = (metrics(log, targets, paths) for log in (vehicle, simulated))
    assert found == wanted
    assert isinstance(vehicle, Log)
    for path in paths:
        assert found[path]["first_reach_s"] is not None, path


def test_lockstep_with_vehicle_bus_matches_simulation(tmp_path):
    """The bus is part of the vehicle; the real link replaces only the radio. Compiling takes a minute."""
    line, chosen = f"udp://127.0.0.1:{free_port()}", {"navigation": "ins", "bus": "slave"}
    more = [word for name, value in chosen.items() for word in ("--set", f"{name}={value}")]
    there, here = fly_pair(tmp_path, "hovercraft/forward", line, line, "--lockstep", "--duration", "2", *more)
    assert (there[0], here[0]) == (0, 0), (there, here)
    scenario, _ = catalogue.load_scenario("hovercraft/forward", chosen)
    simulated = simulate(replace(scenario, duration=seconds(2)), backend="c")
    for file in ("there/vehicle.mcap", "here/flight.mcap"):
        log = read_mcap(tmp_path / file)
        assert len(log) == 2000
        same(log, simulated)
