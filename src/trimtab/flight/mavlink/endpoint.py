"""Endpoint of a MAVLink 2 link: it packs messages to send, and parses and checks received bytes.

    0xFD  length  incompat  compat  sequence  system  component  id (3)  payload  checksum (2)  [link stamp (6) tag (6)]

The tag is the first 48 bits of SHA-256 over the key and all bytes before the tag. Zeros at the end of a payload are
omitted. Received data never raises an exception: refused frames are counted.
Source: https://mavlink.io/en/guide/serialization.html, https://mavlink.io/en/guide/message_signing.html.
"""

import dataclasses
import hashlib
import hmac
import re
import struct
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.flight.mavlink.authority import draw_session
from trimtab.flight.mavlink.definitions import Message, MessageDefinition, arrange_values, fit_values
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.keys import SigningKey
from trimtab.flight.mavlink.losses import SequenceGaps
from trimtab.flight.mavlink.stamps import MOST_STREAMS, Refusal, Stamps


@dataclasses.dataclass
class FrameCounts:
    """Counters since this endpoint was opened. They count frames unless another unit is stated."""

    sent: int = 0
    accepted: int = 0
    lost: int = 0
    """Number of lost frames, counted from the gaps in the senders' sequence numbers."""
    disordered: int = 0
    """Number of frames from senders whose sequence numbers jump, so that the number of their lost frames is unknown."""
    checksum: int = 0
    """Number of frames with a wrong checksum: damaged, or from a sender with other message definitions."""
    unknown: int = 0
    """Number of frames with a message that is not in this endpoint's dialect."""
    unsigned: int = 0
    downgraded: int = 0
    """Number of refused frames of MAVLink 1, which cannot be signed."""
    unchecked: int = 0
    """Number of signed frames that were accepted without a check of the signature, because this endpoint has no key."""
    wrong_signature: int = 0
    replayed: int = 0
    """Number of refused frames with a valid signature that had already been received (replayed frames)."""
    stale: int = 0
    """Number of refused frames with a valid signature but an old time stamp: over a minute, or before the start."""
    leading: int = 0
    """Number of refused frames with a valid signature whose time stamp is too far in the future."""
    reflected: int = 0
    """Number of refused frames with the system and component ids of this endpoint: its own frames, sent back."""
    garbage: int = 0
    """Bytes outside frames."""
    clamped: int = 0
    """Number of sent messages in which a value was limited to the range of its type."""

    @property
    def refusals(self) -> int:
        """Number of complete and undamaged frames that were refused."""
        strangers = self.unsigned + self.downgraded + self.wrong_signature
        return self.unknown + strangers + self.replayed + self.stale + self.leading + self.reflected


class UntimelyMessage(NamedTuple):
    """Message with a valid signature that was refused because of its time stamp.

    stamp: time stamp of the message.  lead: lead of this time stamp over the endpoint's clock (s).
    """

    message: Message
    stamp: int
    lead: float


class Numbering(NamedTuple):
    """Sequence numbers of the frames that one component sends to one group of receivers.

    A receiver counts gaps in the sequence numbers as lost frames. So a group of receivers that gets only some of a
    component's frames has a separate numbering.
    """

    component: int
    is_public: bool


VERSION_2, VERSION_1 = 0xFD, 0xFE
SIGNED_FLAG = 1
HEADER = struct.Struct("<BBBBBBBHB")
OVERHEAD, TAG = HEADER.size + 2, 13
NO_FRAME, NOT_YET = -1, 0
START = re.compile(rb"[\xfd\xfe]")
"""Pattern of the first byte of a frame, of MAVLink 2 or MAVLink 1."""
MOST_FALSE_STARTS = 32
"""Maximum number of false frame starts in one packet, so that a flood of them cannot delay the control loop."""


