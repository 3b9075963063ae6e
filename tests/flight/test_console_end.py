"""STOP at the console, and a console that has ended or accepts no data, as the flight notices them."""

import json
import socket
from types import SimpleNamespace

import pytest

from trimtab.core.time import ms, seconds
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.piloting import Piloting
from trimtab.loop.supervisor import ENDED, FLYING


class Cockpit:
    """The pilot's side of an armed flight, whose console the test plays. mode: mode of the supervisor, or None."""

    def __init__(self, mode=FLYING):
        own, self.server = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.server.setblocking(False)
        self.line, self.said, self.asked, self.disarmed = ConsoleLine(own), [], [], 0
        self.stick = SimpleNamespace(mode=0, move=lambda *_: None, set_inputs=lambda t: None)
        self.supervised = SimpleNamespace(mode=mode, is_asked=False, request=self.asked.append)
        arming = SimpleNamespace(has_authority=True, is_asking=False, disarm=self._disarm)
        remote = SimpleNamespace(arming=arming)
        self.piloting = Piloting(self.line, self.stick, self.supervised, None, remote, None, self.said.append)

    def _disarm(self):
        self.disarmed += 1

    def send(self, kind, **content):
        self.server.send(b"j" + json.dumps({"type": kind, **content}).encode())

    def drain(self):
        try:
            while self.server.recv(1 << 16):
                pass
        except BlockingIOError:
            pass

    def close(self):
        self.line.close()
        self.server.close()


@pytest.fixture
def make_cockpit():
    made = []

    def make(*args):
        made.append(Cockpit(*args))
        return made[-1]

    yield make
    for cockpit in made:
        cockpit.close()


def test_stop_ends_the_flight_in_the_period_that_reads_it(make_cockpit):
    """The period's step then gets the request to end. The request is repeated until the supervisor has ended."""
    cockpit = make_cockpit()
    cockpit.piloting.update(0)
    assert (cockpit.asked, cockpit.disarmed) == ([], 0)
    cockpit.send("stop", client=1)
    cockpit.piloting.update(ms(1))
    assert (cockpit.asked, cockpit.disarmed, cockpit.said) == (["end"], 1, ["stopped from the console"])
    cockpit.piloting.update(ms(2))
    cockpit.supervised.mode = ENDED
    cockpit.piloting.update(ms(3))
    assert (cockpit.asked, cockpit.disarmed) == (["end"] * 2, 1)


def test_stop_without_supervisor_ends_the_control_loop(make_cockpit):
    cockpit = make_cockpit(None)
    cockpit.send("stop", client=1)
    cockpit.piloting.update(ms(1))
    assert (cockpit.disarmed, cockpit.piloting.end_reason) == (1, "stopped from the console")


def test_console_that_has_ended_is_reported_once(make_cockpit):
    cockpit = make_cockpit()
    cockpit.line.send("event", text="not read")
    cockpit.server.close()
    for k in range(3):
        cockpit.line.send("event", text="nobody reads this")
        cockpit.piloting.update(ms(k))
    assert cockpit.said == ["the console has ended: its pages cannot stop the flight, use Ctrl-C"]
    assert (cockpit.asked, cockpit.disarmed) == ([], 0)


def test_dead_mans_switch_acts_after_the_console_has_ended(make_cockpit):
    cockpit = make_cockpit()
    cockpit.send("take", pilot=1)
    cockpit.piloting.update(0)
    cockpit.server.close()
    cockpit.piloting.update(ms(499))
    assert cockpit.asked == []
    cockpit.piloting.update(ms(500))
    assert cockpit.asked == ["hold"]
    cockpit.piloting.update(seconds(3) - 1)
    assert cockpit.disarmed == 0
    cockpit.piloting.update(seconds(3))
    assert (cockpit.asked[-1], cockpit.disarmed) == ("end", 1)


def test_console_that_accepts_no_data_is_reported_until_it_recovers(make_cockpit):
    cockpit = make_cockpit()
    while cockpit.line.dropped < 49:
        cockpit.line.send("event", text="x" * 1000)
    cockpit.piloting.update(ms(1))
    assert cockpit.said == []
    cockpit.line.send("event", text="x" * 1000)
    cockpit.piloting.update(ms(2))
    cockpit.piloting.update(ms(3))
    assert cockpit.said == ["the console accepts no data: its pages cannot stop the flight, use Ctrl-C"]
    cockpit.drain()
    cockpit.line.send("event", text="x")
    cockpit.piloting.update(ms(4))
    assert cockpit.said[1:] == ["the console accepts data again"]
