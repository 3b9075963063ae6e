"""Relay of packets between a vehicle and its autopilots in virtual time. It has the attributes of `relay.Relay`."""

from collections import deque

from studies.live_faults.relay import DOWN, MOST_RECENT, UP, Bend, bend_packet
from trimtab.core.clock import NS_PER_SECOND
from trimtab.flight.virtual_network import Host, VirtualNetwork
from trimtab.flight.virtual_time import ACTION, VirtualTime

VEHICLE_PORT, RELAY_PORT = 14550, 14551
RELAY = "relay"


class VirtualEnds:
    """Addresses of a link in virtual time."""

    listen, link = f"udp://127.0.0.1:{VEHICLE_PORT}", f"udp://127.0.0.1:{RELAY_PORT}"


class VirtualRelay:
    """Relay of all packets, by default without delay or change. It has the attributes of `relay.Relay`."""

    def __init__(self, time: VirtualTime, network: VirtualNetwork) -> None:
        self._time, self._network = time, network
        self.bends: tuple[list[Bend], list[Bend]] = [], []
        self.recent_packets: tuple[deque[bytes], deque[bytes]] = deque(maxlen=MOST_RECENT), deque(maxlen=MOST_RECENT)
        self.byte_counts = [0, 0]
        self.longest_wait_s = 0.0
        self.vehicles = [Host("vehicle-1", VEHICLE_PORT)]
        self._cut_until = [0.0, 0.0]
        self.last_sent_up = 0
        """Time (ns) when an autopilot's packet was last passed on."""
        self._near, self._far = Host(RELAY, RELAY_PORT), Host(RELAY, RELAY_PORT + 1)
        self._pilot: Host | None = None
        network.names[RELAY_PORT] = RELAY
        network.answer_at(self._near, self._take_from_pilot)
        network.answer_at(self._far, lambda data, _: self._forward(DOWN, data))

    def cut_line(self, seconds: float, directions: tuple[int, ...] = (UP, DOWN)) -> None:
        """Block the link for a time (s)."""
        for direction in directions:
            self._cut_until[direction] = self._time.seconds + seconds

    def send_bytes(self, direction: int, data: bytes) -> None:
        """Send bytes of the campaign itself to the vehicle (UP) or the autopilot (DOWN)."""
        if direction == UP:
            for vehicle in self.vehicles:
                self._network.send(self._far, vehicle, data)
        elif self._pilot is not None:
            self._network.send(self._near, self._pilot, data)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def _take_from_pilot(self, data: bytes, sender: Host) -> None:
        self._pilot = sender
        self._forward(UP, data)

    def _forward(self, direction: int, data: bytes) -> None:
        self.recent_packets[direction].append(data)
        self.byte_counts[direction] += len(data)
        if self._time.seconds < self._cut_until[direction]:
            return
        for delay, bent in bend_packet(self.bends[direction], data):
            if delay > 0:
                at = self._time.now + round(delay * NS_PER_SECOND)
                self._time.add_event(at, ACTION, 0, lambda bent=bent: self._pass_on(direction, bent))
            else:
                self._pass_on(direction, bent)

    def _pass_on(self, direction: int, data: bytes) -> None:
        if direction == UP:
            self.last_sent_up = self._time.now
        self.send_bytes(direction, data)
