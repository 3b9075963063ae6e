"""The autopilot's link: clock synchronisation, command times, and queued packets."""

from itertools import pairwise
from types import SimpleNamespace

from trimtab.core.time import ms, seconds
from trimtab.flight.command_sender import CommandSender
from trimtab.flight.exchange import GroupSample
from trimtab.flight.mavlink.time_sync import TimeSync
from trimtab.flight.real_time import DISCARD_LIMIT, discard_packets
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.vehicle_clock import QUICK_ANSWERS
from trimtab.flight.vehicle_receiver import VehicleReceiver

OFFSET = 98_765_432
VEHICLE = {"system": 1, "component": 1}
FINGERPRINT = b"abcdefgh"


class Line:
    """A link with a number of waiting packets."""

    def __init__(self, waiting=0):
        self.waiting, self.sent = waiting, []

    def receive(self, timeout):
        assert timeout == 0.0
        self.waiting -= 1
        return b"x" if self.waiting >= 0 else None

    def send(self, packet):
        self.sent.append(packet)
        return True


def answered(remote, now, up, down):
    asked = remote.clock.sync.ask(now)
    fields = {"tc1": (now + up + OFFSET) * 100, "ts1": asked["ts1"]}
    remote.handle_message(SimpleNamespace(name="TIMESYNC", **VEHICLE, get=fields.get), now + up + down)


def heartbeat(remote, now):
    fields = {"base_mode": 0, "autopilot": 0}
    remote.handle_message(SimpleNamespace(name="HEARTBEAT", **VEHICLE, get=fields.get), now)


def same_messages(remote, now):
    fields = {"flight_custom_version": FINGERPRINT, "uid": 1}
    remote.handle_message(SimpleNamespace(name="AUTOPILOT_VERSION", **VEHICLE, get=fields.get), now)


def test_queued_answers_do_not_synchronise_the_clock():
    """Regression: eight requests waited for a booting vehicle, its clock offset was 0.3 s wrong, and it was armed."""
    endpoint = SimpleNamespace(pack=lambda *_: b"", dialect=SimpleNamespace(fingerprint=FINGERPRINT))
    remote = RemoteVehicle(endpoint, Line())
    heartbeat(remote, 0)
    same_messages(remote, 0)
    for k in range(QUICK_ANSWERS):
        answered(remote, ms(50 * k), seconds(1) - ms(50 * k), ms(1))
    assert not remote.is_ready
    answered(remote, seconds(2), ms(1), ms(1))
    assert remote.is_ready
    assert abs(remote.clock.offset(seconds(2)) - OFFSET) < ms(5)


def test_command_times_increase_after_a_clock_offset_correction():
    """A vehicle rejects commands older than the last one; an offset 0.3 s too large once stopped it."""
    stamps, sync = [], TimeSync()
    end = SimpleNamespace(command_packets=lambda _, ahead: stamps.append(ahead) or [])
    sender = CommandSender(end, None, Line(), sync)
    times = [ms(20 * k) for k in range(40)]
    for t in times:
        sender.send(t, OFFSET + (seconds("0.3") if t < ms(100) else 0))
    issued = [t + ahead for t, ahead in zip(times, stamps, strict=True)]
    assert all(b > a for a, b in pairwise(issued))
    assert issued[-1] == times[-1] + OFFSET
    sync.jumps += 1  # another clock: a vehicle that was started again counts from zero
    sender.send(ms(800), 0)
    assert ms(800) + stamps[-1] == ms(800)


def test_newest_of_simultaneous_commands_is_used_in_any_order():
    """The failsafe rejects commands older than the last; used in order of arrival, the newer one would be lost."""
    for times in ((20, 40), (40, 20)):
        parts = SimpleNamespace(
            broadcast=SimpleNamespace(accept_sender=lambda messages, now: None),
            endpoint=SimpleNamespace(feed=lambda data: [SimpleNamespace(name="COMMAND", t=t) for t in data]),
            command=SimpleNamespace(names=("COMMAND",), assemble=lambda m: GroupSample(m.t, [], [], 0)),
            gate=SimpleNamespace(admits=lambda message, now: True),
            refusals=SimpleNamespace(handle_refusals=lambda now: None),
            parameters=SimpleNamespace(listed=[]),
        )
        receiver = VehicleReceiver(parts, SimpleNamespace(now=lambda: 0))
        receiver.handle_data(times)
        assert receiver.take_command().t == 40


def test_discards_a_limited_number_of_waiting_packets():
    assert discard_packets(Line(3)) == 3
    assert discard_packets(Line(10**9)) == DISCARD_LIMIT
