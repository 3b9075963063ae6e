"""Bad links for tests: a serial pair of two ptys, and a UDP relay, with seeded delay, jitter, loss and more.

The relay is also a program that needs only the standard library:

    python relays.py udp LISTEN_HOST:PORT TO_HOST:PORT --delay 0.04 --jitter 0.015 --loss 0.02 --seed 1
"""

import argparse
import contextlib
import heapq
import os
import pty
import random
import select
import socket
import threading
import time
import tty
from pathlib import Path
from typing import NamedTuple

LEFT, RIGHT = 0, 1
PROMPT = 45
"""Priority of a relay that is a program of its own."""


class Passage(NamedTuple):
    """One packet's passage through a relay. `delay` is the actual delay in s, or None for a lost packet."""

    side: int
    at: float
    delay: float | None


class Weather:
    """Disturbances of packets: delay + jitter N(0, 1) seconds, at least zero; loss; one flipped bit.

    Attributes may be changed at any time. cut: all packets are lost. ordered: a late packet delays the later ones.
    rate: bits per second (ten per byte), in addition to the delay; 0: unlimited.
    """

    def __init__(self, *, delay=0.0, jitter=0.0, loss=0.0, corruption=0.0, ordered=True, rate=0.0, seed=0):
        self.delay, self.jitter, self.loss, self.corruption = delay, jitter, loss, corruption
        self.ordered, self.rate, self.cut = ordered, rate, False
        self._random = [random.Random(2 * seed + side) for side in (LEFT, RIGHT)]
        self._last = [0.0, 0.0]
        self._free = [0.0, 0.0]

    def passes(self, side, now, data):
        """Arrival time and bytes of a packet sent from a side, or None if it is lost."""
        draw = self._random[side]
        z, lost, turned = draw.gauss(0, 1), draw.random() < self.loss, draw.random() < self.corruption
        if self.cut or lost:
            return None
        due = now + max(self.delay + self.jitter * z, 0.0)
        if self.rate:
            self._free[side] = max(self._free[side], now) + 10 * len(data) / self.rate
            due += self._free[side] - now
        if self.ordered:
            due = self._last[side] = max(due, self._last[side])
        if turned:
            data = bytearray(data)
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        return due, bytes(data)


class _Relay:
    """Reads from two sides and forwards packets when they are due, in its own thread."""

    def __init__(self, weather):
        self.weather, self.passages = weather, []
        self._queue, self._count, self._stop = [], 0, False
        self._wake, self._woken = os.pipe()
        self.lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self):
        self._thread.start()

    def stop(self):
        self._stop = True
        self.wake()
        self._thread.join(5.0)
        os.close(self._wake)
        os.close(self._woken)

    def wake(self):
        os.write(self._woken, b"!")

    def _run(self):
        while not self._stop:
            wait = None if not self._queue else max(self._queue[0][0] - time.monotonic(), 0.0)
            if self.full():
                wait = 0.002
            try:
                ready, _, _ = select.select([self._wake, *self.sides()], [], [], wait)
            except OSError:  # unplugged just now
                continue
            with self.lock:
                self._pass_on(ready)

    def full(self):
        """True while a side has not accepted all data."""
        return False

    def _pass_on(self, ready):
        if self._wake in ready:
            os.read(self._wake, 4096)
        for fd, side in self.sides().items():
            if fd in ready:
                self._take(side, fd)
        while self._queue and self._queue[0][0] <= time.monotonic():
            _, _, side, at, data = heapq.heappop(self._queue)
            self.passages.append(Passage(side, at, time.monotonic() - at))
            self.give(1 - side, data)

    def _take(self, side, fd):
        data, now = self.read(side, fd), time.monotonic()
        if not data:
            return
        fate = self.weather.passes(side, now, data)
        if fate is None:
            self.passages.append(Passage(side, now, None))
        else:
            self._count += 1
            heapq.heappush(self._queue, (fate[0], self._count, side, now, fate[1]))


