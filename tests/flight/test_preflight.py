"""Checks of `fly` before it requests arming, with a vehicle played by the test and with a virtual vehicle."""

import re

import pytest
from flight.virtual_pair import LINK, LOG, VirtualPair, events
from run.stand_ins import KEY

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms, seconds
from trimtab.flight import preflight
from trimtab.flight.autopilot import LiveAutopilot
from trimtab.flight.injector import add_idle_faults
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.stamps import running_clock
from trimtab.flight.station.arming import ArmingCheck, pack_checks
from trimtab.flight.station.parameters import Parameters
from trimtab.flight.transports.open_link import open_link
from trimtab.loop.faults import KINDS
from trimtab.scenarios.build import build

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
WELL = ArmingCheck("navigation age", 0.01, 0.28, "s", "switch navigation on")
CONFIRMATION = ArmingCheck("confirmation", 0, 1, "", "type --rearm at fly", at_least=True, heals=False)


class Flyer:
    """An autopilot that has received a healthy vehicle's samples, and a vehicle that sends its checks."""

    def __init__(self, live):
        self.live, self.now = live, 0
        live.remote.arming.confirms, live.remote.system, live.remote.component = False, 1, 1
        live.remote.checks.__init__()
        self.vehicle = Endpoint(live.endpoint.dialect, 1, 1, KEY)
        counts = live.endpoint.counts
        self.preflight = preflight.Preflight(live.scenario, live.autopilot_end, live.remote, counts)
        step = live.autopilot_end.step
        for path, value in (("estimate.valid", 1), ("estimate.age", 0.01), ("command.valid", 1)):
            step.outputs[step.writes[path]] = value

    def run(self, duration, *checks):
        """Advance the time, with a vehicle that answers each request. Return True if arming may be requested."""
        may_arm = False
        for _ in range(0, duration, ms(10)):
            self.now += ms(10)
            self.live.endpoint.counts.accepted += 1
            if checks and self.live.remote.checks.is_due(self.now):
                (question,) = self.vehicle.feed(self.live.endpoint.pack("COMMAND_LONG", {"command": 401}))
                for packet in pack_checks(self.vehicle, question, checks):
                    for message in self.live.endpoint.feed(packet):
                        self.live.remote.handle_message(message, self.now)
            may_arm |= self.preflight.update(self.now, ms(5))
        return may_arm


@pytest.fixture(scope="module")
def live():
    link = open_link("loopback://test-preflight-alone")
    yield LiveAutopilot(build("hovercraft/zero-velocity", {}), link, lambda d: Endpoint(d, 1, 191, KEY))
    link.close()


@pytest.fixture
def flyer(live):
    return Flyer(live)


def test_healthy_vehicle_may_be_armed_within_half_a_second(flyer):
    assert flyer.run(ms(500), WELL)
    assert (flyer.preflight.refusal, flyer.preflight.obstacle) == ("", "")
    lines = flyer.preflight.table.splitlines()
    assert lines[1].split() == ["vehicle", "navigation", "age", "0.01", "s", "at", "most", "0.28", "s", "ok"]
    assert len({line.index("  at ") for line in lines[1:]}) == 1  # aligned
    assert [c["name"] for c in flyer.preflight.describe_checks()][:2] == ["navigation age", "estimate valid"]


def test_arming_is_refused_while_estimate_is_invalid(flyer):
    step = flyer.live.autopilot_end.step
    step.outputs[step.writes["estimate.valid"]] = 0
    assert not flyer.run(seconds(3), WELL)
    assert flyer.preflight.obstacle == "estimate valid: 0, at least 1; check the vehicle's sensors"
    assert flyer.preflight.refusal == ""
    flyer.run(seconds(8), WELL)
    assert flyer.preflight.refusal == f"arming refused: {flyer.preflight.obstacle}"


def test_obstacle_is_reported_once_and_table_at_decision(flyer):
    said = []
    for _ in range(3):
        flyer.run(seconds(1), WELL._replace(value=9.0))
        flyer.preflight.report(said.append)
    assert said == ["not armed yet: navigation age: 9 s, at most 0.28 s; switch navigation on"]
    flyer.run(seconds(1), WELL)
    flyer.preflight.report(said.append)
    flyer.preflight.report(said.append)
    assert said[1:] == flyer.preflight.table.splitlines()


def test_vehicle_that_reports_no_checks_may_be_armed(flyer):
    assert not flyer.run(seconds(1))
    flyer.live.remote.checks.handle_refusal()
    assert flyer.run(seconds(1))


