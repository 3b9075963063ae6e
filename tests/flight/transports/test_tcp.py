import socket

import pytest
from flight.transports.ends import free_port

from trimtab.flight.transports.reconnecting_stream import ConnectingDialer

pytestmark = pytest.mark.real_time


def test_dialing_a_closed_port_does_not_connect_to_itself():
    """The system may give the calling socket the port that it calls. TCP then connects the socket to itself."""
    port = free_port()

    def make():
        found = socket.socket()
        found.bind(("127.0.0.1", port))
        return found

    def dial_often():
        for _ in range(1000):
            assert calling.dial() == -1

    calling = ConnectingDialer(make, ("127.0.0.1", port))
    with pytest.raises(OSError, match="connect"):
        dial_often()
    calling.close()
