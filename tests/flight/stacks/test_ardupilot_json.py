"""ArduPilot's frames and the answers to them, byte for byte as in its readme."""

import json
import math
import struct

import pytest

from trimtab.flight.stacks.ardupilot_json import PhysicsState, PulsePacket, format_state, parse_servos

PULSES = tuple(range(1000, 1016))
STATE = PhysicsState((0.1, 0.0, -9.8), (0.0, 1e-5, -0.2), (1.0, -2.0, -3.0), (0.1, 0.2, 4.0), (0.5, 0.0, 0.25), 0.6)


@pytest.mark.parametrize(("magic", "channels"), [(18458, 16), (29569, 32)])
def test_parses_frames_of_16_and_32_channels(magic, channels):
    pulses = tuple(range(1000, 1000 + channels))
    packet = bytes.fromhex("1a48" if magic == 18458 else "8173") + struct.pack("<HI", 400, 7)
    packet += b"".join(struct.pack("<H", p) for p in pulses)
    assert parse_servos(packet) == PulsePacket(400, 7, pulses)


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        (b"", "too short"),
        (struct.pack("<HHI", 18458, 400, 7), "8 bytes, but a frame of 16 channels must have 40"),
        (struct.pack("<HHI16H", 18459, 400, 7, *PULSES), "starts with 18459"),
        (struct.pack("<HHI16H", 29569, 400, 7, *PULSES), "a frame of 32 channels must have 72"),
        (struct.pack("<HHI16H", 18458, 400, 7, *PULSES) + b"\0", "41 bytes"),
        (struct.pack("<HHI16H", 18458, 0, 7, *PULSES), "frame rate is zero"),
    ],
)
def test_rejects_malformed_frame_with_a_reason(packet, why):
    refused = parse_servos(packet)
    assert isinstance(refused, str)
    assert why in refused


def test_the_answer_is_one_line_of_json_between_two_line_feeds():
    answer = format_state(0.25, STATE)
    assert answer.startswith(b'\n{"timestamp":0.25,')
    assert answer.endswith(b"}\n")
    assert answer.count(b"\n") == 2
    assert b": " not in answer  # ArduPilot reads on two characters after a key
    content = json.loads(answer)
    assert content["imu"] == {"gyro": [0.0, 1e-5, -0.2], "accel_body": [0.1, 0.0, -9.8]}
    assert content["position"] == [1.0, -2.0, -3.0]
    assert content["velocity"] == [0.5, 0.0, 0.25]
    assert content["attitude"] == [0.1, 0.2, pytest.approx(4.0 - 2 * math.pi)]
    assert content["airspeed"] == 0.6


def test_no_json_key_is_found_inside_an_earlier_one():
    """ArduPilot reads a key at the first occurrence of its letters."""
    text = format_state(1.0, STATE).decode()
    for key in json.loads(text) | json.loads(text)["imu"]:
        assert text.index(key) == text.index(f'"{key}":') + 1


def test_non_finite_motion_is_detected():
    assert STATE.is_finite
    assert not STATE._replace(airspeed=math.nan).is_finite
    assert not STATE._replace(position=(0.0, math.inf, 0.0)).is_finite