class Endpoint:
    """Endpoint of a link for one MAVLink system and component. It is not thread-safe.

    key: key that signs all sent packets. Received packets that are not signed with this key are refused. Without a key,
        set `unsigned`. Anyone with access to the link can then command the vehicle.
    datagrams: True if each call of `feed` passes a complete packet. A packet then never continues an incomplete frame.
    is_reset: True to start the time stamps with this computer's clock and ignore the stored time stamp.
    session: session number, which distinguishes this endpoint from other endpoints with the same system and component
        ids, also from the same program before a restart. None draws a random number.
    """

    def __init__(
        self,
        dialect: Dialect,
        system: int,
        component: int,
        key: SigningKey | None = None,
        unsigned: bool = False,
        *,
        link: int = 0,
        datagrams: bool = False,
        clock: Callable[[], float] | None = None,
        is_reset: bool = False,
        session: int | None = None,
    ) -> None:
        """Open the endpoint. If the key is from a file, time stamps are stored next to that file until close()."""
        _check_arguments(system, component, link, key, unsigned)
        self.dialect, self.system, self.component, self.link = dialect, system, component, link
        self.session = draw_session() if session is None else session
        self.counts, self._datagrams, self._rest = FrameCounts(), datagrams, b""
        self._sequences: dict[Numbering, int] = {}
        self._gaps: defaultdict[tuple[int, int, int], SequenceGaps] = defaultdict(SequenceGaps)
        self._keyed = None if key is None else hashlib.sha256(key.secret)
        self.stamps = None if key is None else _open_stamps(key, f"{system}-{component}-{link}", clock, is_reset)
        self.untimely: list[UntimelyMessage] = []
        """Messages in the last call of `feed` that were refused only because of their time stamp."""
        self.is_asked_by_stranger = False
        """True if a sender with this system id asked for the time without a valid signature, in the last `feed`."""
        own = (name for names in dialect.groups.values() for name in names)
        self._any_order = {"TIMESYNC", "TUNNEL", "COMMAND_ACK", *own}

    def pack(self, name: str, values: Mapping[str, Any] | Sequence[Any] | bytes = ()) -> bytes:
        """Return the bytes of a message.

        Args:
            name: name of a message of the dialect.
            values: values by field name, where missing fields get their default; or all values in the order of the
                payload; or the payload as bytes.

        Numbers outside the range of their type are limited to this range, and counted. An unknown message or field
        raises InputError.
        """
        definition = self.dialect.definitions.get(name)
        if definition is None:
            near = closest(name, self.dialect.definitions) or list(self.dialect.groups)
            raise InputError("wire", f"no message {name!r}", choices=near, fix=f"write {near[0]!r}")
        self.counts.sent += 1
        numbering = Numbering(self.component, False)
        if isinstance(values, bytes):
            return self._make_frame(definition, values.rstrip(b"\0") or b"\0", numbering)
        if not len(values):
            values = definition.blank_values
        elif isinstance(values, Mapping):
            values = arrange_values(definition, values)
        try:
            payload = definition.packing.pack(*values)
        except (struct.error, OverflowError, TypeError, ValueError):
            payload = definition.packing.pack(*fit_values(definition, values))
            self.counts.clamped += 1
        return self._make_frame(definition, payload.rstrip(b"\0") or b"\0", numbering)

    def repack(self, frame: bytes) -> bytes:
        """Return a frame of this endpoint with a new sequence number and signature, for the ground stations."""
        _, length, _, _, _, _, component, low, high = HEADER.unpack_from(frame)
        definition = self.dialect.by_id[low | high << 16]
        return self._make_frame(definition, frame[HEADER.size : HEADER.size + length], Numbering(component, True))

    def forward(self, message: Message) -> bytes:
        """Return a frame that forwards a message of another component of this system to the ground stations."""
        definition = message.definition
        payload = definition.packing.pack(*message.values).rstrip(b"\0") or b"\0"
        return self._make_frame(definition, payload, Numbering(message.component, True))

    def _make_frame(self, definition: MessageDefinition, payload: bytes, numbering: Numbering) -> bytes:
        flags = SIGNED_FLAG if self._keyed else 0
        number, sequence = definition.id, self._sequences.get(numbering, 0)
        head = (VERSION_2, len(payload), flags, 0, sequence, self.system, numbering.component)
        frame = HEADER.pack(*head, number & 0xFFFF, number >> 16) + payload
        frame += checksum(frame[1:], definition.crc_extra)
        self._sequences[numbering] = (sequence + 1) & 0xFF
        if self.stamps is not None:
            frame += bytes((self.link,)) + self.stamps.next_stamp().to_bytes(6, "little")
            frame += self._signature_tag(frame)
        return frame

    def _signature_tag(self, frame: bytes) -> bytes:
        assert self._keyed is not None
        digest = self._keyed.copy()
        digest.update(frame)
        return digest.digest()[:6]

    def feed(self, data: bytes | None) -> list[Message]:
        """Process received bytes, and return the accepted messages, in the order of arrival. Raise no exceptions."""
        self.untimely, self.is_asked_by_stranger = [], False
        if not data:
            return []
        buffer, waiting, messages = self._rest + data, b"", []
        if self._datagrams and self._rest and self._starts_frame(data):  # `data` does not continue the incomplete frame
            buffer, waiting = data, self._rest
        rest = self._read_frames(buffer, messages)
        if self._datagrams and rest and waiting:
            self.counts.garbage += len(waiting)
        self._rest = rest or waiting
        return messages

    def _read_frames(self, buffer: bytes, messages: list[Message]) -> bytes:
        """Read all frames in a buffer. Return the bytes of an incomplete frame at its end.

        After MOST_FALSE_STARTS false frame starts, which cost time, the remaining bytes are dropped.
        """
        at, size, false_starts = 0, len(buffer), 0
        while at < size:
            found = START.search(buffer, at)
            if found is None or false_starts == MOST_FALSE_STARTS:
                self.counts.garbage += size - at
                return b""
            self.counts.garbage += found.start() - at
            at = found.start()
            used = (self._read_frame if buffer[at] == VERSION_2 else self._skip_old_frame)(buffer, at, messages)
            if used == NOT_YET:
                return buffer[at:]
            if used == NO_FRAME:
                false_starts += 1
                self.counts.garbage += 1
            at += max(used, 1)
        return b""

    def _starts_frame(self, data: bytes) -> bool:
        """Return True if a packet starts with a complete and undamaged frame of the dialect."""
        if len(data) < HEADER.size or data[0] != VERSION_2:
            return False
        _, length, flags, _, _, _, _, low, high = HEADER.unpack_from(data)
        definition, end = self.dialect.by_id.get(low | high << 16), HEADER.size + length
        if definition is None or flags & ~SIGNED_FLAG or len(data) < OVERHEAD + length + (TAG if flags else 0):
            return False
        return checksum(data[1:end], definition.crc_extra) == data[end : end + 2]

    def _read_frame(self, buffer: bytes, at: int, messages: list[Message]) -> int:
        """Read the frame that starts at index `at`, and append its message if it is accepted. Return the number of
        bytes of the frame, NO_FRAME if no valid frame starts there, or NOT_YET if more bytes are needed."""
        if len(buffer) - at < HEADER.size:
            return NOT_YET
        _, length, flags, compat, sequence, system, component, low, high = HEADER.unpack_from(buffer, at)
        definition = self.dialect.by_id.get(low | high << 16)
        if flags & ~SIGNED_FLAG or (length > definition.size if definition else compat):
            return NO_FRAME
        size = OVERHEAD + length + (TAG if flags else 0)
        if len(buffer) - at < size:
            return NOT_YET
        frame = buffer[at : at + size]
        if definition is None:
            return self._skip_unknown(buffer, at, size, flags)
        end = HEADER.size + length
        if checksum(frame[1:end], definition.crc_extra) != frame[end : end + 2]:
            self.counts.checksum += 1
            return NO_FRAME
        if self._keyed and flags and not hmac.compare_digest(self._signature_tag(frame[:-6]), frame[-6:]):
            self.counts.wrong_signature += 1
            self._note_stranger(definition.name, system)
            return NO_FRAME  # if this frame was cut off, the next frame starts inside the supposed signature
        values = definition.packing.unpack(frame[HEADER.size : end].ljust(definition.size, b"\0"))
        is_signed = bool(flags) and self._keyed is not None
        stream = frame[-TAG] if is_signed else 0
        message = Message(definition.name, values, definition, system, component, is_signed, stream)
        if self._is_acceptable(frame, message):
            self._count_lost((system, component, stream), sequence)
            messages.append(message)
            self.counts.accepted += 1
        return size

    def _is_acceptable(self, frame: bytes, message: Message) -> bool:
        if self.stamps is not None and not message.is_signed:
            self.counts.unsigned += 1
            self._note_stranger(message.name, message.system)
            return False
        if message.system == self.system and message.component == self.component:
            self.counts.reflected += 1
            return False
        if self.stamps is None:
            self.counts.unchecked += frame[2] == SIGNED_FLAG
            return True
        stream = message.system, message.component, frame[-TAG]
        stamp, ordered = int.from_bytes(frame[-12:-6], "little"), message.name not in self._any_order
        refusal = self.stamps.find_refusal(stream, stamp, ordered)
        if refusal is None:
            self.stamps.accept(stream, stamp, ordered)
            return True
        self.counts.replayed += refusal is Refusal.REPLAYED
        self.counts.stale += refusal is Refusal.STALE
        self.counts.leading += refusal is Refusal.LEADING
        if refusal is not Refusal.REPLAYED:
            self.untimely.append(UntimelyMessage(message, stamp, self.stamps.lead(stamp)))
        return False

    def _note_stranger(self, name: str, system: int) -> None:
        self.is_asked_by_stranger |= name == "TIMESYNC" and system == self.system

    def _skip_unknown(self, buffer: bytes, at: int, size: int, flags: int) -> int:
        """Skip a frame with an unknown message, whose checksum cannot be checked, if the signature is valid or another
        frame follows directly."""
        if self._keyed and flags:
            frame = buffer[at : at + size]
            whole = hmac.compare_digest(self._signature_tag(frame[:-6]), frame[-6:])
        else:
            whole = at + size == len(buffer) or buffer[at + size] in (VERSION_1, VERSION_2)
        self.counts.unknown += whole
        return size if whole else NO_FRAME

    def _skip_old_frame(self, buffer: bytes, at: int, _: list[Message]) -> int:
        """Skip and refuse a frame of MAVLink 1, which has no signature."""
        if len(buffer) - at < 6:
            return NOT_YET
        length, definition = buffer[at + 1], self.dialect.by_id.get(buffer[at + 5])
        if definition is None or length > definition.base:
            return NO_FRAME
        if len(buffer) - at < length + 8:
            return NOT_YET
        end = at + 6 + length
        if checksum(buffer[at + 1 : end], definition.crc_extra) != buffer[end : end + 2]:
            return NO_FRAME
        self.counts.downgraded += 1
        return length + 8

    def _count_lost(self, stream: tuple[int, int, int], sequence: int) -> None:
        if stream not in self._gaps and len(self._gaps) >= MOST_STREAMS:
            del self._gaps[next(iter(self._gaps))]
        lost, disordered = self._gaps[stream].follow(sequence)
        self.counts.lost = max(self.counts.lost + lost, 0)
        self.counts.disordered += disordered

    def begin_anew(self) -> None:
        """Treat the next frame of each sender as its first frame, so that discarded frames do not count as lost."""
        self._gaps.clear()
        self._rest = b""

    def store_stamps(self) -> None:
        """Store a future time stamp. Call this every few seconds, in a thread that may wait for a disk."""
        if self.stamps is not None:
            self.stamps.store_ahead()

    def close(self) -> None:
        """Store the last time stamp, and close the files of the endpoint."""
        if self.stamps is not None:
            self.stamps.close()

    def abandon(self) -> None:
        """Close the files of the endpoint without storing the time stamp, as the system does when a process dies."""
        if self.stamps is not None:
            self.stamps.abandon()


