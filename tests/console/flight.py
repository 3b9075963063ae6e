"""A flight's end of a console's line, held by a test: rows of a few signals, and what pages wish."""

import json
import time

import numpy as np

from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.console_packets import HEAD

SIGNALS = {
    "estimate.age": 0.01,
    "link.silence": 0.0,
    "loop.overruns": 0.0,
    "vehicle.armed": 1.0,
    "vehicle.owned": 1.0,
    "link.connected": 1.0,
    "link.samples": 0.0,
    "link.lost": 0.0,
    "supervisor.mode": 1.0,
    "supervisor.cause": 2.0,
    "supervisor.check": 0.0,
    "downlink.imu.age": 0.02,
}
GAIN = {"path": "autopilot.law.k1", "slot": 0, "value": 1.0, "default": 1.0, "unit": "kg/s", "meaning": "Gain."}
HELLO = {
    "kind": "flight",
    "title": "a/test",
    "signals": [{"path": p, "unit": "s", "meaning": "", "kind": "real", "modes": None} for p in SIGNALS],
    "row_period": 0.02,
    "view": {"kind": "plain"},
    "set_points": {},
    "parameters": [GAIN],
    "supervisor": {"mode": "supervisor.mode", "cause": "supervisor.cause", "modes": [], "causes": [], "requests": []},
    "pilot": {"modes": ["manual", "damped"], "forward": {"meaning": ""}, "turn": {"meaning": ""}},
    "ages": [
        {"path": "estimate.age", "label": "estimate", "limit": 0.4},
        {"path": "downlink.imu.age", "label": "imu", "limit": 0.4},
    ],
}


class Flight:
    """Sends rows and messages as a flight does, and keeps what the console sends."""

    def __init__(self, line: ConsoleLine):
        self._line, self.values, self.t = line, dict(SIGNALS), 0.0
        self.wishes = []

    def send_row(self, **changed):
        """A row, later by its period."""
        self.values |= {path.replace("__", "."): value for path, value in changed.items()}
        self.t += 0.02
        row = HEAD.pack(self.t, time.monotonic()) + np.array(list(self.values.values()), "<f4").tobytes()
        self._line._send(b"r" + row)

    def send(self, kind, **content):
        self._line.send(kind, **content)

    def read(self, seconds=0.0):
        """What has come, after so long."""
        end = time.monotonic() + seconds
        while True:
            self.wishes += self._line.receive()
            if time.monotonic() >= end:
                return self.wishes
            time.sleep(0.005)

    def notes(self):
        return [w["text"] for w in self.wishes if w["type"] == "note"]


def parse(row):
    """Time and numbers of a row as a page gets it, by path."""
    t, _ = HEAD.unpack_from(row)
    return t, dict(zip(SIGNALS, np.frombuffer(row, "<f4", offset=HEAD.size).tolist(), strict=True))


def message(**content):
    return json.dumps(content)
