"""Parameter hash of PX4 and QGroundControl, recomputed bit by bit from values received by pymavlink."""

import struct

import pytest
from flight.station.clients import Master, common
from flight.station.test_parameters import parameters

from trimtab.flight.station.parameters import Parameters


def crc_by_bits(data):
    """CRC-32 with the reflected polynomial 0xEDB88320, initial value 0 and no final XOR."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value


@pytest.fixture
def master(dialect):
    return Master(dialect)


def bits(message):
    return struct.unpack("<I", bytes(message.get_msgbuf()[10:14]))[0]


def listed(master):
    master.mav.param_request_list_send(1, 1)
    return master.heard("PARAM_VALUE", 1000)


def test_parameter_list_begins_with_its_hash(master):
    first, *rest = listed(master)
    assert (first.param_id, first.param_type, first.param_index) == ("_HASH_CHECK", common.MAV_PARAM_TYPE_UINT32, 65535)
    assert first.param_count == len(rest) == 7
    data = b"".join(
        m.param_id.encode() + struct.pack("<f", m.param_value) for m in sorted(rest, key=lambda m: m.param_id)
    )
    assert bits(first) == crc_by_bits(data)


def test_hash_changes_with_a_value_and_returns(master):
    def ask():
        master.mav.param_request_read_send(1, 1, b"_HASH_CHECK", -1)
        return bits(master.recv_match("PARAM_VALUE"))

    before = ask()
    for value, same in ((3.0, False), (2.6, True)):
        master.mav.param_set_send(1, 1, b"WVI_MASS", value, 9)
        master.heard("PARAM_VALUE", 0)
        assert (ask() == before) == same


def test_station_ends_the_list_by_returning_the_hash(master):
    master.mav.param_request_list_send(1, 1)
    (first,) = master.heard("PARAM_VALUE", 10)
    master.mav.param_set_send(1, 1, b"_HASH_CHECK", first.param_value, common.MAV_PARAM_TYPE_UINT32)
    assert master.heard("PARAM_VALUE", 1000) == []


def test_list_requested_again_while_sending_has_no_hash(master):
    master.mav.param_request_list_send(1, 1)
    master.heard("PARAM_VALUE", 30)
    assert [m.param_id for m in listed(master)] == list(parameters().table())


def test_every_hash_keeps_its_bits_on_the_wire(dialect, monkeypatch):
    """Some hashes are NaN when read as float32, and a conversion would change their bits."""
    monkeypatch.setattr(Parameters, "digest", 0x7F812345)
    master = Master(dialect)
    master.mav.param_request_read_send(1, 1, b"_HASH_CHECK", -1)
    assert bits(master.recv_match("PARAM_VALUE")) == 0x7F812345
