import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.core.time import ms, to_seconds
from trimtab.wire.minimal import (
    ClockTimeMessage,
    Cricket,
    InertialRecord,
    MinimalEndpoint,
    ModeLift,
    ServoCommand,
    VehicleStatus,
    data_rate,
)

SMALL = st.integers(-32768, 32767)
TRIPLE = st.tuples(SMALL, SMALL, SMALL)
DOWN = st.one_of(
    st.builds(InertialRecord, TRIPLE, TRIPLE, TRIPLE, st.integers(0, 65535)),
    st.builds(Cricket, st.binary(max_size=255)),
    st.builds(ClockTimeMessage, st.integers(0, 2**32 - 1), st.integers(0, 65535)),
    st.builds(VehicleStatus, st.binary(max_size=255)),
)
UP = st.one_of(
    st.builds(ServoCommand, st.integers(0, 65535), SMALL),
    st.builds(ClockTimeMessage, st.integers(0, 2**32 - 1), st.none()),
    st.builds(ModeLift, st.integers(0, 255), st.integers(0, 255)),
)
RECORD = InertialRecord((1, -2, 3), (-4, 5, -6), (7, -8, 9), 40000)


def ends():
    return MinimalEndpoint("ground", loopback=True), MinimalEndpoint("vehicle", loopback=True)


def test_frames_are_those_of_the_specification():
    """Header, id, optional length, data; the record of 23 bytes; 4 bytes up and 6 down for the clock."""
    ground, vehicle = ends()
    record = struct.pack(">B9hH", 3, 1, -2, 3, -4, 5, -6, 7, -8, 9, 40000)
    total = sum(struct.unpack(">10H", record[1:]), 3) % 65536
    assert vehicle.pack(RECORD) == b"\xa5\x01" + record + total.to_bytes(2, "big")
    assert len(vehicle.pack(RECORD)) == 2 + 23
    assert vehicle.pack(Cricket(b"abc")) == b"\xa5\x02\x03abc"
    assert ground.pack(ServoCommand(1500, -6000)) == b"\xa5\x03" + struct.pack("<Hh", 1500, -6000)
    assert ground.pack(ClockTimeMessage(1000)) == b"\xa5\x04" + struct.pack("<I", 1000)
    assert vehicle.pack(ClockTimeMessage(1000, 41)) == b"\xa5\x04" + struct.pack("<IH", 1000, 41)
    assert ground.pack(ModeLift(2, 200)) == b"\xa5\x05\x02\xc8"
    assert vehicle.pack(VehicleStatus(b"ok")) == b"\xa5\x06\x02ok"


@pytest.mark.parametrize(
    ("divider", "imu", "rest", "total"), [(1, 38.15, 2.85, 41.0), (2, 19.07, 2.93, 22.0), (3, 12.72, 3.48, 16.2)]
)
def test_data_rates_of_the_latency_table(divider, imu, rest, total):
    """[1] table 5.1: 41.0, 22.0 and 16.2 kb/s down, with the inertial unit at 152.588 Hz, its half and its third.

    What is not the unit's is that of the other messages: 2.85 to 3.48 kb/s, in the specification.
    """
    frame = len(MinimalEndpoint("vehicle").pack(RECORD))
    own = data_rate([(frame, 1 / to_seconds(ms(6.5536)) / divider)]) / 1e3
    assert own == pytest.approx(imu, abs=0.005)
    assert own + rest == pytest.approx(total, abs=0.05)


def test_commands_at_fifty_hertz_take_three_kilobits_a_second():
    """[1] table 5.1 has 2.9 up: the layout of the command is reconstructed, and 0.1 too much is left unexplained."""
    frame = len(MinimalEndpoint("ground", loopback=True).pack(ServoCommand(1500, 0)))
    assert data_rate([(frame, 50)]) == 3000.0


@given(st.lists(DOWN, max_size=20), st.integers(1, 40))
def test_what_goes_down_arrives_in_any_pieces(messages, piece):
    ground, vehicle = ends()
    sent = b"".join(map(vehicle.pack, messages)) + vehicle.pack(RECORD)
    got = [m for k in range(0, len(sent), piece) for m in ground.feed(sent[k : k + piece])]
    assert got == [*messages, RECORD]
    assert ground.garbage == 0


@given(st.lists(UP, min_size=1, max_size=20), st.binary(max_size=40).filter(lambda b: 0xA5 not in b))
def test_what_goes_up_arrives_after_garbage(messages, garbage):
    ground, vehicle = ends()
    sent = garbage + b"".join(map(ground.pack, messages))
    assert vehicle.feed(sent + b"\xa5") == messages  # the first byte of the next one says that the last has ended
    assert vehicle.garbage == len(garbage)


@given(st.binary(max_size=600), st.lists(DOWN, min_size=1, max_size=5))
def test_any_garbage_is_followed_by_what_was_sent_in_the_end(garbage, messages):
    """A false header can hold what follows for one longest message; then the line is in step again."""
    ground, vehicle = ends()
    ground.feed(garbage)
    ground.feed(vehicle.pack(RECORD) * 30)
    got = ground.feed(b"".join(map(vehicle.pack, messages)) + vehicle.pack(RECORD))
    assert got[-len(messages) - 1 :] == [*messages, RECORD]


def test_a_damaged_inertial_record_is_dropped():
    frame = MinimalEndpoint("vehicle").pack(RECORD)
    for at in range(2, len(frame)):
        end = MinimalEndpoint("ground")
        damaged = frame[:at] + bytes([frame[at] ^ 0x10]) + frame[at + 1 :]
        assert end.feed(damaged + frame) == [RECORD]


def test_commands_are_refused_where_the_line_leaves_the_machine():
    ground, vehicle = MinimalEndpoint("ground"), MinimalEndpoint("vehicle")
    for command in (ServoCommand(1500, 0), ModeLift(1, 255)):
        with pytest.raises(InputError, match="refused over anything but loopback"):
            ground.pack(command)
    loose = MinimalEndpoint("ground", loopback=True)
    packets = loose.pack(ServoCommand(1500, 0)) + loose.pack(ModeLift(1, 1)) + loose.pack(ClockTimeMessage(5)) + b"\xa5"
    assert vehicle.feed(packets) == [ClockTimeMessage(5)]
    assert vehicle.refused == 2


def test_numbers_that_do_not_fit_are_put_to_the_nearest():
    ground, vehicle = ends()
    sent = ground.pack(ServoCommand(10**9, -(10**9))) + ground.pack(ServoCommand(math.nan, 2.9)) + b"\xa5"
    assert vehicle.feed(sent) == [ServoCommand(65535, -32768), ServoCommand(0, 2)]


def test_wrong_use_is_refused():
    with pytest.raises(InputError, match="vehicle, ground"):
        MinimalEndpoint("pilot")
    with pytest.raises(InputError, match="pack it at the other end"):
        MinimalEndpoint("ground").pack(RECORD)
