"""Endpoints against an implementation of the published format in line.py."""

import math
import os
import struct

import pytest
from flight.mavlink.line import KEY, NOW, bit_by_bit, by_hand, heartbeat, stamp_at
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.flight.machine import list_stamp_problems
from trimtab.flight.mavlink.endpoint import MOST_FALSE_STARTS, Endpoint, checksum
from trimtab.flight.mavlink.keys import create_key, passphrase_key

VALUES = [1234567890123, 1.5, -2.25, 7, 0.1, 0.2, 0.3, -5, 4000000000, 1, 1]
"""t, then what is left of SAMPLE_EVERY by size: real, angle, time, vector, count, word, valid, flag."""


def test_packed_frame_matches_the_published_format(dialect, pair, clock):
    a, _ = pair
    definition = dialect.definitions["SAMPLE_EVERY"]
    payload = struct.pack("<qddqdddiIBB", *VALUES)
    expected = by_hand(definition, payload, 0, 1, 1, KEY.secret, 0, stamp_at(clock.now))
    assert a.pack("SAMPLE_EVERY", VALUES) == expected


def test_checksum_matches_the_published_value():
    """The catalogue of parametrised CRC algorithms: CRC-16/MCRF4XX of "123456789" is 0x6F91."""
    assert checksum(b"12345678", ord("9")) == (0x6F91).to_bytes(2, "little")


def test_unstorable_stamps_are_reported_as_a_problem(dialect, clock, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    end = Endpoint(dialect, 1, 1, create_key(tmp_path / "key"), clock=clock)
    end.pack("HEARTBEAT")
    assert list_stamp_problems(end) == []
    monkeypatch.setattr(os, "pwrite", full)
    clock.now += 60
    end.store_stamps()
    end.pack("HEARTBEAT")
    (problem,) = list_stamp_problems(end)
    assert "could not be stored (failed attempts: 1): free space on the disk of the key" in problem
    end.close()


@given(st.binary(max_size=300), st.integers(0, 255))
def test_checksum_matches_its_bitwise_definition(data, extra):
    assert checksum(data, extra) == bit_by_bit(data + bytes([extra])).to_bytes(2, "little")


@given(st.lists(st.floats(), min_size=5, max_size=5), st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**32 - 1))
def test_numeric_fields_round_trip_exactly(dialect, reals, time, word):
    a, b = (Endpoint(dialect, s, 1, unsigned=True) for s in (1, 2))
    real, angle, *vector = reals
    given = {
        "t": time,
        "valid": 1,
        "real": real,
        "angle": angle,
        "time": -1,
        "count": 3,
        "word": word,
        "vector": vector,
    }
    (got,) = b.feed(a.pack("SAMPLE_EVERY", given))
    assert (got.name, got.system, got.component, got.get("t"), got.get("word")) == ("SAMPLE_EVERY", 1, 1, time, word)
    bits = struct.Struct("<5d")
    assert bits.pack(got.get("real"), got.get("angle"), *got.get("vector")) == bits.pack(*reals)
    assert got.fields()["time"] == -1


def test_text_field_round_trips(open_pair):
    a, b = open_pair
    (got,) = b.feed(a.pack("STATUSTEXT", {"severity": 3, "text": "déjà vu"}))
    assert got.get("text") == "déjà vu"


def test_accepts_signed_frame_of_the_published_format(dialect, pair, clock):
    _, b = pair
    (got,) = b.feed(heartbeat(dialect, key=KEY.secret, stamp=stamp_at(clock.now)))
    assert got.fields() == {
        "custom_mode": 5,
        "type": 11,
        "autopilot": 0,
        "base_mode": 0x81,
        "system_status": 4,
        "mavlink_version": 3,
    }
    assert got.is_signed
    assert b.counts.accepted == 1


