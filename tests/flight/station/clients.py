"""pymavlink's clients connected to a vehicle in the same program, in virtual time, with immediate answers."""

from collections import deque

import pytest
from flight.station.test_parameters import parameters

from trimtab.core.time import ms
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.standard_services import Station, Status

common = pytest.importorskip("pymavlink.dialects.v20.common", reason="pip install pymavlink")
MODES = {0: "MANUAL", 4: "HOLD", 15: "GUIDED"}


class Master:
    """A connection with mavutil's interface (`mav` sends, `recv_match` receives) that contains the vehicle."""

    mavlink20, WIRE_PROTOCOL_VERSION = staticmethod(lambda: True), "2.0"

    def __init__(self, dialect, services=(), lossy=None, **how):
        self.endpoint = Endpoint(dialect, 1, 1, unsigned=True)
        self.station = Station(
            self.endpoint, how.pop("parameters", None) or parameters(), MODES, services=services, **how
        )
        self.mav = common.MAVLink(self, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.target_system = self.target_component = 1
        self.now, self._queue, self._lossy, self.packets = 0, deque(), lossy, 0
        self.unknown = False
        self.source_system, self.source_component = 255, 190

    def fly(self, is_armed):
        self.station.status = Status(armed=is_armed)

    def write(self, packet):
        for message in self.endpoint.feed(bytes(packet)):
            self._take(self.station.handle_message(message, self.now).replies)

    def step(self, count=1):
        for _ in range(count):
            self.now += ms(1)
            self._take(self.station.due(self.now))

    def _take(self, packets):
        for packet in packets:
            self.packets += 1
            if self._lossy is None or not self._lossy(self.packets):
                messages = self.mav.parse_buffer(packet) or []
                self.unknown |= any(m.get_type().startswith(("BAD", "UNKNOWN")) for m in messages)
                self._queue.extend(messages)

    def recv_match(self, type=None, blocking=False, timeout=None, condition=None):
        names = (type,) if isinstance(type, str) else type
        for _ in range(1 + int((timeout or 0) * 1000)):
            while self._queue:
                message = self._queue.popleft()
                if names is None or message.get_type() in names:
                    return message
            self.step()
        return None

    def heard(self, name, steps=200):
        """All messages of a name received within a number of milliseconds."""
        self.step(steps)
        found = [m for m in self._queue if m.get_type() == name]
        self._queue.clear()
        return found
