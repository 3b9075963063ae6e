"""Connection of a flight to the pilot's console over a socket: it sends rows of signal values and receives requests.

The console is another process. No method waits for it. While the socket's buffer is full, rows are dropped. One call
reads at most MOST_PACKETS messages.
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
from trimtab.flight.console_packets import HEAD, LARGEST_PACKET, LONGEST_VECTOR, ROW, TEXT
from trimtab.flight.flight_log import FlightRows

MOST_PACKETS = 16
"""Maximum number of packets read in one call, so that a console cannot delay a flight."""


class ShownSignal(NamedTuple):
    """Signal that the console's page shows. slot: index of the signal's value in a row of the flight's log."""

    path: str
    declared: Quantity | None
    slot: int


def list_shown(rows: FlightRows) -> list[ShownSignal]:
    """Return the signals of a flight's log that the console's page shows: scalars and elements of short vectors, but no
    times."""
    shown, at = [], 0
    for path, shape, _, declared in rows.signals:
        size = int(np.prod(shape))
        if size <= LONGEST_VECTOR and not (declared is not None and declared.kind == "time"):
            names = [path] if not shape else [f"{path}.{k}" for k in range(size)]
            shown += [ShownSignal(name, declared, at + k) for k, name in enumerate(names)]
        at += size
    return shown


class ConsoleLine:
    """Connection from a flight to its console. It sends rows of signal values and messages, and receives requests."""

    def __init__(self, end: socket.socket, clock: Clock = SYSTEM_CLOCK) -> None:
        """end: one end of a pair of packet sockets, whose other end is the console's.  clock: clock of this process."""
        end.setblocking(False)
        self._end, self._clock = end, clock
        self._rows: FlightRows | None = None
        self.dropped = self.dropped_in_a_row = 0
        """Number of packets that could not be sent, e.g. because the socket's buffer was full: all of them, and those
        since the last packet that was sent."""
        self.has_ended = False
        """True once the console's end of the socket is closed, because the console's process has ended."""

    def set_rows(self, rows: FlightRows) -> list[ShownSignal]:
        """Set the layout of the flight's log rows. Return the signals that the page shows."""
        shown = list_shown(rows)
        self._rows, self._slots = rows, np.array([s.slot for s in shown], np.intp)
        self._numbers = np.zeros(rows.width)
        self._packet = bytearray(len(ROW) + HEAD.size + 4 * len(shown))
        self._packet[: len(ROW)] = ROW
        return shown

    def send_row(self, t: float, own: Sequence[float]) -> None:
        """Send the row of time t (s). own: values of the signals that do not come from a compiled block, in the order
        of the layout."""
        assert self._rows is not None
        self._rows.fill(self._numbers, own)
        HEAD.pack_into(self._packet, len(ROW), t, self._clock.monotonic_ns() / NS_PER_SECOND)
        with np.errstate(over="ignore"):
            self._packet[len(ROW) + HEAD.size :] = self._numbers[self._slots].astype("<f4").tobytes()
        self._send(self._packet)

    def send(self, kind: str, **content: Any) -> None:
        """Send a message to the console. kind: type of the message."""
        self._send(TEXT + json.dumps({"type": kind, **content}, allow_nan=False).encode())

    def receive(self) -> list[Mapping[str, Any]]:
        """Return the messages received from the console, at most MOST_PACKETS."""
        found: list[Mapping[str, Any]] = []
        try:
            for _ in range(MOST_PACKETS):
                packet = self._end.recv(LARGEST_PACKET)
                if not packet:
                    self.has_ended = True
                    break
                with contextlib.suppress(ValueError):
                    found.append(json.loads(packet[len(TEXT) :]))
        except BlockingIOError:
            pass
        except OSError:
            self.has_ended = True
        return found

    def close(self) -> None:
        """Close the socket, which shows the console that the flight is over."""
        self._end.close()

    def _send(self, packet: bytes | bytearray) -> None:
        try:
            self._end.send(packet)
            self.dropped_in_a_row = 0
        except OSError:
            self.dropped += 1
            self.dropped_in_a_row += 1
