import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.flight.clock_time import (
    CLOCK_TIME,
    DOWN,
    LOAD_DOWN,
    LOAD_UP,
    UP,
    ClockMessage,
    ClockMessageParser,
    ClockTimeExchange,
    Hello,
    boot_digest,
    echo_request,
    parse_hello,
)


def test_clock_message_has_4_bytes_up_and_6_down():
    """Sizes of the thesis: CLOCK_TIME 4 bytes up, 2 more down; IMU 23; SERVO_CMD 4; one header byte and an id."""
    key, packet = ClockTimeExchange(1, b"abcdefgh").request(123_456_789)
    assert packet == bytes.fromhex("a504") + struct.pack("<I", 123_456)
    assert key == 123_456
    (message,) = ClockMessageParser(UP).feed(packet)
    down = echo_request(message, 123_456_789 + 412_345)  # 41.2 ms later, in units of 0.1 ms
    assert down == bytes.fromhex("a504") + struct.pack("<IH", 123_456, 413)
    assert (len(LOAD_UP), len(LOAD_DOWN)) == (6, 25)


@pytest.mark.parametrize("t", [0, 2**32 * 1000 - 1, 2**32 * 1000 * 5 + 777, 10**17])
def test_delay_is_correct_when_the_clock_wraps(t):
    codec = ClockTimeExchange(1)
    key, packet = codec.request(t)
    (reply,) = codec.read_replies(echo_request(*ClockMessageParser(UP).feed(packet), t + 50_000))
    assert reply.key == key
    assert abs(reply.uplink - 50_000) <= 1000


def test_delay_beyond_16_bit_range_gives_no_reply():
    codec = ClockTimeExchange(1)
    _, packet = codec.request(0)
    (message,) = ClockMessageParser(UP).feed(packet)
    assert len(codec.read_replies(echo_request(message, 65_534 * 1000))) == 1
    assert (
        codec.read_replies(echo_request(message, 65_535 * 1000))
        == codec.read_replies(echo_request(message, 10**9))
        == []
    )


def test_separate_clocks_exchange_full_time_stamps():
    codec = ClockTimeExchange(9, b"aaaaaaaa")
    (hello,) = ClockMessageParser(UP).feed(codec.pack_hello(2750))
    assert parse_hello(hello.data) == Hello(b"aaaaaaaa", 9, 2750)
    codec.read_replies(Hello(b"bbbbbbbb", 8, 5).pack())
    assert codec.shared is None  # of another session
    codec.read_replies(Hello(b"bbbbbbbb", 9, 5).pack())
    assert (codec.shared, codec.heard) == (False, 5)
    key, packet = codec.request(10**16 + 1)
    (reply,) = codec.read_replies(echo_request(*ClockMessageParser(UP).feed(packet), 7))
    assert reply == (key, 7 - (10**16 + 1))
    codec.read_replies(Hello(b"aaaaaaaa", 9, 6).pack())
    assert codec.shared is True
    assert len(boot_digest()) == 8
    assert boot_digest() == boot_digest()


@given(st.lists(st.binary(max_size=40)), st.integers(1, 9))
def test_parser_recovers_messages_after_garbage(pieces, size):
    parser = ClockMessageParser(DOWN)
    for piece in pieces:
        parser.feed(piece)
    found = []
    stream = bytes(32) + LOAD_DOWN * 3 + bytes((0xA5, CLOCK_TIME, 1, 2, 3, 4, 5, 6))
    for at in range(0, len(stream), size):
        found += parser.feed(stream[at : at + size])
    assert found[-1] == ClockMessage(CLOCK_TIME, bytes((1, 2, 3, 4, 5, 6)))
    assert found.count(ClockMessage(0x01, bytes(23))) == 3
