"""UDP links: peers answered by a listening end. Most tests use a virtual network, two the kernel's sockets."""

import socket

import pytest
from flight.transports.ends import PATIENCE, free_port
from flight.transports.virtual_line import run_in_virtual_time

from trimtab.core.interfaces import Audience
from trimtab.flight.transports.open_link import open_link
from trimtab.flight.transports.udp import MOST_PEERS
from trimtab.flight.virtual_network import MOST_WAITING


def greet(server, *peers, is_private=False):
    """Let the server accept a packet of each peer."""
    for peer in peers:
        peer.send(b"here")
        assert server.receive(1.0) == b"here"
        server.accept_sender(is_private=is_private)


def test_answers_peers_accepted_within_ten_seconds():
    def body(line):
        server, peers = line.listen(), [line.call() for _ in range(3)]
        assert server.send(b"to nobody") is False
        greet(server, *peers[:2])
        assert server.send(b"to two")
        assert [peer.receive(0.1) for peer in peers] == [b"to two", b"to two", None]
        line.pause(8.0)
        assert len(server.peers) == 2
        greet(server, peers[0])
        line.pause(2.5)
        assert len(server.peers) == 1
        assert server.send(b"to one")
        assert [peer.receive(0.1) for peer in peers[:2]] == [b"to one", None]
        line.pause(20.0)
        assert not server.statistics.connected
        assert server.send(b"late") is False
        greet(server, peers[1])
        assert (server.statistics.reconnects, server.statistics.connected) == (1, True)
        assert server.statistics.dropped == 2

    run_in_virtual_time(body)


def test_receive_waits_for_its_timeout_and_no_longer():
    def body(line):
        server, peer = line.listen(), line.call()
        began = line.time.now
        assert server.receive(0.25) is None
        assert line.time.now - began == 250_000_000
        assert server.receive(0.0) is None
        assert line.time.now - began == 250_000_000
        peer.send(b"x")
        assert server.receive(0.25) == b"x"
        assert line.time.now - began == 250_200_000
        assert (server.statistics.bytes_in, server.statistics.packets_in) == (1, 1)

    run_in_virtual_time(body)


def test_empty_packets_are_skipped():
    def body(line):
        server, peer = line.listen(), line.call()
        peer.send(b"")
        peer.send(b"x")
        assert server.receive(1.0) == b"x"
        server.accept_sender()
        assert server.statistics.packets_in == 1

    run_in_virtual_time(body)


def test_strangers_never_evict_known_peers():
    def body(line):
        server, peers = line.listen(), [line.call() for _ in range(MOST_PEERS + 3)]
        greet(server, *peers)
        assert len(server.peers) == MOST_PEERS
        assert server.send(b"x")
        assert [peer.receive(0.01) for peer in peers] == [b"x"] * MOST_PEERS + [None] * 3

    run_in_virtual_time(body)


def test_strangers_receive_no_packets():
    def body(line):
        server, friend = line.listen(), line.call()
        strangers = [line.call() for _ in range(MOST_PEERS + 3)]
        for stranger in strangers:
            stranger.send(b"let me in")
            assert server.receive(1.0) == b"let me in"
            assert server.send(b"secret") is False
        assert server.peers == ()
        assert not server.statistics.connected
        greet(server, friend)
        strangers[0].send(b"me too")
        assert server.receive(1.0) == b"me too"
        assert server.send(b"secret")
        assert friend.receive(0.1) == b"secret"
        assert [s.receive(0.01) for s in strangers] == [None] * len(strangers)

    run_in_virtual_time(body)


def test_each_packet_accepts_its_sender_once():
    def body(line):
        server, friend = line.listen(), line.call()
        server.accept_sender()  # nothing was received
        assert server.peers == ()
        greet(server, friend)
        line.pause(11.0)
        server.accept_sender()
        assert server.peers == ()

    run_in_virtual_time(body)


def test_private_packets_reach_only_private_peers():
    def body(line):
        server, autopilot, station = line.listen(), line.call(), line.call()
        greet(server, autopilot, is_private=True)
        greet(server, station)
        assert server.has_audience(Audience.PRIVATE)
        assert server.has_audience(Audience.PUBLIC)
        assert server.send(b"sample", Audience.PRIVATE)
        assert server.send(b"telemetry", Audience.PUBLIC)
        assert [autopilot.receive(0.1), autopilot.receive(0.1)] == [b"sample", None]
        assert [station.receive(0.1), station.receive(0.1)] == [b"telemetry", None]
        line.pause(9.0)
        greet(server, station)
        line.pause(2.0)
        assert not server.has_audience(Audience.PRIVATE)
        assert server.send(b"sample", Audience.PRIVATE) is False

    run_in_virtual_time(body)


def test_a_calling_end_sends_private_packets_and_no_public_ones():
    def body(line):
        server, client = line.listen(), line.call()
        assert client.send(b"private", Audience.PRIVATE)
        assert client.send(b"public", Audience.PUBLIC) is False
        assert server.receive(0.1) == b"private"
        assert server.receive(0.1) is None

    run_in_virtual_time(body)


def test_reply_reaches_only_the_stranger_without_accepting_it():
    def body(line):
        server, known, stranger = line.listen(), line.call(), line.call()
        assert server.reply(b"to nobody") is False
        greet(server, known)
        stranger.send(b"who?")
        assert server.receive(1.0) == b"who?"
        assert server.reply(b"not you")
        assert server.send(b"all")
        assert [stranger.receive(0.1), stranger.receive(0.1)] == [b"not you", None]
        assert known.receive(0.1) == b"all"

    run_in_virtual_time(body)


def test_a_closed_link_receives_and_sends_nothing():
    def body(line):
        server, client = line.listen(), line.call()
        server.close()
        assert (server.fileno(), server.receive(1.0)) == (-1, None)
        assert client.send(b"x")
        client.close()
        assert client.send(b"x") is False
        assert line.time.now == 0

    run_in_virtual_time(body)


def test_a_full_socket_loses_packets():
    def body(line):
        server, client = line.listen(), line.call()
        for k in range(MOST_WAITING + 5):
            client.send(b"%d" % k)
        line.pause(1.0)
        received = [server.receive(0.0) for _ in range(MOST_WAITING + 1)]
        assert received == [b"%d" % k for k in range(MOST_WAITING)] + [None]
        assert server._socket.overflowed == 5

    run_in_virtual_time(body)


@pytest.mark.real_time
def test_kernel_sockets_carry_packets_both_ways():
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server, client = open_link(uri, listen=True), open_link(uri)
    client.send(b"here")
    assert server.receive(PATIENCE) == b"here"
    server.accept_sender()
    assert server.send(b"there")
    assert client.receive(PATIENCE) == b"there"
    assert client.receive(0.0) is None
    for link in (server, client):
        link.close()


@pytest.mark.real_time
def test_calling_socket_receives_only_from_its_peer():
    port = free_port(socket.SOCK_DGRAM)
    client = open_link(f"udp://127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"command", ("127.0.0.1", client._socket.getsockname()[1]))
        assert client.receive(0.1) is None
    client.close()
