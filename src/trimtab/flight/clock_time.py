"""Messages of the CLOCK_TIME experiment, which measures the delays of a link, in the framing of the thesis [1]: one
header byte, an id, data.

    up    A5 04 t0(4)                  down  A5 04 t0(4) uplink(2)       both in 0.1 ms
    up    A5 07 t0(8)                  down  A5 07 t0(8) far(8)          in 100 ns, for two clocks
    up    A5 06 10 boot(8) session(4) rate(4)     down  A5 06 10 boot(8) session(4) heard(4)
    load  A5 03 servo command(4)       load  A5 01 IMU record(23)

One end of the link, the measuring end, sends requests. The far end appends its timer reading to each request and sends
the request back. Received bytes that belong to no message are skipped.
Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 5,
for the experiment; header, ids and units are our own choice.
"""

import hashlib
import struct
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

HEADER, IMU, SERVO, CLOCK_TIME, STATUS, CLOCK_PAIR = 0xA5, 0x01, 0x03, 0x04, 0x06, 0x07
TICKS = 1000
"""Unit of the times in CLOCK_TIME messages: 0.1 ms, given as a multiple of 100 ns. The thesis used 1 ms."""
LONGEST_UPLINK = 0xFFFF
"""Largest uplink delay that fits into two bytes, in units of 0.1 ms. This value is sent for any delay of at least
6.5535 s."""
UP: Mapping[int, int] = {CLOCK_TIME: 4, CLOCK_PAIR: 8, STATUS: 17, SERVO: 4}
DOWN: Mapping[int, int] = {CLOCK_TIME: 6, CLOCK_PAIR: 16, STATUS: 17, IMU: 23}
"""Number of data bytes of each type of message, by the message's id. UP: messages to the far end. DOWN: messages from
the far end."""
HELLO = struct.Struct("<B8sII")
LOAD_UP, LOAD_DOWN = bytes((HEADER, SERVO, *bytes(4))), bytes((HEADER, IMU, *bytes(23)))


class ClockMessage(NamedTuple):
    """Message of the CLOCK_TIME experiment: the message's id, and the data bytes after the id."""

    id: int
    data: bytes


class ClockMessageParser:
    """Parser of messages in a stream of bytes. It skips invalid bytes up to the next message.

    Args:
        sizes: number of data bytes by message id: UP at the far end, DOWN at the measuring end.
    """

    def __init__(self, sizes: Mapping[int, int]) -> None:
        self._sizes, self._rest = sizes, b""

    def feed(self, data: bytes) -> list[ClockMessage]:
        """Add received bytes. Return the messages that are now complete."""
        data, messages, at = self._rest + data, [], 0
        while at + 2 <= len(data):
            size = self._sizes.get(data[at + 1]) if data[at] == HEADER else None
            if size is None:
                at += 1
            elif at + 2 + size > len(data):
                break
            else:
                messages.append(ClockMessage(data[at + 1], data[at + 2 : at + 2 + size]))
                at += 2 + size
        self._rest = data[at:]
        return messages


class Hello(NamedTuple):
    """Hello message: digest of the sender's boot id, session number, and a number whose meaning depends on the sender.

    number: in a message of the measuring end, the load (byte/s) that the far end must send. In a message of the far
    end, the number of requests that have arrived there.
    """

    boot: bytes
    session: int
    number: int

    def pack(self) -> bytes:
        """Return the message as bytes."""
        return bytes((HEADER, STATUS)) + HELLO.pack(HELLO.size - 1, *self)


def parse_hello(data: bytes) -> Hello | None:
    """Return the hello message in the data of a STATUS message, or None if the data have the wrong length."""
    size, *rest = HELLO.unpack(data)
    return Hello(*rest) if size == HELLO.size - 1 else None


def boot_digest() -> bytes:
    """Return eight bytes that identify this machine and its last boot. Two programs with equal digests share one
    monotonic clock."""
    try:
        text = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except OSError:  # no such file on this system: no shared clock is assumed
        text = str(uuid.uuid4())
    return hashlib.sha256(text.encode()).digest()[:8]


class Reply(NamedTuple):
    """Reply to a request.

    key: key of the request.  uplink: far end's clock at the request's arrival, minus the sender's clock at its
    departure (100 ns).
    """

    key: int
    uplink: int


class ClockTimeExchange:
    """Encoder of requests and decoder of replies, for the end of the link that measures the delays (CLOCK_TIME)."""

    def __init__(self, session: int, boot: bytes | None = None) -> None:
        self._boot, self._session = boot_digest() if boot is None else boot, session
        self._parser = ClockMessageParser(DOWN)
        self.shared: bool | None = None
        """True if both ends of the link share one clock, or None until the far end has answered."""
        self.heard = 0
        """Number of requests that arrived at the far end, as last reported by the far end."""

    def request(self, t: int) -> tuple[int, bytes]:
        """Return the key and the bytes of a request that is sent at t (100 ns)."""
        if self.shared is False:
            return t, struct.pack("<BBq", HEADER, CLOCK_PAIR, t)
        key = t // TICKS % 2**32
        return key, struct.pack("<BBI", HEADER, CLOCK_TIME, key)

    def pack_hello(self, rate: int) -> bytes:
        """Return a hello message, which asks the far end to answer, and to send a load of `rate` (byte/s)."""
        return Hello(self._boot, self._session, rate).pack()

    def read_replies(self, data: bytes) -> list[Reply]:
        """Return the replies in the received bytes."""
        replies = []
        for message in self._parser.feed(data):
            if message.id == CLOCK_TIME:
                key, uplink = struct.unpack("<IH", message.data)
                if uplink < LONGEST_UPLINK:
                    replies.append(Reply(key, uplink * TICKS))
            elif message.id == CLOCK_PAIR:
                t0, far = struct.unpack("<qq", message.data)
                replies.append(Reply(t0, far - t0))
            elif message.id == STATUS and (hello := parse_hello(message.data)) and hello.session == self._session:
                self.shared, self.heard = hello.boot == self._boot, hello.number
        return replies


def echo_request(message: ClockMessage, t: int) -> bytes:
    """Return the far end's reply to a request that arrived at t (100 ns), or empty bytes for any other message."""
    if message.id == CLOCK_PAIR:
        return struct.pack("<BB", HEADER, CLOCK_PAIR) + message.data + struct.pack("<q", t)
    if message.id != CLOCK_TIME:
        return b""
    late = (t // TICKS - int.from_bytes(message.data, "little")) % 2**32
    return struct.pack("<BB", HEADER, CLOCK_TIME) + message.data + struct.pack("<H", min(late, LONGEST_UPLINK))
