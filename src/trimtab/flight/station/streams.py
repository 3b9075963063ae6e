"""Telemetry of a vehicle: messages that are sent repeatedly, and lines of text for the users of ground stations.

Each message has its own rate, which ground stations may change. At most one message is sent per call, so that a slow
link never gets a burst. A long line of text is sent in several messages. If the text queue is full, further lines are
dropped.
Source: https://mavlink.io/en/mavgen_python/howto_requestmessages.html; common.html, MAV_DATA_STREAM and STATUSTEXT.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from trimtab.core.time import FOREVER, ms, seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandCode, CommandResult, Severity
from trimtab.flight.station.telemetry import UNITS_PER_US

PIECE = 50
"""Maximum number of bytes of text in one message."""
WAITING_TEXTS_MAX = 20
"""Maximum number of text messages in the queue."""
FASTEST = ms(20)
"""Shortest period of a repeated message (100 ns), even if a ground station requests a shorter period."""
SLOWEST = seconds(60)
ALL_STREAMS = 0
STREAMS: Mapping[int, frozenset[str]] = {
    1: frozenset({"HIGHRES_IMU"}),
    2: frozenset({"SYS_STATUS", "EXTENDED_SYS_STATE", "SYSTEM_TIME", "BATTERY_STATUS"}),
    3: frozenset({"RC_CHANNELS", "SERVO_OUTPUT_RAW"}),
    6: frozenset({"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"}),
    10: frozenset({"ATTITUDE"}),
    11: frozenset({"VFR_HUD"}),
}
"""Names of the messages in each stream, by the stream's number in the message REQUEST_DATA_STREAM."""
INTERVAL, HOME = "MESSAGE_INTERVAL", "HOME_POSITION"


class TextQueue:
    """Queue of lines of text for ground stations. `dropped` counts the lines that were lost because the queue was
    full."""

    def __init__(self, endpoint: Endpoint) -> None:
        """Start with an empty queue."""
        self._endpoint = endpoint
        self._waiting: deque[tuple[Severity, bytes, int, int]] = deque()
        self._number = 0
        self.dropped = 0

    def queue_text(self, severity: Severity, text: str) -> None:
        """Queue a line of text for the station."""
        pieces = _split_text(text)
        if len(self._waiting) + len(pieces) > WAITING_TEXTS_MAX:
            self.dropped += 1
            return
        self._number = self._number % 0xFFFF + 1
        number = self._number if len(pieces) > 1 else 0
        self._waiting.extend((severity, piece, number, k) for k, piece in enumerate(pieces))

    def pack_texts(self) -> list[bytes]:
        """Return the packets of all queued lines of text, and empty the queue."""
        packets = [
            self._endpoint.pack("STATUSTEXT", {"severity": severity, "text": piece, "id": number, "chunk_seq": k})
            for severity, piece, number, k in self._waiting
        ]
        self._waiting.clear()
        return packets


def pack_text(endpoint: Endpoint, severity: Severity, text: str) -> list[bytes]:
    """Return the packets of one line of text, without a queue."""
    queue = TextQueue(endpoint)
    queue.queue_text(severity, text)
    return queue.pack_texts()


class TextAssembly:
    """Assembler of lines of text that were sent in several messages. A line with a lost message is dropped."""

    def __init__(self) -> None:
        """Start without pieces."""
        self._pieces: list[str] = []
        self._number = 0

    def join(self, message: Message) -> str | None:
        """Return the line of text that a STATUSTEXT message completes, with ? for unprintable characters, or None while
        the line is incomplete."""
        piece, number, place = (message.get(n) for n in ("text", "id", "chunk_seq"))
        if not number:
            return _make_printable(piece)
        if place == 0:
            self._pieces, self._number = [], number
        if number != self._number or place != len(self._pieces):
            return None
        self._pieces.append(piece)
        return None if len(piece.encode()) >= PIECE else _make_printable("".join(self._pieces))


def _make_printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _split_text(text: str) -> list[bytes]:
    """Split a text into pieces of at most PIECE bytes for messages. If the last of several pieces is full, an empty
    piece is added.

    A character of several bytes is not divided between two pieces. Spaces fill the first piece instead.
    """
    pieces = [b""]
    for letter in text:
        data = letter.encode("utf-8", "replace")
        if len(pieces[-1]) + len(data) > PIECE:
            pieces[-1] = pieces[-1].ljust(PIECE)
            pieces.append(b"")
        pieces[-1] += data
    return [*pieces, b""] if len(pieces) > 1 and len(pieces[-1]) == PIECE else pieces


