"""Relay that disturbs the link between an autopilot and a vehicle, over datagrams or a pair of pseudo-terminals.

All packets pass through a separate thread. It requests real-time scheduling, as vehicle and autopilot do.
"""

import contextlib
import heapq
import os
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any

UP, DOWN = 0, 1
"""Directions: to the vehicle, to the autopilot."""
PRIORITY = 39
MOST_RECENT = 4000
"""Number of packets remembered for each direction."""
Bend = Callable[[bytes], list[tuple[float, bytes]]]
"""Function that returns the packets to send in place of a packet, each with its delay (s)."""


def bend_packet(bends: list[Bend], data: bytes) -> list[tuple[float, bytes]]:
    """Return the packets to send in place of a packet, each with its delay (s), after several changes in order."""
    packets = [(0.0, data)]
    for bend in bends:
        packets = [(delay + more, bent) for delay, whole in packets for more, bent in bend(whole)]
    return packets


class Relay:
    """Relay of all packets, by default without delay or change. Attributes may be changed at any time.

    bends: direction -> changes of a packet, in their order.
    recent_packets: direction -> packets that passed, the newest last.
    """

    def __init__(self, ends: "Datagrams | Terminals") -> None:
        self._ends = ends
        self.bends: tuple[list[Bend], list[Bend]] = [], []
        self.recent_packets: tuple[deque[bytes], deque[bytes]] = deque(maxlen=MOST_RECENT), deque(maxlen=MOST_RECENT)
        self.byte_counts = [0, 0]
        self._cut_until = [0.0, 0.0]
        self._delayed_packets: list[tuple[float, int, int, bytes]] = []
        self._count = 0
        self.longest_wait_s = 0.0
        """Longest excess of the thread's sleep (s). On a busy machine, packets wait that long in the relay."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut_line(self, seconds: float, directions: tuple[int, ...] = (UP, DOWN)) -> None:
        """Block the link for a time (s)."""
        for direction in directions:
            self._cut_until[direction] = monotonic() + seconds

    def send_bytes(self, direction: int, data: bytes) -> None:
        """Send bytes of the campaign itself to the vehicle (UP) or the autopilot (DOWN)."""
        self._ends.send_bytes(direction, data)

    def close(self) -> None:
        """Stop relaying packets."""
        self._stop.set()
        self._thread.join(2.0)
        self._ends.close()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        while not self._stop.is_set():
            due = self._delayed_packets[0][0] - monotonic() if self._delayed_packets else 0.05
            began, timeout = monotonic(), min(max(due, 0.0), 0.05)
            packets = self._ends.wait(timeout)
            self.longest_wait_s = max(self.longest_wait_s, monotonic() - began - timeout)
            for direction, data in packets:
                self._forward(direction, data)
            while self._delayed_packets and self._delayed_packets[0][0] <= monotonic():
                _, _, direction, data = heapq.heappop(self._delayed_packets)
                self._ends.send_bytes(direction, data)

    def _forward(self, direction: int, data: bytes) -> None:
        now = monotonic()
        self.recent_packets[direction].append(data)
        self.byte_counts[direction] += len(data)
        if now < self._cut_until[direction]:
            return
        for delay, bent in bend_packet(self.bends[direction], data):
            if delay > 0:
                self._count += 1
                heapq.heappush(self._delayed_packets, (now + delay, self._count, direction, bent))
            else:
                self._ends.send_bytes(direction, bent)


class Datagrams:
    """Vehicle and autopilot connected by UDP on this machine."""

    def __init__(self) -> None:
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._vehicles = [free.getsockname()]
        self._near.bind(("127.0.0.1", 0))
        self._far.bind(("127.0.0.1", 0))
        self._near.setblocking(False)
        self._far.setblocking(False)
        self._pilot: Any = None
        self.listen = f"udp://127.0.0.1:{self._vehicles[0][1]}"
        self.link = f"udp://127.0.0.1:{self._near.getsockname()[1]}"

    def add_vehicle(self) -> str:
        """Add another vehicle to the link. Return its address to listen on."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._vehicles.append(free.getsockname())
        return f"udp://127.0.0.1:{self._vehicles[-1][1]}"

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """Return the packets that arrive, with their directions."""
        found = []
        for one in select.select([self._near, self._far], [], [], timeout)[0]:
            with contextlib.suppress(OSError):
                data, sender = one.recvfrom(65535)
                if one is self._near:
                    self._pilot = sender
                found.append((UP if one is self._near else DOWN, data))
        return found

    def send_bytes(self, direction: int, data: bytes) -> None:
        """Send bytes to the vehicle (UP) or the autopilot (DOWN). They may be lost."""
        with contextlib.suppress(OSError):
            if direction == UP:
                for vehicle in self._vehicles:
                    self._far.sendto(data, vehicle)
            elif self._pilot is not None:
                self._near.sendto(data, self._pilot)

    def close(self) -> None:
        """Close the ports."""
        self._near.close()
        self._far.close()


class Terminals:
    """Vehicle and autopilot with a serial device each, as paths in a folder. Each device can be unplugged."""

    def __init__(self, folder: Path) -> None:
        self._paths = folder / "to-vehicle", folder / "to-autopilot"
        self._pairs: list[tuple[int, int] | None] = [None, None]
        self._lock = threading.Lock()
        for which in (UP, DOWN):
            self.plug_device(which)
        self.listen, self.link = (f"serial://{path}?baud=115200" for path in self._paths)

    def plug_device(self, which: int) -> None:
        """Create or restore the serial device of the vehicle (UP) or the autopilot (DOWN)."""
        import pty
        import tty

        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._paths[which].unlink(missing_ok=True)
        self._paths[which].symlink_to(os.ttyname(slave))
        with self._lock:
            self._pairs[which] = master, slave

    def unplug_device(self, which: int) -> None:
        """Remove a device. A program that has it open gets an error."""
        self._paths[which].unlink(missing_ok=True)
        with self._lock:
            pair, self._pairs[which] = self._pairs[which], None
            for one in pair or ():
                os.close(one)

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """Return the packets that arrive, with their directions."""
        found = []
        masters = {pair[0]: 1 - which for which, pair in enumerate(self._pairs) if pair}
        with contextlib.suppress(OSError, ValueError):
            ready = select.select(list(masters), [], [], min(timeout, 0.01))[0]
            with self._lock:
                there = {pair[0] for pair in self._pairs if pair}
                found += [(masters[one], os.read(one, 4096)) for one in ready if one in there]
        return found

    def send_bytes(self, direction: int, data: bytes) -> None:
        """Send bytes to one device. Bytes beyond its buffer are lost, as on a link without flow control."""
        with self._lock, contextlib.suppress(OSError):
            pair = self._pairs[direction]
            if pair:
                os.write(pair[0], data)

    def close(self) -> None:
        """Close the devices."""
        for which in (UP, DOWN):
            self.unplug_device(which)
