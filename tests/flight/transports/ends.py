"""Helpers for tests with both ends of a link: free port, first exchange, collecting a stream."""

import socket
import time

PATIENCE = 20.0
"""Seconds; only a failure takes this long."""
EVERY_BYTE = bytes(range(256))


def free_port(kind=socket.SOCK_STREAM):
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def collect(link, n, patience=PATIENCE):
    """Receive n bytes, in any number of pieces."""
    found, end = b"", time.monotonic() + patience
    while len(found) < n and time.monotonic() < end:
        found += link.receive(0.05) or b""
        link.accept_sender()
    return found


def deliver(sender, receiver, packet):
    """Send a packet until it is accepted. Return the bytes received."""
    end = time.monotonic() + PATIENCE
    while not sender.send(packet) and time.monotonic() < end:
        receiver.receive(0.01)
    return collect(receiver, len(packet))


def meet(a, b):
    """Exchange a byte each way, with retries."""
    end = time.monotonic() + PATIENCE
    seen = set()
    while seen != {"a", "b"} and time.monotonic() < end:
        a.send(b"?")
        b.send(b"!")
        for name, link in (("a", a), ("b", b)):
            if link.receive(0.02):
                link.accept_sender()
                seen.add(name)
    assert seen == {"a", "b"}
    for link in (a, b):
        while link.receive(0.05):
            pass
