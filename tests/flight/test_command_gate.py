"""Authority of two autopilots with the key over one vehicle, message by message."""

import pytest
from flight.mavlink.line import every
from run.stand_ins import KEY, Link, dialect

from trimtab.core.time import ms, seconds
from trimtab.flight.command_gate import MOST_COMMAND_LEAD, CommandGate
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import ArmRequest
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.station.parameters import Parameters
from trimtab.flight.station.standard_services import Station
from trimtab.vehicles.hovercraft import Hovercraft

_, DIALECT = dialect({"compass": every()}, every())
OFFSET = 5_000_000_000


class Autopilot:
    def __init__(self, vehicle):
        self.end, self.link, self.said = Endpoint(DIALECT, 1, 191, unsigned=True), Link(), []
        self.remote = RemoteVehicle(self.end, self.link, typed="trimtab fly it", tell=self.said.append)
        vehicle.autopilots.append(self)


class Vehicle:
    """A vehicle that arms and disarms at once on request. Each packet goes to every autopilot."""

    def __init__(self, *autopilots):
        self.end, self.link = Endpoint(DIALECT, 1, 1, unsigned=True), Link()
        self.station = Station(self.end, Parameters(Hovercraft(), "world.vehicle"), {15: "computer"})
        self.said, self.autopilots, self.now, self.armed, self.obeyed = [], list(autopilots), 0, False, []
        self.gate = CommandGate(self.station, self.link, self.said.append)

    def send(self, packets):
        for packet in packets:
            for each in self.autopilots:
                for message in each.end.feed(packet):
                    each.remote.handle_message(message, self.now)

    def hear(self, packet):
        for message in self.end.feed(packet):
            if message.name == "COMMAND":
                if self.gate.admits(message, self.now + OFFSET):
                    self.obeyed.append(message.get("session"))
                continue
            response = self.station.handle_message(message, self.now + OFFSET)
            self.send(response.replies)
            for event in response.events:
                self.armed = event.arm if isinstance(event, ArmRequest) else self.armed

    def run(self, duration):
        for _ in range(0, duration, ms(10)):
            self.now += ms(10)
            for each in self.autopilots:
                each.remote.due(self.now)
                sent, each.link.sent[:] = list(each.link.sent), []
                for packet in sent:
                    self.hear(packet)
            self.gate.follow(self.armed)
            self.station.status = self.station.status._replace(armed=self.armed)
            self.send(self.station.due(self.now + OFFSET))
            sent, self.link.sent[:] = list(self.link.sent), []
            self.send(sent)

    def command(self, autopilot, ahead=0):
        fields = {"t": self.now + OFFSET + ahead, "valid": 1, "session": autopilot.end.session}
        self.hear(autopilot.end.pack("COMMAND", fields))


@pytest.fixture
def vehicle():
    return Vehicle()


def join(vehicle):
    autopilot = Autopilot(vehicle)
    vehicle.run(seconds(2))
    assert autopilot.remote.is_ready
    return autopilot


def test_second_autopilot_with_key_is_refused_authority(vehicle):
    """Regression: both were obeyed, with 101 commands a second and 95 jumps of the rudder."""
    first, second = join(vehicle), join(vehicle)
    for each in (first, second):
        each.remote.arming.arm()
        vehicle.run(ms(600))
    assert (first.remote.arming.has_authority, second.remote.arming.has_authority) == (True, False)
    assert second.remote.arming.is_taken
    assert second.remote.arming.owner == first.end.session
    for _ in range(50):
        vehicle.now += ms(20)
        for each in (second, first):
            vehicle.command(each)
    assert set(vehicle.obeyed) == {first.end.session}
    assert len(vehicle.obeyed) == 50
    assert vehicle.gate.counts == (first.end.session, 50, 0)
    assert [s for s in vehicle.said if "without authority" in s] == [
        f"commands without authority refused, from 1/191 session {second.end.session:06x}: "
        f"owner is 1/191 session {first.end.session:06x}"
    ]


def test_autopilot_cannot_disarm_another_autopilots_vehicle(vehicle):
    first, second = join(vehicle), join(vehicle)
    first.remote.arming.arm()
    vehicle.run(ms(600))
    second.remote.arming.disarm()
    vehicle.run(ms(600))
    assert vehicle.armed
    assert not second.remote.arming.is_asking  # it has been answered: it is not its business
    assert any("Disarming by" in s and "refused" in s for s in first.said)
    first.remote.arming.disarm()
    vehicle.run(ms(300))
    assert not vehicle.armed
    second.remote.arming.arm()
    vehicle.run(ms(600))
    assert second.remote.arming.has_authority


def test_ground_station_can_disarm_any_flight(vehicle):
    first = join(vehicle)
    first.remote.arming.arm()
    vehicle.run(ms(600))
    station = Endpoint(DIALECT, 255, 190, unsigned=True)
    vehicle.hear(station.pack("COMMAND_LONG", {"command": 400, "param1": 0.0, "target_system": 1}))
    assert not vehicle.armed


def test_takeover_transfers_authority_and_informs_both_autopilots(vehicle):
    first, second = join(vehicle), join(vehicle)
    first.remote.arming.arm()
    vehicle.run(ms(600))
    second.remote.arming.arm(takes_over=True)
    vehicle.run(ms(600))
    assert (first.remote.arming.has_authority, second.remote.arming.has_authority) == (False, True)
    assert first.remote.arming.is_taken
    assert any(f"belongs to another autopilot now, session {second.end.session:06x}" in s for s in first.said)
    vehicle.command(first)
    vehicle.command(second)
    assert vehicle.obeyed == [second.end.session]


def test_two_vehicles_on_one_link_are_detected():
    """Regression: both were armed."""
    one, other = Vehicle(), Vehicle()
    autopilot = Autopilot(one)
    other.autopilots.append(autopilot)
    for _ in range(40):
        one.now += ms(50)
        other.now = one.now - ms(7)
        autopilot.remote.due(one.now)
        sent, autopilot.link.sent[:] = list(autopilot.link.sent), []
        for packet in sent:
            one.hear(packet)
            other.hear(packet)
        for each in (one, other):
            each.send(each.station.due(each.now))
    assert not autopilot.remote.is_ready
    assert "two vehicles answer on this link as 1/1" in autopilot.remote.find_problem("it").problem


def test_arm_request_arms_only_the_addressed_vehicle():
    one, other = Vehicle(), Vehicle()
    autopilot = join(one)
    autopilot.remote.arming.arm()
    autopilot.remote.due(one.now + seconds(1))
    for packet in autopilot.link.sent:
        one.hear(packet)
        other.hear(packet)
    assert (one.armed, other.armed) == (True, False)


def test_command_with_future_time_stamp_is_rejected_alone(vehicle):
    """Regression: the failsafe refused 24 good commands older than the wrong one, and tripped."""
    first = join(vehicle)
    first.remote.arming.arm()
    vehicle.run(ms(600))
    for k in range(40):
        vehicle.now += ms(20)
        vehicle.command(first, ahead=ms(490) if k == 20 else 0)
    assert len(vehicle.obeyed) == 39
    assert vehicle.gate.counts[2] == 1
    assert any("of another clock refused" in s and "0.49 s ahead" in s for s in vehicle.said)
    assert ms(490) > MOST_COMMAND_LEAD


def test_endpoints_with_same_key_have_different_sessions():
    assert Endpoint(DIALECT, 1, 191, KEY).session != Endpoint(DIALECT, 1, 191, KEY).session
