"""The black box of a board, read out: what the firmware recorded of its last flights.

A dump of the flash sectors that hold it, made by a debug probe, becomes rows. How a journal lies in flash is written in
`firmware/portable/journal.h`, what a record holds in `record` of `firmware/portable/vehicle.c`.
"""

import struct
import zlib
from typing import NamedTuple

from trimtab.actuators.failsafe import CAUSES, MODES
from trimtab.core.errors import InputError

SECTOR = 0x20000
"""Bytes of each of the two sectors of an STM32F405."""
HEADER, RECORD, ERASED = 16, 32, 0x45524153
PULSE_COUNTS_PER_SECOND = 2e6


class FlightRecord(NamedTuple):
    """One record: ten a second while armed, and one at each change of mode."""

    t: float
    """Since the start of the board (s)."""
    mode: str
    cause: str
    armed: bool
    commanded: bool
    """Whether a command was obeyed."""
    rudder_pulse: float
    """Width (s), as are the next two."""
    thrust_pulse: float
    lift_pulse: float
    wanted_rpm: int
    speed_rpm: int
    command_age: float
    """Of the newest command (s), 65.535 or more as that."""
    late: int
    """Ticks that came late since the start."""


def read_black_box(dump: bytes, sector: int = SECTOR) -> list[list[FlightRecord]]:
    """Records by flight, oldest first, of a dump of both sectors; a new flight begins where the board's time falls.

    Records that the failing power left half written are passed over.

    Raises:
        InputError: a dump of another size, or one in which no sector is in use.
    """
    if len(dump) != 2 * sector:
        problem = f"{len(dump)} bytes are not the two sectors of {sector}"
        raise InputError("black box", problem, fix="dump 0x40000 bytes from 0x080C0000 on")
    sectors = [dump[:sector], dump[sector:]]
    used = sorted((number, data) for data in sectors if (number := _sector_number(data)) is not None)
    if not used:
        raise InputError("black box", "neither sector was ever used", fix="dump 0x40000 bytes from 0x080C0000 on")
    flights: list[list[FlightRecord]] = []
    for number, data in used:
        for at in range(HEADER, sector - RECORD + 1, RECORD):
            tag, *words, seal = struct.unpack("<8I", data[at : at + RECORD])
            if _seal(number, tag, words) != seal:
                continue
            record = _flight_record(words)
            if not flights or record.t < flights[-1][-1].t:
                flights.append([])
            flights[-1].append(record)
    return flights


def _crc(crc: int, *words: int) -> int:
    """CRC-32 as the firmware goes on with it: its state, not inverted."""
    return zlib.crc32(struct.pack(f"<{len(words)}I", *words), crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


def _seal(number: int, tag: int, words: list[int]) -> int:
    return _crc(0xFFFFFFFF, number, tag, *words)


def _sector_number(data: bytes) -> int | None:
    mark, number, commit = struct.unpack("<3I", data[:12])
    return number if mark == ERASED and commit == _crc(ERASED, number) else None


def _flight_record(words: list[int]) -> FlightRecord:
    ms, state, pulses, lift_rpm, speed_age, late = words
    signed = struct.Struct("<Hh")
    lift, wanted = signed.unpack(struct.pack("<I", lift_rpm))
    speed, age = struct.unpack("<hH", struct.pack("<I", speed_age))
    return FlightRecord(
        t=ms * 1e-3,
        mode=MODES[state & 0xFF],
        cause=CAUSES[state >> 8 & 0xFF],
        armed=bool(state >> 16 & 1),
        commanded=bool(state >> 17 & 1),
        rudder_pulse=(pulses & 0xFFFF) / PULSE_COUNTS_PER_SECOND,
        thrust_pulse=(pulses >> 16) / PULSE_COUNTS_PER_SECOND,
        lift_pulse=lift / PULSE_COUNTS_PER_SECOND,
        wanted_rpm=wanted,
        speed_rpm=speed,
        command_age=age * 1e-3,
        late=late,
    )
