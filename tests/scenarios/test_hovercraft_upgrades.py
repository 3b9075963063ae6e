"""The upgrades of chapter 7: changed settings, unchanged settings, and documented gains."""

import numpy as np
import pytest

from trimtab.core.record import leaves
from trimtab.core.signals import PlanarForce, new_sample
from trimtab.core.time import ms, seconds
from trimtab.loop.model_mismatch import model_mismatches, vehicle_copies
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

HOVERCRAFT = sorted(n for n in catalogue.scenario_names() if n.startswith("hovercraft/"))


def settings_of(scenario):
    return {path: np.asarray(value) for path, value, _ in leaves(scenario) if not isinstance(value, str | tuple)}


def changed_paths(one, other):
    a, b = settings_of(one), settings_of(other)
    return {p for p in a.keys() | b.keys() if p not in a or p not in b or not np.array_equal(a[p], b[p])}


@pytest.mark.thorough("hovercraft/track")
@pytest.mark.parametrize("name", HOVERCRAFT)
def test_lighter_craft_is_modelled_everywhere_with_same_gyration_radius(name):
    own, lighter = build(name), build(name, {"craft": "lighter"})
    vehicle = lighter.world.vehicle
    assert float(vehicle.mass) == pytest.approx(2.6 - 0.5 * 0.45359237)
    assert float(vehicle.percussion_arm) == pytest.approx(float(own.world.vehicle.percussion_arm))
    assert model_mismatches(lighter.autopilot, vehicle) == []
    assert len(vehicle_copies(lighter.autopilot, vehicle)) == len(vehicle_copies(own.autopilot, own.world.vehicle))
    others = {p for p in changed_paths(own, lighter) if not p.endswith((".mass", ".inertia"))}
    assert others <= {"autopilot.law.reference"}


@pytest.mark.parametrize("name", ["forward", "reverse"])
def test_lighter_craft_keeps_its_reference_speed(name):
    own, lighter = build(f"hovercraft/{name}"), build(f"hovercraft/{name}", {"craft": "lighter"})
    one, other = (float(s.autopilot.law.reference) / float(s.autopilot.law.model.mass) for s in (own, lighter))
    assert other == pytest.approx(one)
    final = simulate(lighter.ideal(), seed=0).final["truth.surge_velocity"]
    assert float(final) == pytest.approx(own.targets[0].value, abs=0.01)


@pytest.mark.thorough
def test_variable_pitch_fan_reverses_thrust_within_one_frame():
    scenario = build("hovercraft/forward", {"fan": "variable-pitch"})
    drive, allocation = scenario.world.actuators, scenario.autopilot.allocation
    for demand in (1.2, -1.2):
        _, command = allocation.step(0, (), PlanarForce(demand, 0.0))
        state, given = drive.init(None), []
        for k in range(2):  # out of full reverse, in the next frame
            there = [allocation.step(0, (), PlanarForce(-1.2, 0.0))[1], command][k]
            state, out = drive.step(np.int64(ms(20) * k), state, new_sample(np.int64(ms(20) * k), there))
            given.append(float(out.u.FX))
        assert given == pytest.approx([-1.2, demand], abs=0.01)
        assert int(out.brakings) == 0


def test_fan_and_link_choices_change_only_their_own_settings():
    own = build("hovercraft/spin")
    fan = changed_paths(own, build("hovercraft/spin", {"fan": "variable-pitch"}))
    assert all(p.startswith(("world.actuators.", "autopilot.allocation.")) for p in fan)
    links = changed_paths(own, build("hovercraft/spin", {"links": "none"}))
    assert all(p.startswith(("world.uplink.", "world.downlink.")) for p in links)


@pytest.mark.thorough
def test_disabled_links_add_no_delay():
    log = simulate(build("hovercraft/spin", {"links": "none"}), seed=0, duration=seconds(1), log_period=ms(1))
    assert log["downlink.navigation.age"].max() == pytest.approx(0.005)
    assert log["uplink.age"].max() == 0


@pytest.mark.thorough
def test_upgrades_improve_flights_as_documented():
    """Medians of 40 flights: a fan without a brake stops the turn sooner; without links forward flight turns less."""

    def fly(name, option, signal):
        batch = simulate_batch(build(name, option), seeds=range(40), signals=(signal,), log=True)
        return np.asarray(batch.ticks) * 1e-7, batch.log[signal]

    stops = []
    for option in ({}, {"fan": "variable-pitch"}, {"craft": "lighter"}):
        t, yaw = fly("hovercraft/zero-velocity", option, "truth.yaw_rate")
        slow = np.abs(yaw) < 0.32
        stops.append(np.median(np.where(slow.any(axis=1), t[slow.argmax(axis=1)], t[-1])))
    assert stops[1] < stops[0] - 1
    assert stops[2] < stops[0] - 0.5
    wanders = []
    for option in ({}, {"links": "none"}, {"predictor": "on"}):
        t, yaw = fly("hovercraft/forward", option, "truth.yaw_rate")
        wanders.append(np.median(yaw[:, t >= 10].std(axis=1)))
    assert wanders[1] < 0.85 * wanders[0]
    assert wanders[2] < 0.85 * wanders[0]
