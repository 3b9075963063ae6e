"""The thesis's own framing: a header byte, an id, for some a length, the data. Short, and without any protection.

    0xA5  id  [length]  data

It is kept for its data rates and latencies. It has neither checksum nor signature, so that whoever reaches the line
could steer: commands are refused over anything but loopback. Numbers are little-endian, but for the inertial unit's
own record, which carries a checksum.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
Source: [1] chapter 5, for header, id, optional length and the messages; header byte, ids and layouts are reconstructed,
see docs page; the inertial record is that of the unit's raw reply (3DM-GX1).
"""

import struct
from collections.abc import Iterable
from typing import NamedTuple

from trimtab.core.errors import InputError

HEADER = 0xA5
BITS_PER_BYTE = 10
"""A serial byte with its start and stop bit."""
RECORD = struct.Struct(">B9hHH")
RECORD_START = 0x03
LONGEST = 255


class InertialRecord(NamedTuple):
    """The inertial unit's record, in its counts; timer in ticks of 6.5536 ms."""

    magnetic: tuple[int, int, int]
    acceleration: tuple[int, int, int]
    rate: tuple[int, int, int]
    timer: int


class Cricket(NamedTuple):
    """What an ultrasonic unit said."""

    data: bytes


class ServoCommand(NamedTuple):
    """Rudder pulse in microseconds, fan speed in rpm, negative in reverse."""

    rudder_us: int
    speed_rpm: int


class ClockTimeMessage(NamedTuple):
    """A time of the ground in ms; coming down, also the vehicle's timer in ms: how long it took to come up."""

    time_ms: int
    timer_ms: int | None = None


class ModeLift(NamedTuple):
    """Mode, and the lift fan's power in 1/255."""

    mode: int
    lift: int


class VehicleStatus(NamedTuple):
    """A text."""

    data: bytes


Minimal = InertialRecord | Cricket | ServoCommand | ClockTimeMessage | ModeLift | VehicleStatus
IDS: dict[type, int] = {
    InertialRecord: 1,
    Cricket: 2,
    ServoCommand: 3,
    ClockTimeMessage: 4,
    ModeLift: 5,
    VehicleStatus: 6,
}
COMMANDS = (ServoCommand, ModeLift)
FIXED_SIZES = {"up": {3: 4, 4: 4, 5: 2}, "down": {1: RECORD.size, 4: 6}}
"""Data bytes of the messages of a fixed length, by the way they go."""
COUNTED_IDS = {"up": (), "down": (2, 6)}
"""Messages that tell their length."""