def checksum(data: bytes, extra: int) -> bytes:
    """Return the two bytes that end a frame: CRC-16/MCRF4XX of all bytes after the first, and of CRC_EXTRA.

    extra: CRC_EXTRA of the message, 0 to 255. A receiver with a different definition of the message has another
    CRC_EXTRA, and so refuses the frame.
    """
    return mcrf4xx(data + bytes((extra,))).to_bytes(2, "little")


def _open_stamps(key: SigningKey, name: str, clock: Callable[[], float] | None, is_reset: bool) -> Stamps:
    """Return the object that makes and checks the time stamps of an endpoint.

    name: part of the name of the file, next to the key, in which the time stamp is stored. It must be unique.
    """
    store = None if key.path is None else key.path.with_name(f"{key.path.name}.{name}.time")
    return Stamps(store, clock, is_reset=is_reset)


def _check_arguments(system: int, component: int, link: int, key: SigningKey | None, unsigned: bool) -> None:
    for what, value, low in (("system", system, 1), ("component", component, 1), ("link", link, 0)):
        if not low <= value <= 255:
            raise InputError("wire", f"{what} must be from {low} to 255, got {value}", fix=f"give {what}={max(low, 1)}")
    if key is None and not unsigned:
        problem = "no key: anyone could command the vehicle"
        raise InputError(
            "wire",
            problem,
            fix="pass a key, made by create_key(key_path('VEHICLE')), or on a loopback link pass unsigned=True",
        )
    if key is not None and (unsigned or len(key.secret) != 32):
        problem = (
            "unsigned was requested with a key" if unsigned else f"the key must have 32 bytes, got {len(key.secret)}"
        )
        raise InputError("wire", problem, fix="leave out either unsigned=True or the key; load a key by load_key()")
