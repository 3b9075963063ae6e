"""The flight's end of a pilot console: rows out and wishes in, over a socket to a process of its own.

Nothing here waits: what the console has no room for is dropped, and what it sends is taken a few at a time.
Source: docs page, Protocol of the console.
"""

import contextlib
import json
import socket
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.quantity import Quantity
from trimtab.live.console_packets import HEAD, LARGEST_PACKET, LONGEST_VECTOR, ROW, TEXT
from trimtab.live.flight_log import FlightRows

MOST_PACKETS = 16
"""Taken at once, so that no console can keep a flight waiting."""


class ShownSignal(NamedTuple):
    """A number of a row. slot: where it stands among the numbers of the flight's rows."""

    path: str
    declared: Quantity | None
    slot: int


def list_shown(rows: FlightRows) -> list[ShownSignal]:
    """What of a flight's rows is shown: scalars, short vectors by number; no integer times, for ages tell them."""
    shown, at = [], 0
    for path, shape, _, declared in rows.signals:
        size = int(np.prod(shape))
        if size <= LONGEST_VECTOR and not (declared is not None and declared.kind == "time"):
            names = [path] if not shape else [f"{path}.{k}" for k in range(size)]
            shown += [ShownSignal(name, declared, at + k) for k, name in enumerate(names)]
        at += size
    return shown


class ConsoleLine:
    """Rows and messages of one flight to its console, and the console's messages to it."""

    def __init__(self, end: socket.socket, clock: Clock = SYSTEM_CLOCK) -> None:
        """end: of a pair of sockets that keep packets apart; the console has the other.  clock: of this process."""
        end.setblocking(False)
        self._end, self._clock = end, clock
        self._rows: FlightRows | None = None
        self.dropped = 0
        """Packets for which the console had no room."""

    def set_rows(self, rows: FlightRows) -> list[ShownSignal]:
        """Say what a row of the flight holds; which of it is shown."""
        shown = list_shown(rows)
        self._rows, self._slots = rows, np.array([s.slot for s in shown], np.intp)
        self._numbers = np.zeros(rows.width)
        self._packet = bytearray(len(ROW) + HEAD.size + 4 * len(shown))
        self._packet[: len(ROW)] = ROW
        return shown

    def send_row(self, t: float, own: Sequence[float]) -> None:
        """A row of the time t (s); own: the numbers that come with it."""
        assert self._rows is not None
        self._rows.fill(self._numbers, own)
        HEAD.pack_into(self._packet, len(ROW), t, self._clock.monotonic_ns() / NS_PER_SECOND)
        with np.errstate(over="ignore"):
            self._packet[len(ROW) + HEAD.size :] = self._numbers[self._slots].astype("<f4").tobytes()
        self._send(self._packet)

    def send(self, kind: str, **content: Any) -> None:
        """A message."""
        self._send(TEXT + json.dumps({"type": kind, **content}, allow_nan=False).encode())

    def receive(self) -> list[Mapping[str, Any]]:
        """Messages that have come, a few at most."""
        found: list[Mapping[str, Any]] = []
        with contextlib.suppress(OSError):
            for _ in range(MOST_PACKETS):
                packet = self._end.recv(LARGEST_PACKET)
                if not packet:
                    break
                with contextlib.suppress(ValueError):
                    found.append(json.loads(packet[len(TEXT) :]))
        return found

    def close(self) -> None:
        """Give the socket back; the console sees the flight's end."""
        self._end.close()

    def _send(self, packet: bytes | bytearray) -> None:
        try:
            self._end.send(packet)
        except OSError:
            self.dropped += 1