@pytest.mark.parametrize(
    ("how", "count"),
    [
        ({"key": None}, "unsigned"),
        ({"key": bytes(32)}, "wrong_signature"),
        ({"system": 2}, "reflected"),
        ({"stamp": stamp_at(NOW)}, "stale"),
        ({"stamp": stamp_at(NOW - 3600)}, "stale"),
        ({"stamp": stamp_at(NOW + 86_400)}, "leading"),
    ],
)
def test_rejects_and_counts_invalid_signed_frames(dialect, pair, clock, how, count):
    _, b = pair
    frame = heartbeat(dialect, **({"key": KEY.secret, "stamp": stamp_at(clock.now)} | how))
    assert b.feed(frame) == []
    assert getattr(b.counts, count) == b.counts.refusals == 1


def test_refuses_mavlink_1(dialect, pair, open_pair):
    head = bytes([9, 0, 9, 1, 0])
    payload = struct.pack("<IBBBBB", 5, 11, 0, 0x81, 4, 3)
    frame = b"\xfe" + head + payload + bit_by_bit(head + payload + bytes([50])).to_bytes(2, "little")
    for end in (pair[1], open_pair[1]):
        assert end.feed(frame) == []
        assert end.counts.downgraded == end.counts.refusals == 1


def test_clearing_the_signed_flag_does_not_bypass_signing(dialect, pair, clock):
    """Downgrade attack: the same message without signature and with a corrected checksum."""
    _, b = pair
    assert b.feed(heartbeat(dialect, key=None, flags=0)) == []
    assert b.feed(heartbeat(dialect, key=KEY.secret, stamp=stamp_at(clock.now), flags=0)) == []
    assert b.counts.unsigned == 2
    assert b.counts.accepted == 0


def test_any_flipped_bit_rejects_a_signed_packet(dialect, pair, clock):
    _, b = pair
    frame = heartbeat(dialect, key=KEY.secret, stamp=stamp_at(clock.now))
    for at in range(len(frame)):
        for bit in range(8):
            b._rest = b""
            assert b.feed(frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]) == []
    b._rest = b""
    assert len(b.feed(frame)) == 1


def test_replayed_packets_are_rejected_and_counted(pair, clock):
    a, b = pair
    first, second = a.pack("HEARTBEAT"), a.pack("HEARTBEAT")
    assert len(b.feed(first + second)) == 2
    assert b.feed(first + second) == []
    assert b.counts.replayed == 2
    assert b.counts.lost == 0


def test_forged_packet_does_not_advance_the_stream_stamp(dialect, pair, clock):
    """pymavlink stores the stamp before it checks the signature, so that one forgery locks out the true sender."""
    a, b = pair
    far = heartbeat(dialect, system=1, key=bytes(32), stamp=2**48 - 1)
    assert b.feed(far) == []
    assert len(b.feed(a.pack("HEARTBEAT"))) == 1


def test_packet_recorded_before_a_restart_is_rejected_afterwards(dialect, pair, clock):
    """The published rule would accept such a packet for a minute."""
    a, b = pair
    recorded = a.pack("COMMAND_LONG", {"command": 400, "param1": 1.0})
    assert len(b.feed(recorded)) == 1
    clock.now += 5
    restarted = Endpoint(dialect, 2, 1, KEY, clock=clock)
    assert restarted.feed(recorded) == []
    assert restarted.counts.stale == 1


def test_peer_with_lagging_clock_is_accepted_after_following(dialect, pair, clock):
    _, b = pair
    late = Endpoint(dialect, 3, 1, KEY, clock=lambda: NOW - 30)
    assert b.feed(late.pack("HEARTBEAT")) == []
    assert len(late.feed(b.pack("HEARTBEAT"))) == 1
    assert len(b.feed(late.pack("HEARTBEAT"))) == 1


