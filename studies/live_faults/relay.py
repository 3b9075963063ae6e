"""A line that is ours to spoil: between an autopilot and a vehicle, over datagrams or a pair of pseudo-terminals.

Everything passes through a thread of its own, which asks for real-time scheduling as the ends do.
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
"""Packets remembered of each direction."""
Bend = Callable[[bytes], list[tuple[float, bytes]]]
"""What becomes of a packet: delays in s, and bytes."""


class Relay:
    """Passes on what comes, at once and as it is, until told otherwise. Attributes may be changed at any time.

    bend: direction -> what becomes of a packet.  kept: direction -> the packets that passed, the newest last.
    """

    def __init__(self, ends: "Datagrams | Terminals") -> None:
        self._ends = ends
        self.bend: dict[int, Bend] = {}
        self.recent_packets: tuple[deque[bytes], deque[bytes]] = deque(maxlen=MOST_RECENT), deque(maxlen=MOST_RECENT)
        self.byte_counts = [0, 0]
        self._cut_until = [0.0, 0.0]
        self._delayed_packets: list[tuple[float, int, int, bytes]] = []
        self._count = 0
        self.longest_wait_s = 0.0
        """How much longer than asked for the thread has slept: on a busy machine packets wait that long here."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut_line(self, seconds: float, directions: tuple[int, ...] = (UP, DOWN)) -> None:
        """Nothing passes for this long."""
        for direction in directions:
            self._cut_until[direction] = monotonic() + seconds

    def send_bytes(self, direction: int, data: bytes) -> None:
        """Bytes of ours, to an end."""
        self._ends.send_bytes(direction, data)

    def close(self) -> None:
        """Leave both ends alone."""
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
        bend = self.bend.get(direction)
        for delay, bent in [(0.0, data)] if bend is None else bend(data):
            if delay > 0:
                self._count += 1
                heapq.heappush(self._delayed_packets, (now + delay, self._count, direction, bent))
            else:
                self._ends.send_bytes(direction, bent)


class Datagrams:
    """The ends over UDP of this machine."""

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
        """Where another vehicle on the same line is to listen."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._vehicles.append(free.getsockname())
        return f"udp://127.0.0.1:{self._vehicles[-1][1]}"

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """What comes, and which way it goes."""
        found = []
        for one in select.select([self._near, self._far], [], [], timeout)[0]:
            with contextlib.suppress(OSError):
                data, sender = one.recvfrom(65535)
                if one is self._near:
                    self._pilot = sender
                found.append((UP if one is self._near else DOWN, data))
        return found

    def send_bytes(self, direction: int, data: bytes) -> None:
        """To an end, or lost."""
        with contextlib.suppress(OSError):
            if direction == UP:
                for vehicle in self._vehicles:
                    self._far.sendto(data, vehicle)
            elif self._pilot is not None:
                self._near.sendto(data, self._pilot)

    def close(self) -> None:
        """Give the ports back."""
        self._near.close()
        self._far.close()


class Terminals:
    """The ends as two serial devices, paths in a folder; either can be unplugged."""

    def __init__(self, folder: Path) -> None:
        self._paths = folder / "to-vehicle", folder / "to-autopilot"
        self._pairs: list[tuple[int, int] | None] = [None, None]
        self._lock = threading.Lock()
        for which in (UP, DOWN):
            self.plug_device(which)
        self.listen, self.link = (f"serial://{path}?baud=115200" for path in self._paths)

    def plug_device(self, which: int) -> None:
        """A device of an end (UP: the vehicle's) is there, or there again."""
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
        """It is gone, with an error for who has it open."""
        self._paths[which].unlink(missing_ok=True)
        with self._lock:
            pair, self._pairs[which] = self._pairs[which], None
            for one in pair or ():
                os.close(one)

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """What comes, and which way it goes."""
        found = []
        masters = {pair[0]: 1 - which for which, pair in enumerate(self._pairs) if pair}
        with contextlib.suppress(OSError, ValueError):
            ready = select.select(list(masters), [], [], min(timeout, 0.01))[0]
            with self._lock:
                there = {pair[0] for pair in self._pairs if pair}
                found += [(masters[one], os.read(one, 4096)) for one in ready if one in there]
        return found

    def send_bytes(self, direction: int, data: bytes) -> None:
        """To an end; what has no room is lost, as on a line without flow control."""
        with self._lock, contextlib.suppress(OSError):
            pair = self._pairs[direction]
            if pair:
                os.write(pair[0], data)

    def close(self) -> None:
        """Give the devices back."""
        for which in (UP, DOWN):
            self.unplug_device(which)
