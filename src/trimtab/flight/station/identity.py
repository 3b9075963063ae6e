"""Identity of a scenario, which vehicle and autopilot compare by hash: name, version, messages, periods, and all
parameters of the world.

An identity maps the path of each setting to a text, e.g. "world.vehicle.mass" -> "2.6". The digest of an identity is
the first 8 bytes of the SHA-256 of its sorted lines. If the digests of vehicle and autopilot differ, the autopilot
requests the lines one by one, in MAVLink's message TUNNEL with private payload types:

    request    index (2)
    line       number of lines (2)   index (2)   digest (8)   "path=text" (UTF-8, cut at 116 bytes)

Source: https://mavlink.io/en/messages/common.html, TUNNEL.
"""

import hashlib
import struct
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import ms
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint

TUNNEL = "TUNNEL"
REQUEST_TYPE, LINE_TYPE = 0xF474, 0xF475
"""Payload types of the TUNNEL messages with a request and with a line, from the range for private use (32768 and
above)."""
REQUEST, LINE = struct.Struct("<H"), struct.Struct("<HH8s")
PAYLOAD = 128
MOST_NUMBERS = 4
"""Maximum number of elements of an array that is shown as numbers. A longer array is compared and shown by its hash."""
MOST_LINES = 4096
ASK_PERIOD, LINES_PERIOD, LINES_AT_ONCE = ms(500), ms(100), 5
MOST_ASKS = 4
"""Number of unanswered requests after which the vehicle is assumed not to report its identity."""


def format_value(value: Any) -> str:
    """Return the value of a setting as text: numbers with all digits, long arrays by their hash."""
    if isinstance(value, str | bool) or value is None:
        return str(value)
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "fiub":
        return str(value)
    texts = [repr(float(v)) for v in numbers.ravel()]
    if len(texts) <= MOST_NUMBERS:
        return " ".join(texts)
    return f"{len(texts)} numbers, hash {hashlib.sha256(' '.join(texts).encode()).hexdigest()[:12]}"


def digest_number(digest: bytes) -> int:
    """Convert a digest to a whole number that is exact in a command's parameter, a 32-bit float. Without a digest,
    return 0."""
    return int.from_bytes(digest[:3], "little") | 1 if digest else 0


def identity_digest(entries: Mapping[str, str]) -> bytes:
    """Return the digest of an identity, eight bytes."""
    lines = sorted(f"{path}={text}" for path, text in entries.items())
    return hashlib.sha256("\n".join(lines).encode()).digest()[:8]


class IdentityService:
    """MAVLink service of a vehicle that sends the identity of the vehicle's scenario line by line."""

    def __init__(self, endpoint: Endpoint, entries: Mapping[str, str]) -> None:
        """entries: text of each setting in the identity, by path."""
        self._endpoint, self._entries = endpoint, dict(sorted(entries.items()))
        self._digest = identity_digest(self._entries)

    def change(self, path: str, value: Any) -> None:
        """Change the value of a setting in the identity. A setting that is not in the identity is ignored."""
        if path in self._entries:
            self._entries[path] = format_value(value)
            self._digest = identity_digest(self._entries)

    @property
    def number(self) -> int:
        """Digest of the vehicle's current identity, as a whole number. A request to arm must contain the same
        number."""
        return digest_number(self._digest)

    def answer(self, message: Message) -> list[bytes]:
        """Return the packets that answer a message, or an empty list if the message is not an identity request to this
        vehicle."""
        index = _parse_request(message)
        if index is None or message.get("target_system") not in (0, self._endpoint.system) or not self._entries:
            return []
        path = list(self._entries)[min(index, len(self._entries) - 1)]
        line = cut_line(path, self._entries[path])
        head = LINE.pack(len(self._entries), min(index, len(self._entries) - 1), self._digest)
        return [pack_tunnel(self._endpoint, message.system, message.component, LINE_TYPE, head + line)]


class SettingDifference(NamedTuple):
    """Setting that differs between autopilot (`ours`) and vehicle (`theirs`). A text is empty if that side does not
    have the setting."""

    path: str
    theirs: str
    ours: str

    def __str__(self) -> str:
        return f"{self.path}: {self.theirs or 'none'} on the vehicle, {self.ours or 'none'} here"


