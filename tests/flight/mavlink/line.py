"""Records of every kind of number, a key, a clock, and the published format bit by bit."""

import hashlib
import struct
from typing import Any

import numpy as np

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Sample
from trimtab.flight.mavlink.keys import passphrase_key

NOW = 1_800_000_000.0
KEY = passphrase_key("correct-horse-battery-staple")


@record
class Every:
    """One field of each kind. Source: none, a test."""

    real: Scalar = quantity("m/s", "A speed; it costs < 5 & \"more\" */ '''.")
    angle: Scalar = quantity("rad", "An angle.", kind="angle")
    time: Scalar = quantity("100 ns", "A time.", kind="time")
    count: Scalar = quantity("1", "A count.", kind="count")
    word: Scalar = quantity("1", "A word.", kind="word")
    flag: Scalar = quantity("1", "A flag.", kind="flag")
    vector: Any = quantity("m", "Three numbers.", shape=(3,))


@record
class Wide:
    """A record too large for one payload. Source: none, a test."""

    covariance: Any = quantity("1", "A matrix.", shape=(8, 9))
    msg: Any = quantity("1", "A name that the generators use themselves.", shape=(5,))
    after: Any = part("Another record.")


def sample(value: Any) -> Sample:
    return Sample(value=value, t=np.int64(0), age=0.0, fresh=False, valid=False)


def every() -> Every:
    return Every(0.0, 0.0, np.int64(0), np.int32(0), np.uint32(0), False, np.zeros(3))


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = NOW

    def __call__(self) -> float:
        return self.now


def bit_by_bit(data: bytes) -> int:
    """CRC-16/MCRF4XX by its definition: polynomial 0x1021 reflected, initial value 0xFFFF, no final XOR."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value


def by_hand(definition, payload, sequence, system, component, key=None, link=0, stamp=0, flags=None):
    """A frame as https://mavlink.io/en/guide/serialization.html and message_signing.html describe it."""
    while len(payload) > 1 and payload[-1] == 0:
        payload = payload[:-1]
    flags = (1 if key else 0) if flags is None else flags
    head = bytes([len(payload), flags, 0, sequence, system, component]) + definition.id.to_bytes(3, "little")
    frame = b"\xfd" + head + payload
    frame += bit_by_bit(head + payload + bytes([definition.crc_extra])).to_bytes(2, "little")
    if key:
        frame += bytes([link]) + stamp.to_bytes(6, "little")
        frame += hashlib.sha256(key + frame).digest()[:6]
    return frame


def heartbeat(dialect, **how):
    definition = dialect.definitions["HEARTBEAT"]
    given = {"sequence": 0, "system": 9, "component": 1} | how
    return by_hand(definition, struct.pack("<IBBBBB", 5, 11, 0, 0x81, 4, 3), **given)


def stamp_at(seconds):
    """Time stamp in units of 10 us since 1 January 2015, 00:00 UTC."""
    return int((seconds - 1420070400) * 1e5)
