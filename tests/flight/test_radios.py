"""Vehicle and autopilot in lockstep over virtual Bluetooth with RFCOMM, L2CAP and HCI of a full stack."""

import pytest

pytest.importorskip("bumble", reason="the virtual Bluetooth radios need: pip install bumble", exc_type=ImportError)

from flight.test_lockstep import in_step, same
from flight.transports.radios import VEHICLE, Radios

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.rfcomm import open_rfcomm
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
URI = f"rfcomm://{VEHICLE}/1"


def test_lockstep_over_virtual_bluetooth_matches_simulation(tmp_path):
    scenario, _ = catalogue.load_scenario("hovercraft/forward")
    scenario = replace(scenario, duration=seconds("0.5"))
    radios = Radios()
    try:
        there = open_rfcomm(parse_uri(URI), listen=True, stack=radios.stack)
        here = open_rfcomm(parse_uri(URI), stack=radios.stack)
        vehicle, flight = in_step(scenario, tmp_path, 4, (there, here))
        carried = there.statistics, here.statistics
    finally:
        radios.close()
    simulated = simulate(scenario, seed=4, backend="c")
    for log in (vehicle, flight):
        assert len(log) == 500
        same(log, simulated)
    assert dict(vehicle.final) == {p: simulated.final[p] for p in vehicle.final}
    assert carried[0].bytes_out == carried[1].bytes_in > 0
    assert carried[1].bytes_out == carried[0].bytes_in > 0
    assert [one.reconnects for one in carried] == [0, 0]
