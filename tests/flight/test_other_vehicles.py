"""Lockstep for vehicles other than hovercraft: sensor names with hyphens, slower steps, inertial units."""

import pytest
from flight.test_lockstep import in_step, same

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = [pytest.mark.real_time, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
NAMES = ["f16/gcas", "hypersonic/noise", "navigation/platform-cricket", "navigation/platform-ranging"]
NAMES += ["navigation/still", "quadrotor/track", "torpedo/depth", "vessel/path"]


@pytest.mark.parametrize("name", NAMES)
def test_lockstep_flight_matches_simulation(name, tmp_path):
    scenario, _ = catalogue.load_scenario(name)
    scenario = replace(scenario, duration=seconds("1.5"))
    vehicle, flight = in_step(scenario, tmp_path, 2)
    simulated = simulate(scenario, seed=2, backend="c")
    same(vehicle, simulated)
    same(flight, simulated)
    assert len(flight) == scenario.duration // scenario.autopilot.period