class TelemetryStream(NamedTuple):
    """Repeated message of the telemetry, with its period (100 ns).

    fields: function that returns the message's fields at a given time, or None if there is nothing to send.
    """

    fields: Callable[[int], Mapping[str, Any] | None]
    period: int


class Streams:
    """Scheduler of the repeated messages of one vehicle. Times are by the vehicle's clock, in 100 ns."""

    def __init__(self, endpoint: Endpoint, streams: Mapping[str, TelemetryStream]) -> None:
        """streams: fields and period of each repeated message, by the message's name."""
        self._endpoint, self._streams = endpoint, dict(streams)
        self._names = {endpoint.dialect.definitions[n].id: n for n in self._streams}
        self._periods = {n: s.period for n, s in self._streams.items()}
        self._due = dict.fromkeys(self._streams, 0)
        self._next = 0 if self._due else FOREVER

    def add_on_request(self, name: str, fields: Callable[[int], Mapping[str, Any]]) -> None:
        """Add a message that is sent only if a ground station requests it, because not every ground station knows the
        message."""
        self._streams[name] = TelemetryStream(fields, 0)
        self._names[self._endpoint.dialect.definitions[name].id] = name

    def due(self, now: int) -> list[bytes]:
        """Return the packet of the message that has been due for the longest time, or an empty list if no message is
        due."""
        if now < self._next:
            return []
        name = min(self._due, key=lambda n: self._due[n])
        period = self._periods[name]
        late = now - self._due[name]
        self._due[name] = self._due[name] + period if late < period else now + period
        self._next = min(self._due.values())
        return self._stream_packet(name, now)

    def handle_command(self, command: int, first: float, second: float, now: int) -> tuple[CommandResult, list[bytes]]:
        """Handle a command that requests a message, or that sets or reads the rate of a message. Return the result of
        the command, and packets to send."""
        if command == CommandCode.REQUEST_MESSAGE and first == self._endpoint.dialect.definitions[INTERVAL].id:
            command, first = CommandCode.GET_INTERVAL, second
        if command == CommandCode.GET_HOME:
            command, first = CommandCode.REQUEST_MESSAGE, self._endpoint.dialect.definitions[HOME].id
        name = self._names.get(int(first)) if math.isfinite(first) else None
        if name is not None and command == CommandCode.GET_INTERVAL:
            return CommandResult.ACCEPTED, [self._interval_packet(name)]
        if name is not None and command == CommandCode.SET_INTERVAL:
            return self._set_interval(name, second, now), []
        if name is not None and command == CommandCode.REQUEST_MESSAGE:
            packets = self._stream_packet(name, now)
            return (CommandResult.ACCEPTED if packets else CommandResult.NOT_NOW), packets
        return CommandResult.UNSUPPORTED, []

    def ask(self, message: Message, now: int) -> None:
        """Handle a REQUEST_DATA_STREAM."""
        which, rate, start = (message.get(n) for n in ("req_stream_id", "req_message_rate", "start_stop"))
        unasked = [name for name, stream in self._streams.items() if stream.period]
        for name in unasked if which == ALL_STREAMS else STREAMS.get(which, ()):
            self._set_period(name, seconds(1) // rate if start and rate else 0, now)

    def _stream_packet(self, name: str, now: int) -> list[bytes]:
        fields = self._streams[name].fields(now)
        return [] if fields is None else [self._endpoint.pack(name, fields)]

    def _interval_packet(self, name: str) -> bytes:
        period = self._periods.get(name, 0)
        fields = {"message_id": self._endpoint.dialect.definitions[name].id}
        return self._endpoint.pack(INTERVAL, fields | {"interval_us": period // UNITS_PER_US or -1})

    def _set_interval(self, name: str, micros: float, now: int) -> CommandResult:
        if micros == 0:
            self._set_period(name, self._streams[name].period, now)
        elif micros == -1:
            self._set_period(name, 0, now)
        elif math.isfinite(micros) and micros > 0:
            self._set_period(name, int(micros) * UNITS_PER_US, now)
        else:
            return CommandResult.DENIED
        return CommandResult.ACCEPTED

    def _set_period(self, name: str, period: int, now: int) -> None:
        """Set the period (100 ns) of a message from now on. If the period is 0, the message is no longer sent."""
        if name not in self._streams:
            return
        if not period:
            self._periods.pop(name, None)
            self._due.pop(name, None)
        else:
            self._periods[name] = period = min(max(period, FASTEST), SLOWEST)
            self._due[name] = min(self._due.get(name, now), now + period)
        self._next = min(self._due.values(), default=FOREVER)