def test_untimely_packet_reports_its_lead_without_side_effect(dialect, pair, clock):
    _, b = pair
    before = b.stamps.last
    for difference, count in ((86_400, "leading"), (-120, "stale")):
        wrong = Endpoint(dialect, 3, 1, KEY, clock=lambda d=difference: clock.now + d)
        assert b.feed(wrong.pack("TIMESYNC", {"ts1": 77})) == []
        (untimely,) = b.untimely
        assert (untimely.message.name, untimely.message.get("ts1")) == ("TIMESYNC", 77)
        assert untimely.lead == pytest.approx(difference, abs=0.01)
        assert getattr(b.counts, count) == 1
    assert b.stamps.last == before
    b.feed(b"")
    assert b.untimely == []


def test_losses_are_counted_by_sequence_except_late_packets(open_pair):
    a, b = open_pair
    packets = [a.pack("HEARTBEAT") for _ in range(300)]
    b.feed(b"".join(packets[:10] + packets[13:200] + packets[290:]))
    assert b.counts.lost == 3 + 90
    b.feed(packets[11])
    assert b.counts.lost == 92


def test_discarded_packets_are_not_counted_lost(open_pair):
    a, b = open_pair
    packets = [a.pack("HEARTBEAT") for _ in range(120)]
    b.feed(b"".join(packets[:10]) + packets[10][:5])
    b.begin_anew()
    assert len(b.feed(b"".join(packets[100:110] + packets[112:]))) == 18
    assert (b.counts.lost, b.counts.garbage, b.counts.checksum) == (2, 0, 0)


def test_unknown_messages_are_skipped_with_their_payload(dialect, pair, open_pair, clock):
    strange = dialect.definitions["HEARTBEAT"]._replace(id=54321)
    inner = heartbeat(dialect, key=None)  # a frame inside the payload of another must not come out of it
    frame = by_hand(strange, inner + b"\1", 0, 9, 1)
    a, b = open_pair
    assert [m.system for m in b.feed(frame + a.pack("HEARTBEAT"))] == [1]
    assert b.counts.unknown == 1
    signed = by_hand(strange, inner + b"\1", 0, 9, 1, KEY.secret, 0, stamp_at(clock.now))
    a, b = pair
    assert [m.system for m in b.feed(signed + a.pack("HEARTBEAT"))] == [1]
    assert (b.counts.unknown, b.counts.unsigned) == (1, 0)


def test_wrongly_signed_unknown_message_hides_no_inner_frame(dialect, pair, clock):
    """The unknown message may be a truncated frame, followed by a valid frame in the bytes read as its payload."""
    strange = dialect.definitions["HEARTBEAT"]._replace(id=54321)
    inner = heartbeat(dialect, key=KEY.secret, stamp=stamp_at(clock.now))
    forged = by_hand(strange, inner + b"\1", 0, 9, 1, bytes(32), 0, stamp_at(clock.now))
    _, b = pair
    assert [m.name for m in b.feed(forged)] == ["HEARTBEAT"]
    assert b.counts.unknown == 0
    assert b.counts.garbage == len(forged) - len(inner)


def test_missing_extension_fields_are_read_as_zero(dialect, open_pair):
    definition = dialect.definitions["COMMAND_ACK"]
    short = by_hand(definition, struct.pack("<HB", 400, 0), 0, 9, 1)
    (got,) = open_pair[1].feed(short)
    assert (got.get("command"), got.get("result"), got.get("target_system")) == (400, 0, 0)


def test_out_of_range_values_are_clamped_and_counted(open_pair):
    a, b = open_pair
    given = {"custom_mode": 2**40, "type": -3, "autopilot": math.nan, "base_mode": 2.9}
    (got,) = b.feed(a.pack("HEARTBEAT", given))
    assert [got.get(n) for n in given] == [2**32 - 1, 0, 0, 2]
    (got,) = b.feed(a.pack("PARAM_SET", {"param_value": -1e300}))
    assert got.get("param_value") == -math.inf
    assert a.counts.clamped == 2


