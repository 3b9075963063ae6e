"""The hovercraft with ultrasonic units behind a slow bus: later samples, same targets."""

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.logs.metrics import metrics
from trimtab.run.program import describe_scenario
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue
from trimtab.scenarios.recorded import rebuild_scenario

HOVERCRAFT = sorted(n for n in catalogue.scenario_names() if n.startswith("hovercraft/"))
compiled = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


def flown(name, bus, seed=3):
    scenario, _ = catalogue.load_scenario(name, {"navigation": "ins", "bus": bus})
    return scenario, simulate(scenario, seed=seed, backend="c")


def reached(scenario, log):
    """Return the time at which each target is first reached."""
    targets = [t for t in scenario.targets if t.path.startswith("truth.")]
    found = metrics(log, targets, [t.path for t in targets])
    return {path: found[path]["first_reach_s"] for path in found}


@pytest.fixture(scope="module")
def forward():
    return flown("hovercraft/forward", "slave")


def arrivals(log, end):
    """Return the arrival times of pings, by the time of the ping."""
    rows = np.flatnonzero(log[f"{end}.ranging.fresh"])
    return dict(zip(log[f"{end}.ranging.t"][rows].tolist(), log.ticks[rows].tolist(), strict=True))


@compiled
@pytest.mark.thorough
def test_forward_reaches_its_targets(forward):
    scenario, log = forward
    assert all(time is not None for time in reached(scenario, log).values())
    # as by its own navigation without the bus (docs, Scenarios): well inside a tenth of its band by the end
    tail = log.t > 12
    assert np.abs(log["truth.surge_velocity"][tail] - 2.8 / 2.6).max() < 0.1


@compiled
@pytest.mark.thorough
def test_bus_delays_each_ping_by_its_transfer_time(forward):
    """24 bytes: three slots of 10 ms, the last with 4 bytes and an address, 0.45 ms; received at the next ms."""
    _, log = forward
    _, before = flown("hovercraft/forward", "none")
    late, early = arrivals(log, "sensors"), arrivals(before, "sensors")
    first = sorted(set(late) & set(early))[:10]  # while both are where they were, so that replies are the same
    assert len(first) == 10
    for ping in first:
        slot = -(-early[ping] // ms(10)) * ms(10)
        assert late[ping] == slot + ms(20) + ms(1), ping
    fresh = log["sensors.ranging.fresh"].astype(bool)
    ages = log["sensors.ranging.age"][fresh]
    np.testing.assert_allclose(ages, (log.ticks - log["sensors.ranging.t"])[fresh] * 1e-7, atol=1e-12)
    usual = before["sensors.ranging.age"][before["sensors.ranging.fresh"].astype(bool)]
    assert 0.020 < ages.mean() - usual.mean() < 0.031
    down = log["downlink.ranging.age"][log["downlink.ranging.fresh"].astype(bool)]
    assert 0.036 < down.mean() - ages.mean() < 0.043  # the radio's 36 ms come on top, and its look each 6 ms


@compiled
@pytest.mark.thorough
def test_bus_drops_no_ping(forward):
    _, log = forward
    pings = sorted(arrivals(log, "sensors"))
    assert set(np.diff(pings)) == {ms(100)}


def test_log_is_rebuilt_with_its_bus():
    """`replay` rebuilds the bus; this test compares names and runs no simulation."""
    scenario, _ = catalogue.load_scenario("hovercraft/spin", {"navigation": "ins", "bus": "slave"})
    log = Log(np.zeros(1), np.zeros(1, np.int64), {"truth.north": np.zeros(1)}, {}, describe_scenario(scenario), {})
    assert type(rebuild_scenario(log).world.sensors["ranging"]).__name__ == "RelayedSensor"


def test_rejects_the_bus_with_the_error_model():
    with pytest.raises(InputError, match="the bus carries ultrasonic samples") as refused:
        catalogue.load_scenario("hovercraft/forward", {"bus": "slave"})
    assert 'navigation="ins"' in refused.value.fix


@compiled
@pytest.mark.thorough
@pytest.mark.parametrize("name", HOVERCRAFT)
def test_every_hovercraft_scenario_reaches_its_targets(name):
    """Each takes half a minute to compile."""
    scenario, log = flown(name, "slave")
    assert all(time is not None for time in reached(scenario, log).values())
