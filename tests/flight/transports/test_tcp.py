import socket
import time

import pytest
from flight.transports.ends import PATIENCE, deliver, free_port

from trimtab.flight.transports import stream
from trimtab.flight.transports.open_link import open_link
from trimtab.flight.transports.stream import ConnectingDialer

pytestmark = pytest.mark.real_time


def test_a_call_to_a_port_at_which_nobody_listens_does_not_meet_itself():
    """The system may give the calling socket the very port that it calls: TCP then connects it to itself."""
    port = free_port()

    def make():
        found = socket.socket()
        found.bind(("127.0.0.1", port))
        return found

    calling = ConnectingDialer(make, ("127.0.0.1", port))
    with pytest.raises(OSError, match="connect"):
        assert [calling.dial() for _ in range(1000)] == [-1] * 1000
    calling.close()


def test_one_who_says_nothing_good_makes_room_for_who_waits(monkeypatch):
    """A mute client that had come first locked everybody else out."""
    monkeypatch.setattr(stream, "LONGEST_MUTE", 0.2)
    uri = f"tcp://:{free_port()}"
    server = open_link(uri, listen=True)
    mute = socket.create_connection(("127.0.0.1", int(uri.rpartition(":")[2])))
    assert server.receive(0.3) is None
    assert server.statistics.connected  # nobody else wants its place
    mute.sendall(b"noise")
    assert server.receive(PATIENCE) == b"noise"
    good = open_link(uri)
    assert deliver(good, server, b"here") == b"here"
    assert server.statistics.reconnects == 1
    second = open_link(uri)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:  # who is vouched for stays
        good.send(b"x")
        assert server.receive(PATIENCE) == b"x"
        server.accept_sender()
        time.sleep(0.02)
    assert server.statistics.reconnects == 1
    for link in (server, good, second, mute):
        link.close()