def test_invalid_arguments_are_rejected_with_a_fix(dialect, open_pair):
    a, _ = open_pair
    with pytest.raises(InputError, match="write 'HEARTBEAT'"):
        a.pack("HEARTBEET")
    with pytest.raises(InputError, match="write 'custom_mode'"):
        a.pack("HEARTBEAT", {"costum_mode": 1})
    with pytest.raises(InputError, match="3 values, got 2"):
        a.pack("SAMPLE_EVERY", {"vector": [1, 2]})
    with pytest.raises(InputError, match="must have 11 values, got 1"):
        a.pack("SAMPLE_EVERY", [1])
    with pytest.raises(InputError, match="anyone could command"):
        Endpoint(dialect, 1, 1)
    with pytest.raises(InputError, match="unsigned was requested with a key"):
        Endpoint(dialect, 1, 1, passphrase_key("x" * 16), True)
    with pytest.raises(InputError, match="system must be from 1 to 255, got 0"):
        Endpoint(dialect, 0, 1, unsigned=True)


def test_frame_after_a_truncated_signature_is_still_read(pair):
    a, b = pair
    first, second = (a.pack("STATUSTEXT", {"text": text}) for text in ("one", "two"))
    (got,) = b.feed(first[:-4] + second)
    assert got.get("text") == "two"
    assert b.counts.wrong_signature == 1
    assert b.counts.garbage == len(first) - 4


@pytest.mark.parametrize("cut", [1, 9, 10, 20, 63])
def test_a_frame_in_two_datagrams_is_joined(dialect, clock, cut):
    """Bridges between a serial line and a network may split a frame: 64 bytes, then the rest."""
    there, here = Endpoint(dialect, 1, 1, KEY, clock=clock), Endpoint(dialect, 2, 1, KEY, clock=clock, datagrams=True)
    clock.now += 1
    frames = b"".join(there.pack("COMMAND_LONG", {"param1": float(k)}) for k in range(3))
    got = [m for data in (frames[:cut], frames[cut:]) for m in here.feed(data)]
    assert [m.get("param1") for m in got] == [0.0, 1.0, 2.0]
    assert here.counts.garbage == 0


def test_datagrams_of_different_senders_are_not_joined(dialect):
    there, other = Endpoint(dialect, 1, 1, unsigned=True), Endpoint(dialect, 3, 1, unsigned=True)
    here = Endpoint(dialect, 2, 1, unsigned=True, datagrams=True)
    frame = there.pack("COMMAND_LONG", {"param1": 1.0, "param7": 7.0})
    assert here.feed(frame[:20]) == []
    assert [m.system for m in here.feed(other.pack("COMMAND_LONG", {"param1": 2.0}))] == [3]
    assert [m.get("param1") for m in here.feed(frame[20:])] == [1.0]
    assert here.counts.garbage == 0


def test_incomplete_datagrams_are_counted_and_cause_no_delay(dialect):
    there, here = Endpoint(dialect, 1, 1, unsigned=True), Endpoint(dialect, 2, 1, unsigned=True, datagrams=True)
    for k in range(5):
        frame = there.pack("COMMAND_LONG", {"param1": float(k), "param7": 7.0})
        assert here.feed(frame[:30]) == []
        assert len(here.feed(there.pack("COMMAND_LONG"))) == 1
    assert here.counts.garbage == 4 * 30


@pytest.mark.parametrize("datagrams", [True, False])
def test_number_of_tried_false_frame_starts_is_bounded(dialect, datagrams, monkeypatch):
    there, here = Endpoint(dialect, 1, 1, unsigned=True), Endpoint(dialect, 2, 1, unsigned=True, datagrams=datagrams)
    tried = []
    read = here._read_frame
    monkeypatch.setattr(here, "_read_frame", lambda *a: tried.append(1) or read(*a))
    assert here.feed(b"\xfd" * 1400) == []
    assert here.feed(b"\xfe" * 1400) == []
    assert len(tried) <= MOST_FALSE_STARTS
    assert here.counts.garbage == 2800
    assert len(here.feed(there.pack("COMMAND_LONG"))) == 1
