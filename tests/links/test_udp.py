import socket
import time

import pytest
from links.ends import PATIENCE, free_port

from trimtab.links import udp
from trimtab.links.open_link import open_link
from trimtab.links.udp import MOST_PEERS

pytestmark = pytest.mark.real_time


def test_udp_answers_those_it_has_heard_lately_and_nobody_else(monkeypatch):
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server = open_link(uri, listen=True)
    assert server.send(b"to nobody") is False
    peers = [open_link(uri) for _ in range(3)]
    for peer in peers[:2]:
        peer.send(b"here")
        assert server.receive(PATIENCE) == b"here"
        server.accept_sender()
    assert server.send(b"to two")
    assert [peer.receive(PATIENCE) for peer in peers[:2]] == [b"to two"] * 2
    assert peers[2].receive(0.05) is None
    real = time.monotonic
    monkeypatch.setattr(udp.time, "monotonic", lambda: real() + 9.0)
    assert len(server.peers) == 2
    peers[0].send(b"again")
    assert server.receive(PATIENCE) == b"again"
    server.accept_sender()
    monkeypatch.setattr(udp.time, "monotonic", lambda: real() + 11.0)
    assert len(server.peers) == 1
    assert server.send(b"to one")
    assert peers[0].receive(PATIENCE) == b"to one"
    assert peers[1].receive(0.05) is None
    monkeypatch.setattr(udp.time, "monotonic", lambda: real() + 30.0)
    assert not server.statistics.connected
    assert server.send(b"late") is False
    peers[1].send(b"back")
    assert server.receive(PATIENCE) == b"back"
    server.accept_sender()
    assert (server.statistics.reconnects, server.statistics.connected) == (1, True)
    for link in (server, *peers):
        link.close()


def test_udp_strangers_do_not_push_out_who_was_there():
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server = open_link(uri, listen=True)
    peers = [open_link(uri) for _ in range(MOST_PEERS + 3)]
    for peer in peers:
        peer.send(b"here")
        server.receive(0.2)
        server.accept_sender()
    assert len(server.peers) == MOST_PEERS
    assert server.send(b"x")
    assert peers[0].receive(PATIENCE) == b"x"
    assert peers[-1].receive(0.05) is None
    for link in (server, *peers):
        link.close()


def test_udp_tells_strangers_nothing_however_much_they_send():
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server, friend = open_link(uri, listen=True), open_link(uri)
    strangers = [open_link(uri) for _ in range(MOST_PEERS + 3)]
    for stranger in strangers:
        stranger.send(b"let me in")
        assert server.receive(PATIENCE) == b"let me in"
        assert server.send(b"secret") is False
    assert server.peers == ()
    assert not server.statistics.connected
    friend.send(b"good")
    assert server.receive(PATIENCE) == b"good"
    server.accept_sender()
    strangers[0].send(b"me too")
    assert server.receive(PATIENCE) == b"me too"
    assert server.send(b"secret")
    assert friend.receive(PATIENCE) == b"secret"
    assert [s.receive(0.0) for s in strangers] == [None] * len(strangers)
    for link in (server, friend, *strangers):
        link.close()


def test_udp_vouches_for_one_packet_once():
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server, friend = open_link(uri, listen=True), open_link(uri)
    server.accept_sender()  # nobody was heard
    assert server.peers == ()
    friend.send(b"good")
    server.receive(PATIENCE)
    server.accept_sender()
    server._heard.clear()
    server.accept_sender()
    assert server.peers == ()
    for link in (server, friend):
        link.close()


def test_udp_hears_only_whom_it_calls():
    port = free_port(socket.SOCK_DGRAM)
    client = open_link(f"udp://127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"command", ("127.0.0.1", client._socket.getsockname()[1]))
        assert client.receive(0.1) is None
    client.close()


def test_udp_replies_to_a_stranger_alone_and_does_not_take_it_for_a_peer():
    uri = f"udp://:{free_port(socket.SOCK_DGRAM)}"
    server = open_link(uri, listen=True)
    assert server.reply(b"to nobody") is False
    known, stranger = open_link(uri), open_link(uri)
    known.send(b"here")
    assert server.receive(PATIENCE) == b"here"
    server.accept_sender()
    stranger.send(b"who?")
    assert server.receive(PATIENCE) == b"who?"
    assert server.reply(b"not you")
    assert server.send(b"all")
    assert stranger.receive(PATIENCE) == b"not you"
    assert stranger.receive(0.05) is None
    assert known.receive(PATIENCE) == b"all"
    for link in (server, known, stranger):
        link.close()