class IdentityComparison:
    """Comparison of identities at the autopilot's end, which requests the vehicle's identity and lists the settings
    that differ.

    Times `now` are by the autopilot's clock, in 100 ns.
    """

    def __init__(self, endpoint: Endpoint, entries: Mapping[str, str]) -> None:
        """entries: text of each setting in the autopilot's identity, by path."""
        self._endpoint, self._entries = endpoint, dict(entries)
        self._digest = identity_digest(self._entries)
        self._lines: dict[int, bytes] = {}
        self._count, self._asks, self._next = 0, 0, 0
        self._theirs = self._known = b""
        self.is_known = False
        """True while the complete identity of the vehicle is known, or its digest equals that of the autopilot's
        identity."""

    @property
    def is_unanswered(self) -> bool:
        """True if the vehicle does not report its identity."""
        return not self._theirs and self._asks > MOST_ASKS

    @property
    def number(self) -> int:
        """Digest of the vehicle's identity as a whole number, for requests to arm, or 0 if the vehicle reports no
        identity."""
        return digest_number(self._known)

    def due(self, now: int, system: int, component: int) -> list[bytes]:
        """Return the packets that must be sent now to request the vehicle's identity.

        After the comparison, a request is still sent regularly, because a setting may change.
        """
        if self.is_unanswered or now < self._next:
            return []
        if self.is_known:
            self._next = now + ASK_PERIOD
            return [pack_tunnel(self._endpoint, system, component, REQUEST_TYPE, REQUEST.pack(0))]
        missing = [k for k in range(self._count) if k not in self._lines][:LINES_AT_ONCE] or [0]
        self._next = now + (LINES_PERIOD if self._theirs else ASK_PERIOD)
        self._asks += not self._theirs
        return [pack_tunnel(self._endpoint, system, component, REQUEST_TYPE, REQUEST.pack(k)) for k in missing]

    def handle_message(self, message: Message) -> None:
        """Handle an answer of the vehicle. Other messages are ignored."""
        data = bytes(message.get("payload")[: message.get("payload_length")])
        if message.get("payload_type") != LINE_TYPE or len(data) < LINE.size:
            return
        count, index, digest = LINE.unpack_from(data)
        if digest != self._theirs or count != self._count:  # first answer, or a setting has changed
            self._theirs, self._count, self._lines = digest, min(count, MOST_LINES), {}
        self._lines[index] = data[LINE.size :]
        self.is_known = digest == self._digest or len(self._lines) >= self._count
        self._known = digest if self.is_known else self._known

    def differences(self, is_accepted: Callable[[str], bool] = lambda path: False) -> list[SettingDifference]:
        """Return the differing settings that are not accepted, sorted by path. The list is empty until the vehicle's
        identity is known."""
        if not self.is_known or self._theirs == self._digest:
            return []
        theirs = dict(_split_line(line) for line in self._lines.values())
        ours = dict(_split_line(cut_line(path, text)) for path, text in self._entries.items())
        return [
            SettingDifference(path, theirs.get(path, ""), ours.get(path, ""))
            for path in sorted({*theirs, *ours})
            if theirs.get(path) != ours.get(path) and not is_accepted(path)
        ]


def cut_line(path: str, text: str) -> bytes:
    """Return the line "path=text" of a setting, cut to the length that can be sent."""
    return f"{path}={text}".encode()[: PAYLOAD - LINE.size].decode("utf-8", "ignore").encode()  # no partial character


def _split_line(line: bytes) -> tuple[str, str]:
    path, _, text = line.decode("utf-8", "replace").partition("=")
    return path, text


def _parse_request(message: Message) -> int | None:
    if message.name != TUNNEL or message.get("payload_type") != REQUEST_TYPE:
        return None
    return REQUEST.unpack(bytes(message.get("payload")[: REQUEST.size]))[0]


def pack_tunnel(endpoint: Endpoint, system: int, component: int, kind: int, data: bytes) -> bytes:
    """Return the packet of a TUNNEL message. kind: payload type.  data: payload, at most 128 bytes."""
    fields = {"target_system": system, "target_component": component, "payload_type": kind}
    payload = tuple(data.ljust(PAYLOAD, b"\0"))
    return endpoint.pack(TUNNEL, fields | {"payload_length": len(data), "payload": payload})
