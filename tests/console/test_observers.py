"""Observers of a flight: what they may send has no effect on the flight or on what a pilot sees."""

import json
import socket
from types import SimpleNamespace

import pytest
from console.flight import HELLO, SIGNALS

from trimtab.console.access import OBSERVER, PILOT
from trimtab.console.clients import parse_message
from trimtab.console.live_feed import LiveFeed
from trimtab.loop.supervisor_modes import FAULT, SPEED

ALARM = "supervisor-fault"


@pytest.fixture
def server():
    """A server's end of a flight whose supervisor reports a fault, and the flight's end of the socket."""
    own, flight = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    flight.setblocking(False)
    feed = LiveFeed(own, dict(HELLO), lambda: None)
    values = SIGNALS | {"supervisor.mode": float(FAULT), "supervisor.cause": float(SPEED)}
    feed._flight.take_row(1.0, 1e12, list(values.values()))
    feed._update_alarms()
    yield SimpleNamespace(feed=feed, flight=flight)
    own.close()
    flight.close()


def join(feed, role):
    page = SimpleNamespace(number=feed.next_number(), role=role, sent=[])
    page.send = page.sent.append
    feed.join(page)
    return page


def notes(flight):
    found = []
    try:
        while packet := flight.recv(1 << 16):
            found.append(json.loads(packet[1:])["text"])
    except BlockingIOError:
        return found


def is_acknowledged(feed):
    feed._publish_status()
    (alarm,) = [a for a in feed.clients[-1].sent[-1]["alarms"] if a["id"] == ALARM]
    return alarm["acknowledged"]


def test_acknowledge_of_an_observer_has_no_effect(server):
    observer, pilot = join(server.feed, OBSERVER), join(server.feed, PILOT)
    assert any("alarm: fault" in text for text in notes(server.flight))
    text = json.dumps({"type": "acknowledge", "alarm": ALARM})
    server.feed.handle(observer, parse_message(text, OBSERVER))
    assert (is_acknowledged(server.feed), notes(server.flight)) == (False, [])
    server.feed.handle(pilot, parse_message(text, PILOT))
    assert is_acknowledged(server.feed)
    assert notes(server.flight) == [f"console: alarm {ALARM} acknowledged by page {pilot.number}"]
