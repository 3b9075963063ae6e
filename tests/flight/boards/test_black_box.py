"""A dump of the board's flash read as flights."""

import struct
import zlib

import pytest

from trimtab.core.errors import InputError
from trimtab.flight.boards.black_box import SECTOR, read_black_box
from trimtab.flight.boards.firmware_folder import output_names
from trimtab.scenarios.build import build


def crc(words, state):
    """The firmware's checksum, bit by bit."""
    for word in words:
        for k in range(32):
            odd = (state ^ word >> k) & 1
            state = state >> 1 ^ (0xEDB88320 if odd else 0)
    return state


def sector_bytes(number, records):
    data = struct.pack("<3I", 0x45524153, number, crc([number], 0x45524153)) + b"\xff" * 4
    for words in records:
        data += struct.pack("<8I", 0, *words, crc([number, 0, *words], 0xFFFFFFFF))
    return data.ljust(SECTOR, b"\xff")


def words(ms, mode, wanted=0, speed=0):
    thrust = 3000 + wanted // 10
    return [
        ms,
        mode | 1 << 8 | 1 << 16,
        2800 | thrust << 16,
        4000 | (wanted & 0xFFFF) << 16,
        speed & 0xFFFF | 40 << 16,
        7,
    ]


def test_flights_are_read_in_order_over_both_sectors():
    assert zlib.crc32(struct.pack("<2I", 5, 6)) ^ 0xFFFFFFFF == crc([5, 6], 0xFFFFFFFF)  # it is CRC-32
    newer = sector_bytes(9, [words(300, 1, 6000, 5985), words(100, 1, -6000, -5970)])
    older = sector_bytes(8, [words(100, 1), words(200, 1)])
    first, second = read_black_box(newer + older)
    assert [r.t for r in first] == [0.1, 0.2, 0.3]
    assert [r.mode for r in first] == ["computer"] * 3
    (last,) = second
    assert (last.rpm_command, last.speed_rpm, last.late, last.armed) == (-6000, -5970, 7, True)
    assert last.pulses == pytest.approx({"rudder": 1.4e-3, "thrust fan": 1.2e-3, "lift fan": 2.0e-3})
    assert last.command_age == pytest.approx(0.04)


def test_damaged_record_is_skipped():
    data = bytearray(sector_bytes(1, [words(100, 1), words(200, 1), words(300, 1)]))
    data[16 + 32 + 9] ^= 4
    (flight,) = read_black_box(bytes(data) + b"\xff" * SECTOR)
    assert [r.t for r in flight] == [0.1, 0.3]


@pytest.mark.parametrize("dump", [b"", b"\xff" * 2 * SECTOR, b"\x00" * 2 * SECTOR])
def test_rejects_dump_without_black_box(dump):
    with pytest.raises(InputError, match="0x080C0000"):
        read_black_box(dump)


def test_pulses_are_named_after_the_command_of_the_vehicle():
    names = output_names(build("f16/gcas"))
    assert names == ("elevator", "aileron", "rudder", "throttle")
    pulses = [100, 1 | 1 << 8 | 1 << 16, 2400 | 3100 << 16, 2900 | 3600 << 16, 40 << 16, 7]
    ((row,),) = read_black_box(sector_bytes(1, [pulses]) + b"\xff" * SECTOR, names)
    assert row.pulses == pytest.approx({"elevator": 1.2e-3, "aileron": 1.55e-3, "rudder": 1.45e-3, "throttle": 1.8e-3})
    assert (row.rpm_command, row.speed_rpm, row.command_age) == (None, None, pytest.approx(0.04))


def test_rejects_more_outputs_than_a_record_holds():
    with pytest.raises(InputError, match="output_names"):
        read_black_box(sector_bytes(1, []) + b"\xff" * SECTOR, [f"motor[{k}]" for k in range(5)])
