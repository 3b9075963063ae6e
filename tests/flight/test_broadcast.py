"""Samples go to the autopilot only. Neither the autopilot nor a ground station sees gaps in sequence numbers."""

import pytest
from flight.transports.virtual_line import open_virtual_line

from trimtab.core.time import seconds
from trimtab.flight.broadcast import Broadcast
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.transports.open_link import open_link

KEY = passphrase_key("correct-horse-battery-staple")
HEARTBEAT = {"type": 18, "autopilot": 8}


class Peer:
    def __init__(self, dialect, line, system, component):
        self.endpoint = Endpoint(dialect, system, component, KEY, clock=line.clock.unix)
        self.link = line.call()

    def say(self, name="HEARTBEAT"):
        self.link.send(self.endpoint.pack(name, HEARTBEAT if name == "HEARTBEAT" else {}))

    def hear(self):
        names = []
        while (data := self.link.receive(0.05)) is not None:
            names += [m.name for m in self.endpoint.feed(data)]
        return names


@pytest.fixture
def dialect():
    from flight.mavlink.conftest import made

    return made()


@pytest.fixture
def line(dialect):
    opened = open_virtual_line()
    link = opened.listen()
    endpoint = Endpoint(dialect, 1, 1, KEY, clock=opened.clock.unix)
    peers = tuple(Peer(dialect, opened, *who) for who in ((1, 191), (255, 190), (254, 190)))
    broadcast = Broadcast(endpoint, link, ("COMMAND",))

    def take(now=0):
        while (data := link.receive(0.05)) is not None:
            broadcast.accept_sender(endpoint.feed(data), now)

    yield broadcast, endpoint, take, peers
    for end in (link, *(p.link for p in peers)):
        end.close()


def test_only_autopilot_gets_samples_and_peers_see_no_gaps(line):
    broadcast, endpoint, take, (autopilot, *stations) = line
    for peer in (autopilot, *stations):
        peer.say()
    take()
    assert broadcast.has_autopilot(0)
    for k in range(300):
        broadcast.send_private([endpoint.pack("SAMPLE_EVERY", {"t": k}) for _ in range(3)])
        assert broadcast.send(endpoint.pack("ATTITUDE", {"time_boot_ms": k}))
        if k % 50 == 49:
            assert autopilot.hear().count("SAMPLE_EVERY") == 150
            assert all(peer.hear() == ["ATTITUDE"] * 50 for peer in stations)
    for peer in (autopilot, *stations):
        assert (peer.endpoint.counts.lost, peer.endpoint.counts.refusals) == (0, 0)
    assert endpoint.counts.sent == 1200  # numbered anew is not sent anew


def test_lost_sample_is_counted_only_by_the_autopilot(line):
    broadcast, endpoint, take, (autopilot, station, _) = line
    for peer in (autopilot, station):
        peer.say()
    take()
    for k in range(20):
        packets = [endpoint.pack("SAMPLE_EVERY", {"t": k})]
        broadcast.send_private(packets if k % 4 else [])
        broadcast.send(endpoint.pack("ATTITUDE", {}))
    autopilot.hear(), station.hear()
    assert (autopilot.endpoint.counts.lost, station.endpoint.counts.lost) == (4, 0)


def test_no_samples_are_sent_without_an_autopilot(line):
    broadcast, endpoint, take, (autopilot, station, _) = line
    station.say()
    take()
    assert not broadcast.has_autopilot(0)
    autopilot.say("PING")  # of the vehicle's own system, as `trimtab inject` is, and no autopilot
    take()
    assert not broadcast.has_autopilot(0)
    autopilot.say()
    take()
    assert broadcast.has_autopilot(seconds(10))
    assert not broadcast.has_autopilot(seconds(10) + 1)
    broadcast.send_private([endpoint.pack("SAMPLE_EVERY", {})])
    assert station.hear() == []
    assert autopilot.hear() == ["SAMPLE_EVERY"]


def test_unaccepted_peers_receive_no_packets(line):
    broadcast, endpoint, take, (_, station, _) = line
    station.link.send(b"\xfd garbage")
    take()
    assert broadcast.send(endpoint.pack("ATTITUDE", {})) is False
    assert station.hear() == []


def test_single_peer_link_uses_one_sequence_numbering(dialect):
    ends = open_link("loopback://trimtab-broadcast", listen=True), open_link("loopback://trimtab-broadcast")
    vehicle, peer = Endpoint(dialect, 1, 1, KEY), Endpoint(dialect, 1, 191, KEY)
    broadcast = Broadcast(vehicle, ends[0], ("COMMAND",))
    names = []
    for k in range(50):
        ends[1].send(peer.pack("HEARTBEAT", HEARTBEAT))
        broadcast.accept_sender(vehicle.feed(ends[0].receive(0.2)), 0)
        broadcast.send_private([vehicle.pack("SAMPLE_EVERY", {"t": k})])
        broadcast.send(vehicle.pack("ATTITUDE", {}))
        names += [m.name for _ in range(2) for m in peer.feed(ends[1].receive(0.2))]
    assert names == ["SAMPLE_EVERY", "ATTITUDE"] * 50
    assert peer.counts.lost == 0
    for end in ends:
        end.close()
