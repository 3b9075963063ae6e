"""Black box of a board: records of the last flights, written by the firmware.

This module reads the records from a dump of the flash sectors, made by a debug probe. The layout in flash is described
in `firmware/portable/journal.h`, the content of a record in `record` of `firmware/portable/vehicle.c`.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trimtab.actuators.failsafe import CAUSES, MODES
from trimtab.core.errors import InputError

SECTOR = 0x20000
"""Size (bytes) of each of the two flash sectors of an STM32F405 that contain the black box."""
HEADER, RECORD, ERASED = 16, 32, 0x45524153
PULSE_COUNTS_PER_SECOND = 2e6
FAN_DRIVE = ("rudder", "thrust fan", "lift fan")
"""Names of the outputs of a board with a fan drive. The records of such a board also contain the fan's speed."""
MOST_PULSES = 4
"""Maximum number of pulse widths in a record."""


class FlightRecord(NamedTuple):
    """Record of the black box. The firmware writes ten records a second while armed, and one record at each change of
    mode."""

    t: float
    """Time since the start of the board (s)."""
    mode: str
    cause: str
    armed: bool
    commanded: bool
    """True while the firmware obeys a command."""
    pulses: Mapping[str, float]
    """Pulse width (s) of each output, by the output's name. The outputs are the elements of the vehicle's command, or
    those of a fan drive."""
    rpm_command: int | None
    """Set-point of the fan's speed (rpm). This field and `speed_rpm` are None for a board without a fan drive."""
    speed_rpm: int | None
    command_age: float
    """Age of the newest command (s). 65.535 means at least 65.535 s."""
    late: int
    """Number of firmware periods that started late, since the start of the board."""


def read_black_box(
    dump: bytes, outputs: Sequence[str] = FAN_DRIVE, *, sector: int = SECTOR
) -> list[list[FlightRecord]]:
    """Return the records of a dump of both sectors, grouped by flight, oldest first.

    A new flight begins at a record whose time is less than the time of the record before.

    Records that are incomplete after a power failure are skipped.

    Args:
        dump: content of the flash.
        outputs: name of each output of the board, see `firmware_folder.output_names`.
        sector: size of a sector (bytes).

    Raises:
        InputError: the dump has a wrong size, no sector is in use, or there are more outputs than a record can contain.
    """
    if not 1 <= len(outputs) <= MOST_PULSES:
        problem = f"a board must have 1 to {MOST_PULSES} outputs, got {len(outputs)}: {', '.join(outputs)}"
        raise InputError(
            "outputs", problem, fix="set outputs=output_names(scenario), with the scenario of the firmware"
        )
    if len(dump) != 2 * sector:
        problem = f"the dump must contain two sectors of {sector} bytes each, got {len(dump)} bytes"
        raise InputError("black box", problem, fix="dump 0x40000 bytes of flash, starting at address 0x080C0000")
    sectors = [dump[:sector], dump[sector:]]
    used = sorted((number, data) for data in sectors if (number := _sector_number(data)) is not None)
    if not used:
        raise InputError(
            "black box",
            "neither sector was ever used",
            fix="dump 0x40000 bytes of flash, starting at address 0x080C0000",
        )
    flights: list[list[FlightRecord]] = []
    for number, data in used:
        for at in range(HEADER, sector - RECORD + 1, RECORD):
            tag, *words, seal = struct.unpack("<8I", data[at : at + RECORD])
            if _seal(number, tag, words) != seal:
                continue
            record = _flight_record(words, outputs)
            if not flights or record.t < flights[-1][-1].t:
                flights.append([])
            flights[-1].append(record)
    return flights


def _crc(crc: int, *words: int) -> int:
    """Return a CRC-32, continued over more bytes without the final inversion, as the firmware computes it."""
    return zlib.crc32(struct.pack(f"<{len(words)}I", *words), crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


def _seal(number: int, tag: int, words: list[int]) -> int:
    return _crc(0xFFFFFFFF, number, tag, *words)


def _sector_number(data: bytes) -> int | None:
    mark, number, commit = struct.unpack("<3I", data[:12])
    return number if mark == ERASED and commit == _crc(ERASED, number) else None


def _flight_record(words: list[int], outputs: Sequence[str]) -> FlightRecord:
    ms, state, *packed, speed_age, late = words
    counts = struct.unpack("<4H", struct.pack("<2I", *packed))
    (wanted,) = struct.unpack("<h", struct.pack("<H", counts[3]))
    speed, age = struct.unpack("<hH", struct.pack("<I", speed_age))
    is_fan = tuple(outputs) == FAN_DRIVE
    return FlightRecord(
        t=ms * 1e-3,
        mode=MODES[state & 0xFF],
        cause=CAUSES[state >> 8 & 0xFF],
        armed=bool(state >> 16 & 1),
        commanded=bool(state >> 17 & 1),
        pulses={name: count / PULSE_COUNTS_PER_SECOND for name, count in zip(outputs, counts, strict=False)},
        rpm_command=wanted if is_fan else None,
        speed_rpm=speed if is_fan else None,
        command_age=age * 1e-3,
        late=late,
    )