class MinimalEndpoint:
    """One end of a line in this framing; nothing that it hears raises, what it refuses is counted."""

    def __init__(self, end: str, *, loopback: bool = False) -> None:
        """Open one end.

        Args:
            end: "vehicle" or "ground".
            loopback: whether the line can't leave this machine, as told by its URI.
        """
        if end not in ("vehicle", "ground"):
            raise InputError("minimal framing", f"{end!r} is no end of a line", choices=("vehicle", "ground"))
        self._sends, self._hears = ("down", "up") if end == "vehicle" else ("up", "down")
        self._loopback = loopback
        self._rest, self._in_step = b"", False
        self.accepted = self.refused = self.garbage = 0
        """Messages taken; commands refused because the line leaves this machine; bytes that belong to no message."""

    def pack(self, message: Minimal) -> bytes:
        """The bytes of a message; numbers that don't fit are put to the nearest that do.

        Raises InputError for a command on a line that leaves this machine, and for what goes the other way.
        """
        number = IDS[type(message)]
        if isinstance(message, COMMANDS) and not self._loopback:
            problem = "commands without a signature are refused over anything but loopback"
            raise InputError("minimal framing", problem, fix="use MAVLink with a key, or a loopback:// line")
        if number not in FIXED_SIZES[self._sends] and number not in COUNTED_IDS[self._sends]:
            problem = f"{type(message).__name__} does not go {self._sends}"
            raise InputError("minimal framing", problem, fix="pack it at the other end")
        data = _message_data(message, self._sends)
        length = bytes((len(data),)) if number in COUNTED_IDS[self._sends] else b""
        return bytes((HEADER, number)) + length + data

    def feed(self, data: bytes | None) -> list[Minimal]:
        """The messages that are complete with these bytes. After garbage one counts if another follows it at once."""
        buffer, at, found = self._rest + (data or b""), 0, []
        while at < len(buffer):
            size = self._message_size(buffer, at)
            if size is None or len(buffer) - at < size:
                break
            message = self._parse_message(buffer[at : at + size]) if size else None
            if message is not None and not self._in_step and not isinstance(message, InertialRecord):
                if len(buffer) == at + size:
                    break  # the next byte will tell
                message = message if buffer[at + size] == HEADER else None
            self._in_step = message is not None
            if message is None:
                self.garbage += 1
                at += 1
                continue
            self._accept_message(message, found)
            at += size
        self._rest = buffer[at:]
        return found

    def _accept_message(self, message: Minimal, found: list[Minimal]) -> None:
        if isinstance(message, COMMANDS) and not self._loopback:
            self.refused += 1
            return
        self.accepted += 1
        found.append(message)

    def _message_size(self, buffer: bytes, at: int) -> int | None:
        """How long the message at `at` is; 0: there is none; None: more bytes are needed to tell."""
        if buffer[at] != HEADER:
            return 0
        if len(buffer) - at < 2:
            return None
        number = buffer[at + 1]
        if number in FIXED_SIZES[self._hears]:
            return 2 + FIXED_SIZES[self._hears][number]
        if number not in COUNTED_IDS[self._hears]:
            return 0
        return None if len(buffer) - at < 3 else 3 + buffer[at + 2]

    def _parse_message(self, frame: bytes) -> Minimal | None:
        number = frame[1]
        if number == 1:
            return _parse_inertial_record(frame[2:])
        if number == 3:
            return ServoCommand(*struct.unpack("<Hh", frame[2:]))
        if number == 4:
            return ClockTimeMessage(*struct.unpack("<I" if self._hears == "up" else "<IH", frame[2:]))
        if number == 5:
            return ModeLift(frame[2], frame[3])
        return Cricket(frame[3:]) if number == 2 else VehicleStatus(frame[3:])


def data_rate(traffic: Iterable[tuple[int, float]]) -> float:
    """Bits a second of a serial line that carries frames of so many bytes, so many times a second."""
    return sum(size * BITS_PER_BYTE * rate for size, rate in traffic)


def _message_data(message: Minimal, way: str) -> bytes:
    if isinstance(message, InertialRecord):
        vectors = [_clamp(v, -32768, 32767) for triple in message[:3] for v in triple]
        record = RECORD.pack(RECORD_START, *vectors, _clamp(message.timer, 0, 65535), 0)
        return record[:-2] + _record_checksum(record).to_bytes(2, "big")
    if isinstance(message, ServoCommand):
        return struct.pack("<Hh", _clamp(message.rudder_us, 0, 65535), _clamp(message.speed_rpm, -32768, 32767))
    if isinstance(message, ClockTimeMessage):
        time = struct.pack("<I", int(message.time_ms) & 0xFFFFFFFF)
        return time if way == "up" else time + struct.pack("<H", _clamp(message.timer_ms or 0, 0, 65535))
    if isinstance(message, ModeLift):
        return bytes((_clamp(message.mode, 0, 255), _clamp(message.lift, 0, 255)))
    return message.data[:LONGEST]


def _clamp(value: float, low: int, high: int) -> int:
    return low if value != value else int(min(max(value, low), high))


def _record_checksum(record: bytes) -> int:
    """The unit's checksum: its first byte and all words but the last, modulo 65536."""
    return (record[0] + sum(struct.unpack_from(">10H", record, 1))) & 0xFFFF


def _parse_inertial_record(record: bytes) -> InertialRecord | None:
    start, *words, timer, total = RECORD.unpack(record)
    if start != RECORD_START or total != _record_checksum(record):
        return None
    return InertialRecord(
        (words[0], words[1], words[2]), (words[3], words[4], words[5]), (words[6], words[7], words[8]), timer
    )
