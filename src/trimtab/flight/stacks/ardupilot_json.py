"""Messages between ArduPilot's SITL and a physics simulator: ArduPilot sends servo pulses as a packet, and the
simulator answers with the motion as a line of JSON.

    uint16 magic, 18458 with 16 channels or 29569 with 32      uint16 frame rate (Hz)      uint32 frame count
    uint16 pulse of each channel (µs)                          all little-endian

The answer is a line of JSON between two line feeds. ArduPilot searches the text for the keys. So the text has no space
after a colon, and no key begins with the name of an earlier key.

Source: https://github.com/ArduPilot/ardupilot/blob/master/libraries/SITL/examples/JSON/readme.md.
"""

import json
import math
import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

CHANNELS_OF: Mapping[int, int] = {18458: 16, 29569: 32}
"""Number of servo channels in a packet, by the packet's magic number."""
MOST_CHANNELS = 32
HEAD = struct.Struct("<HHI")
COUNTS = 2**32
"""Number of different values of the frame count, which then wraps around to zero."""


class PulsePacket(NamedTuple):
    """Servo packet from ArduPilot.

    rate: frame rate (Hz).  number: frame count.  pulses: pulse width of each channel (µs), or 0 for no pulse.
    """

    rate: int
    number: int
    pulses: tuple[int, ...]


class PhysicsState(NamedTuple):
    """Motion of the vehicle that is sent to ArduPilot or PX4.

    Position and velocity are in the world frame W. The attitude is roll, pitch and yaw (rad). Other vectors are in the
    body frame B. All values are in SI units.
    """

    specific_force: Sequence[float]
    angular_rate: Sequence[float]
    position: Sequence[float]
    attitude: Sequence[float]
    velocity: Sequence[float]
    airspeed: float

    @property
    def is_finite(self) -> bool:
        """Return True if all values are finite numbers."""
        vectors = self.specific_force, self.angular_rate, self.position, self.attitude, self.velocity
        return all(math.isfinite(x) for v in (*vectors, (self.airspeed,)) for x in v)


def parse_servos(packet: bytes) -> PulsePacket | str:
    """Return the content of a servo packet from ArduPilot, or a text with the reason if the packet is not valid."""
    if len(packet) < HEAD.size:
        return f"a packet of {len(packet)} bytes is too short for an ArduPilot frame"
    magic, rate, count = HEAD.unpack_from(packet)
    channels = CHANNELS_OF.get(magic)
    if channels is None:
        return f"the packet starts with {magic}; ArduPilot frames start with {' or '.join(map(str, CHANNELS_OF))}"
    length = HEAD.size + 2 * channels
    if len(packet) != length:
        return f"the packet has {len(packet)} bytes, but a frame of {channels} channels must have {length} bytes"
    if rate == 0:
        return "the frame rate is zero; set ArduPilot's SIM_RATE_HZ"
    return PulsePacket(rate, count, struct.unpack_from(f"<{channels}H", packet, HEAD.size))


def format_state(t: float, state: PhysicsState) -> bytes:
    """Return the answer to ArduPilot, a line of JSON with the motion at t (s)."""
    roll, pitch, yaw = state.attitude
    content = {
        "timestamp": t,
        "imu": {"gyro": [*state.angular_rate], "accel_body": [*state.specific_force]},
        "position": [*state.position],
        "attitude": [wrap_turn(roll), pitch, wrap_turn(yaw)],
        "velocity": [*state.velocity],
        "airspeed": state.airspeed,
    }
    return b"\n" + json.dumps(content, separators=(",", ":")).encode() + b"\n"


def wrap_turn(angle: float) -> float:
    """Return an angle (rad) wrapped to the range from -pi to pi."""
    return math.remainder(angle, 2 * math.pi)
