import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.live.clock_time import (
    CLOCK_TIME,
    DOWN,
    LOAD_DOWN,
    LOAD_UP,
    UP,
    ClockTime,
    Hello,
    Message,
    Parser,
    appended,
    hello_of,
    this_boot,
)


def test_the_fields_are_those_of_the_source_four_bytes_up_and_two_more_down():
    """Spec 4.2: CLOCK_TIME fixed 4 up, +2 timer down; IMU 23; SERVO_CMD 4; one header byte and an id."""
    key, packet = ClockTime(1, b"abcdefgh").request(123_456_789)
    assert packet == bytes.fromhex("a504") + struct.pack("<I", 123_456)
    assert key == 123_456
    (message,) = Parser(UP).feed(packet)
    down = appended(message, 123_456_789 + 412_345)  # 41.2 ms later, in units of 0.1 ms
    assert down == bytes.fromhex("a504") + struct.pack("<IH", 123_456, 413)
    assert (len(LOAD_UP), len(LOAD_DOWN)) == (6, 25)


@pytest.mark.parametrize("t", [0, 2**32 * 1000 - 1, 2**32 * 1000 * 5 + 777, 10**17])
def test_the_clock_may_wrap(t):
    codec = ClockTime(1)
    key, packet = codec.request(t)
    (reply,) = codec.take(appended(*Parser(UP).feed(packet), t + 50_000))
    assert reply.key == key
    assert abs(reply.uplink - 50_000) <= 1000


def test_a_delay_that_two_bytes_do_not_hold_is_no_reply():
    codec = ClockTime(1)
    _, packet = codec.request(0)
    (message,) = Parser(UP).feed(packet)
    assert len(codec.take(appended(message, 65_534 * 1000))) == 1
    assert codec.take(appended(message, 65_535 * 1000)) == codec.take(appended(message, 10**9)) == []


def test_two_clocks_exchange_whole_times():
    codec = ClockTime(9, b"aaaaaaaa")
    (hello,) = Parser(UP).feed(codec.hello(2750))
    assert hello_of(hello.data) == Hello(b"aaaaaaaa", 9, 2750)
    codec.take(Hello(b"bbbbbbbb", 8, 5).pack())
    assert codec.shared is None  # of another session
    codec.take(Hello(b"bbbbbbbb", 9, 5).pack())
    assert (codec.shared, codec.heard) == (False, 5)
    key, packet = codec.request(10**16 + 1)
    (reply,) = codec.take(appended(*Parser(UP).feed(packet), 7))
    assert reply == (key, 7 - (10**16 + 1))
    codec.take(Hello(b"aaaaaaaa", 9, 6).pack())
    assert codec.shared is True
    assert len(this_boot()) == 8
    assert this_boot() == this_boot()


@given(st.lists(st.binary(max_size=40)), st.integers(1, 9))
def test_garbage_in_any_pieces_raises_nothing_and_good_messages_are_found_again(pieces, size):
    parser = Parser(DOWN)
    for piece in pieces:
        parser.feed(piece)
    found = []
    stream = bytes(32) + LOAD_DOWN * 3 + bytes((0xA5, CLOCK_TIME, 1, 2, 3, 4, 5, 6))
    for at in range(0, len(stream), size):
        found += parser.feed(stream[at : at + size])
    assert found[-1] == Message(CLOCK_TIME, bytes((1, 2, 3, 4, 5, 6)))
    assert found.count(Message(0x01, bytes(23))) == 3
