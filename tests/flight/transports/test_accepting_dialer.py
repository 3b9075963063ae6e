"""Several peers at one listening socket: the sender of good packets keeps the link. With a clock set by the test."""

import socket

import pytest

from trimtab.flight.transports.accepting_dialer import MOST_WAITING, AcceptingDialer
from trimtab.flight.transports.reconnecting_stream import LONGEST_MUTE, TRIAL, StreamLink


class TestClock:
    """Clock that advances only during waits."""

    __test__ = False

    def __init__(self):
        self.now = 0.0

    def monotonic_ns(self):
        return round(self.now * 1e9)

    def wait(self, ready, timeout):
        self.now += timeout
        return False


class Line:
    """A listening link and the callers of its port."""

    def __init__(self):
        listener = socket.socket(socket.AF_UNIX)
        listener.bind("")  # the system chooses a name
        self.place, self.clock = listener.getsockname(), TestClock()
        self.link = StreamLink(AcceptingDialer(listener), self.clock)
        self.callers = []

    def call(self, data=b""):
        caller = socket.socket(socket.AF_UNIX)
        caller.settimeout(5.0)
        caller.connect(self.place)
        self.callers.append(caller)
        if data:
            caller.sendall(data)
        return caller

    def receive(self, accept=()):
        """Receive once, and accept the sender of any data in `accept`. Then advance by a tenth of a second."""
        piece = self.link.receive(0.0)
        if piece in accept:
            self.link.accept_sender()
        self.clock.now += 0.1
        return piece

    def close(self):
        self.link.close()
        for caller in self.callers:
            caller.close()


@pytest.fixture
def line():
    found = Line()
    yield found
    found.close()


def test_mute_callers_do_not_block_a_sending_caller(line):
    for _ in range(12):
        line.call()
    assert line.receive() is None
    line.clock.now += TRIAL
    good = line.call(b"good")
    assert line.receive() == b"good"
    line.link.accept_sender()
    assert line.link.send(b"answer")
    assert good.recv(10) == b"answer"


def test_sending_caller_precedes_longer_waiting_mute_caller(line):
    line.call()
    line.call(b"good")
    assert line.receive() == b"good"


def test_noise_callers_hold_the_link_for_one_trial(line):
    for _ in range(12):
        line.call(b"noise")
    line.call(b"good")
    heard = [line.receive(accept=[b"good"]) for _ in range(60)]
    assert heard.count(b"noise") == 12
    assert heard.index(b"good") * 0.1 <= 12 * (TRIAL + 0.2)
    assert heard[heard.index(b"good") + 1 :].count(b"noise") == 0


def test_good_caller_keeps_the_link_until_silent(line):
    good = line.call(b"good")
    assert line.receive(accept=[b"good"]) == b"good"
    line.call(b"noise")
    for _ in range(50):
        good.sendall(b"good")
        assert line.receive(accept=[b"good"]) == b"good"
    line.clock.now += LONGEST_MUTE
    assert line.receive() == b"noise"
    good.sendall(b"good")
    line.clock.now += TRIAL
    assert line.receive() == b"good"  # its connection had only been put back


def test_mute_caller_is_kept_while_no_other_sends(line):
    line.call()
    line.receive()
    line.clock.now += 10 * LONGEST_MUTE
    line.call()
    assert line.receive() is None
    assert line.link.statistics.reconnects == 0


def test_callers_beyond_the_limit_close_the_oldest(line):
    line.call(b"good")
    assert line.receive(accept=[b"good"]) == b"good"
    first = line.call()
    for _ in range(MOST_WAITING):
        line.call()
        line.clock.now += LONGEST_MUTE
        line.receive()
    assert first.recv(1) == b""


def test_closed_callers_are_dropped(line):
    line.call().close()
    good = line.call(b"good")
    line.clock.now += TRIAL
    pieces = [line.receive() for _ in range(10)]
    assert b"good" in pieces
    good.close()