class SerialPair(_Relay):
    """Two serial devices, `left` and `right` in a folder, joined by a disturbed cable. Either can be unplugged."""

    def __init__(self, folder, **weather):
        super().__init__(Weather(**weather))
        self.paths = (Path(folder) / "left", Path(folder) / "right")
        self._masters, self._slaves, self._rest = [-1, -1], [-1, -1], [b"", b""]
        for side in (LEFT, RIGHT):
            self._make(side)
        self.start()

    @property
    def uris(self):
        return tuple(f"serial://{path}?baud=115200" for path in self.paths)

    def _make(self, side):
        master, slave = pty.openpty()
        tty.setraw(slave)  # held open, so that nothing is echoed or hung up while nobody has it open
        os.set_blocking(master, False)
        self.paths[side].unlink(missing_ok=True)
        self.paths[side].symlink_to(os.ttyname(slave))
        self._masters[side], self._slaves[side] = master, slave

    def unplug(self, side):
        """Remove the device. Programs that have it open get an error."""
        with self.lock:
            self.paths[side].unlink()
            for ends in (self._slaves, self._masters):
                os.close(ends[side])
                ends[side] = -1
        self.wake()

    def plug(self, side):
        """Bring the device back under the same path."""
        with self.lock:
            self._make(side)
        self.wake()

    def sides(self):
        """Sides to read from. A side is left out while the other one is full."""
        return {fd: side for side, fd in enumerate(self._masters) if fd >= 0 and not self._rest[1 - side]}

    def full(self):
        for side in (LEFT, RIGHT):
            self.give(side, b"")
        return any(self._rest)

    def read(self, side, fd):
        try:
            return os.read(fd, 4096)
        except OSError:
            return b""

    def give(self, side, data):
        self._rest[side] += data
        try:
            if self._rest[side]:
                self._rest[side] = self._rest[side][os.write(self._masters[side], self._rest[side]) :]
        except BlockingIOError:
            pass
        except OSError:  # unplugged: lost
            self._rest[side] = b""

    def close(self):
        self.stop()
        for fd in (*self._masters, *self._slaves):
            if fd >= 0:
                os.close(fd)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class UdpRelay(_Relay):
    """Relays between the caller of its port (LEFT, the last sender) and a target (RIGHT)."""

    def __init__(self, target, listen=("127.0.0.1", 0), *, ordered=False, **weather):
        super().__init__(Weather(ordered=ordered, **weather))
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(listen)
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.connect(target)
        self._near.setblocking(False)
        self._far.setblocking(False)
        self._caller = None
        self.port = self._near.getsockname()[1]
        self.start()

    def sides(self):
        return {self._near.fileno(): LEFT, self._far.fileno(): RIGHT}

    def read(self, side, fd):
        try:
            if side == LEFT:
                data, self._caller = self._near.recvfrom(65535)
                return data
            return self._far.recv(65535)
        except OSError:
            return b""

    def give(self, side, data):
        with contextlib.suppress(OSError):
            if side == RIGHT:
                self._far.send(data)
            elif self._caller is not None:
                self._near.sendto(data, self._caller)

    def close(self):
        self.stop()
        self._near.close()
        self._far.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def _place(text):
    host, _, port = text.rpartition(":")
    return host, int(port)


def main():
    words = argparse.ArgumentParser()
    words.add_argument("kind", choices=("udp",))
    words.add_argument("listen", type=_place)
    words.add_argument("to", type=_place)
    for name in ("delay", "jitter", "loss", "corruption", "rate"):
        words.add_argument(f"--{name}", type=float, default=0.0)
    words.add_argument("--seed", type=int, default=0)
    asked = vars(words.parse_args())
    asked.pop("kind")
    with contextlib.suppress(OSError):  # a busy machine's delays on top are not asked for
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PROMPT))
    with UdpRelay(asked.pop("to"), asked.pop("listen"), **asked) as relay:
        print(f"relay at {relay.port}", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
