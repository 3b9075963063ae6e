"""A fake ArduPilot, written only from ArduPilot's readme and its parser.

Source: https://github.com/ArduPilot/ardupilot, libraries/SITL/examples/JSON/readme.md and SIM_JSON.cpp.
"""

import re
import socket
import struct

NUMBER = r"([-+0-9.eE]+)"
VECTOR = ",".join([NUMBER] * 3)


class FakeArduPilot:
    """Sends frames of pulses to the physics on a port, and reads what comes back."""

    def __init__(self, port, *, channels=16, rate=400):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.2)
        self.place, self.channels, self.rate, self.count = ("127.0.0.1", port), channels, rate, 0

    def send(self, pulses, count=None):
        """Send a frame. The remaining channels get no pulse."""
        count = self.count if count is None else count
        magic = {16: 18458, 32: 29569}[self.channels]
        servos = [*pulses, *[0] * (self.channels - len(pulses))]
        self.socket.sendto(struct.pack(f"<HHI{self.channels}H", magic, self.rate, count, *servos), self.place)
        self.count = count + 1

    def receive(self):
        """Return the state received, or None after a timeout."""
        try:
            data = self.socket.recv(65000)
        except TimeoutError:
            return None
        before, line, after = data.decode("ascii").split("\n")
        assert (before, after) == ("", "")
        keys = ("gyro", "accel_body", "position", "attitude", "velocity")
        state = {key: read_key(line, key, rf"\[{VECTOR}\]") for key in keys}
        return state | {key: read_key(line, key, NUMBER)[0] for key in ("timestamp", "airspeed")}

    def close(self):
        self.socket.close()


def read_key(line, key, pattern):
    """Return the numbers two characters after the first occurrence of a key, as ArduPilot's parser does."""
    match = re.match(pattern, line[line.index(key) + len(key) + 2 :])
    assert match, (key, line)
    return [float(number) for number in match.groups()]