def test_arming_is_refused_until_required_confirmation_is_given(live):
    flyer = Flyer(live)
    assert not flyer.run(seconds(1), WELL, CONFIRMATION)
    assert flyer.preflight.refusal == "arming refused: confirmation: 0, at least 1; type --rearm at fly"
    flyer = Flyer(live)
    live.remote.arming.confirms = True
    assert flyer.run(seconds(1), WELL, CONFIRMATION)
    assert "confirmed" in flyer.preflight.table


@pytest.mark.thorough
def test_arming_without_sensor_is_refused_and_reported_everywhere():
    """Pilot, ground station and both logs get the same sentence. Regression: the vehicle was armed."""
    scenario = build("hovercraft/zero-velocity", {})
    pair = VirtualPair(scenario)

    def serve(machine):
        vehicle = pair.make_vehicle(machine, add_idle_faults(scenario))
        assert vehicle.parts.station.status.arming_problem == "the checks have not run yet"
        vehicle.body.world.parameters["world.sensors.navigation.fault.kind"].flat[0] = KINDS.index("off")
        return vehicle.serve(log=LOG, stop=pair.has_autopilot_ended, tell=pair.told.append)

    pair.serving = pair.there.start(serve)
    pair.start_autopilot()
    pair.run()
    flight, said = pair.flying.result, pair.said
    assert (flight.arming_time, pair.vehicle.release_time) == (None, None)
    assert 10.0 < pair.time.seconds < 13.0
    sentence = "arming refused: navigation age: ∞ s, at most 0.28 s; switch navigation on"
    assert flight.problems == (sentence, "the vehicle was never armed")
    assert f"ended: {sentence}" in said
    here, there = map(events, pair.logs())
    assert any(re.fullmatch(r"vehicle +navigation age +∞ s +at most 0.28 s +REFUSED", e) for e in here)
    assert f"autopilot: {sentence}" in there


def test_setting_changed_during_checks_prevents_arming():
    """Regression: settings were compared before the change, and the vehicle flew with another mass."""
    pair = VirtualPair(build("hovercraft/zero-velocity", {}))
    pair.start_vehicle()

    def fly(flyer, machine):
        listed = Parameters(pair.vehicle.scenario.world, "world").listed
        name = next(p.name for p in listed if p.path == "world.vehicle.mass")
        station = Endpoint(flyer.endpoint.dialect, 255, 190, KEY, datagrams=True, clock=running_clock(machine.clock))
        fields = {"target_system": 1, "param_id": name, "param_value": 4.5, "param_type": 9}
        machine.open_link(LINK).send(station.pack("PARAM_SET", fields))
        return flyer.fly(log=LOG, tell=pair.said.append, duration=seconds(1))

    pair.start_autopilot(fly)
    pair.run()
    assert (pair.flying.result.arming_time, pair.vehicle.release_time) == (None, None)
    assert "world.vehicle.mass = 4.5" in " ".join(pair.told)
    assert "settings that differ: 1, at most 0; --accept world.vehicle.mass" in pair.flying.result.problems[0]


def test_setting_changed_during_arming_request_prevents_arming():
    """Regression: the vehicle refused once. Then the autopilot read the new settings and used their number."""
    pair = VirtualPair(build("hovercraft/zero-velocity", {}))
    pair.start_vehicle()

    def fly(flyer, machine):
        listed = Parameters(pair.vehicle.scenario.world, "world").listed
        name = next(p.name for p in listed if p.path == "world.vehicle.mass")
        station = Endpoint(flyer.endpoint.dialect, 255, 190, KEY, datagrams=True, clock=running_clock(machine.clock))
        fields = {"target_system": 1, "param_id": name, "param_value": 4.5, "param_type": 9}
        arm = flyer.remote.arming.arm

        def change_and_arm(**how):
            if not flyer.remote.arming.is_asking:
                machine.open_link(LINK).send(station.pack("PARAM_SET", fields))
            arm(**how)

        flyer.remote.arming.arm = change_and_arm
        return flyer.fly(log=LOG, tell=pair.said.append, duration=seconds(1))

    pair.start_autopilot(fly)
    pair.run()
    assert "world.vehicle.mass = 4.5" in " ".join(pair.told)
    assert (pair.flying.result.arming_time, pair.vehicle.release_time) == (None, None)
    assert "settings that differ: 1, at most 0; --accept world.vehicle.mass" in pair.flying.result.problems[0]
