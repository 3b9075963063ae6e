"""A fake PX4, written only from PX4's documentation, its simulator module and MAVLink.

It hovers on HIL_SENSOR and HIL_GPS alone, with a complementary filter and feedback of position and
attitude. Source: https://docs.px4.io/main/en/simulation/; PX4-Autopilot,
src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp; messages by pymavlink.
"""

import math
import socket

import numpy as np
from pymavlink.dialects.v20 import common

EARTH = 6371000.0


class FakePx4:
    """Connects to a simulator, takes its samples and answers each, as PX4 does in lockstep."""

    def __init__(self, port, *, is_locked=True):
        self.socket = socket.create_connection(("127.0.0.1", port), 5)
        self.socket.settimeout(5)
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self.waiting, self.is_locked, self.fix, self.time = [], is_locked, None, 0
        self.socket.sendall(self.mav.heartbeat_encode(6, 12, 0, 0, 0).pack(self.mav))

    def receive(self):
        """Return the next HIL_SENSOR and keep GPS fixes received before it. None if the connection is closed."""
        while True:
            while self.waiting:
                message = self.waiting.pop(0)
                if message.get_type() == "HIL_GPS":
                    self.fix = message
                elif message.get_type() == "HIL_SENSOR":
                    assert message.time_usec > self.time
                    self.time = message.time_usec
                    return message
            try:
                data = self.socket.recv(4096)
            except ConnectionError:
                return None
            if not data:
                return None
            self.waiting += self.mav.parse_buffer(data) or []

    def answer(self, controls, *, armed, whole=False):
        """Send HIL_ACTUATOR_CONTROLS. While disarmed the outputs are zero, except with `whole`."""
        outputs = [*controls, *[0.0] * (16 - len(controls))] if armed or whole else [0.0] * 16
        mode, flags = 1 | (128 if armed else 0), int(self.is_locked)
        message = self.mav.hil_actuator_controls_encode(self.time, outputs, mode, flags)
        try:
            self.socket.sendall(message.pack(self.mav))
        except ConnectionError:
            return False
        return True

    def close(self):
        self.socket.close()


class Estimate:
    """Attitude from rates, corrected by the magnetic field; position and velocity from GPS and acceleration."""

    def __init__(self):
        self.attitude, self.p, self.v, self.home, self.time, self.field = (
            np.zeros(3),
            None,
            np.zeros(3),
            None,
            None,
            None,
        )
        self.w = np.zeros(3)

    def follow(self, sensor, fix):
        h = 0.0 if self.time is None else (sensor.time_usec - self.time) * 1e-6
        self.time = sensor.time_usec
        self.w = np.array([sensor.xgyro, sensor.ygyro, sensor.zgyro])
        force = np.array([sensor.xacc, sensor.yacc, sensor.zacc])
        if fix is not None and self.home is None:
            self.home = fix
            self.p = np.zeros(3)
        self.turn(h)
        if sensor.fields_updated & 0b111000000:
            self.lean_on_field(np.array([sensor.xmag, sensor.ymag, sensor.zmag]))
        if self.p is None:
            return
        self.p = self.p + h * self.v
        self.v = self.v + h * (matrix(self.attitude) @ force + [0, 0, 9.80665])
        if fix is not None:
            self.correct(fix)

    def turn(self, h):
        roll, pitch, _ = self.attitude
        p, q, r = self.w
        across = q * math.sin(roll) + r * math.cos(roll)
        rates = [
            p + across * math.tan(pitch),
            q * math.cos(roll) - r * math.sin(roll),
            across / math.cos(pitch),
        ]
        self.attitude = self.attitude + h * np.array(rates)

    def lean_on_field(self, field):
        """Correct the attitude towards the first measured field, taken level and facing north."""
        if self.field is None:
            self.field = field
        wanted = matrix(self.attitude).T @ self.field
        self.attitude = self.attitude - 0.05 * np.cross(wanted, field) / (self.field @ self.field)

    def correct(self, fix):
        north = math.radians((fix.lat - self.home.lat) * 1e-7) * EARTH
        east = math.radians((fix.lon - self.home.lon) * 1e-7) * EARTH * math.cos(math.radians(fix.lat * 1e-7))
        down = -(fix.alt - self.home.alt) * 1e-3
        self.p = self.p + 0.5 * (np.array([north, east, down]) - self.p)
        self.v = self.v + 0.5 * (np.array([fix.vn, fix.ve, fix.vd]) * 0.01 - self.v)


def matrix(attitude):
    """Rotation matrix from body to north-east-down."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(attitude), np.cos(attitude)
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )
