"""Rows and messages over the socket to a console."""

import json
import socket

import numpy as np
import pytest

from trimtab.compiler.structs import Member
from trimtab.core.quantity import Quantity
from trimtab.flight.console_line import MOST_PACKETS, ConsoleLine
from trimtab.flight.console_packets import HEAD
from trimtab.flight.flight_log import FlightRows, LogSource

OWN = {"link.silence": ("f8", Quantity("s", "Silence."))}
MEMBERS = [
    Member("a", (), "f64", Quantity("m", "A."), "a"),
    Member("P", (4, 4), "f64", None, "P"),
    Member("t", (), "i64", Quantity("100 ns", "When.", kind="time"), "t"),
    Member("v", (3,), "f64", Quantity("m/s", "V."), "v"),
]


@pytest.fixture
def ends():
    own, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    line = ConsoleLine(own)
    other.settimeout(5)
    yield line, other
    line.close()
    other.close()


def test_a_row_has_scalars_and_short_vectors_as_float32(ends):
    line, other = ends
    vector = np.arange(21.0)
    shown = line.set_rows(FlightRows([LogSource(vector, MEMBERS, lambda p: p)], OWN))
    assert [s.path for s in shown] == ["a", "v.0", "v.1", "v.2", "link.silence"]
    line.send_row(1.25, (0.5,))
    packet = other.recv(4096)
    t, clock = HEAD.unpack_from(packet, 1)
    assert (packet[:1], t, clock > 0) == (b"r", 1.25, True)
    np.testing.assert_array_equal(np.frombuffer(packet, "<f4", offset=1 + HEAD.size), [0, 18, 19, 20, 0.5])


def test_values_beyond_float32_become_infinite_and_nan_stays(ends):
    line, other = ends
    vector = np.zeros(21)
    vector[[0, 18]] = 1e300, np.nan
    line.set_rows(FlightRows([LogSource(vector, MEMBERS, lambda p: p)], OWN))
    line.send_row(0.0, (0.0,))
    row = np.frombuffer(other.recv(4096), "<f4", offset=1 + HEAD.size)
    assert np.isinf(row[0])
    assert np.isnan(row[1])


def test_messages_pass_in_both_directions(ends):
    line, other = ends
    line.send("event", text="über")
    assert json.loads(other.recv(4096)[1:]) == {"type": "event", "text": "über"}
    for k in range(MOST_PACKETS + 3):
        other.send(b"j" + json.dumps({"type": "ping", "id": k}).encode())
    other.send(b"jno json")
    first, second = line.receive(), line.receive()
    assert [m["id"] for m in first] == list(range(MOST_PACKETS))
    assert [m["id"] for m in second] == [MOST_PACKETS, MOST_PACKETS + 1, MOST_PACKETS + 2]
    assert line.receive() == []


def test_stuck_or_closed_console_does_not_block(ends):
    line, other = ends
    for _ in range(5000):
        line.send("event", text="x" * 200)
    assert line.dropped > 0
    other.close()
    line.send("event", text="x")
    assert line.receive() == []
