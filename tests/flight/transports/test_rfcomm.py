import errno
import socket

import pytest

from trimtab.core.errors import InputError
from trimtab.flight.transports.open_link import open_link, parse_uri
from trimtab.flight.transports.rfcomm import open_rfcomm

URI = "rfcomm://00:11:22:aa:bb:cc/3"


def test_rejects_missing_bluetooth_in_python_or_kernel(monkeypatch):
    monkeypatch.delattr(socket, "AF_BLUETOOTH", raising=False)
    with pytest.raises(InputError, match=r"this Python was built without Bluetooth.*\nFix: .*rfcomm bind"):
        open_link(URI)
    monkeypatch.setattr(socket, "AF_BLUETOOTH", 31, raising=False)
    monkeypatch.setattr(socket, "BTPROTO_RFCOMM", 3, raising=False)

    def refused(*_):
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refused)
    with pytest.raises(InputError, match=r"this kernel has no Bluetooth \(Address family.*\nFix: .*modprobe rfcomm"):
        open_link(URI, listen=True)


def test_custom_bluetooth_stack_can_make_the_connection():
    ours, theirs = socket.socketpair()
    asked = []

    class Stack:
        def __init__(self, *place):
            asked.append(place)

        def dial(self):
            ours.setblocking(False)
            return ours.detach()

        def wait_event(self):
            return -1, 0

        def exchange(self, fd):
            return -1

        def close(self):
            asked.append("closed")

    link = open_rfcomm(parse_uri(URI), listen=True, stack=Stack)
    assert link.send(b"there")
    assert theirs.recv(10) == b"there"
    theirs.send(b"back")
    assert link.receive(5.0) == b"back"
    link.close()
    assert asked == [("00:11:22:AA:BB:CC", 3, True), "closed"]
    theirs.close()
