"""A link over one connection that may break and come back: serial lines, TCP, RFCOMM, Unix sockets."""

import contextlib
import errno
import os
import select
import threading
import time
from typing import Protocol

from trimtab.core.interfaces import LinkStatistics
from trimtab.links.counts import Counts
from trimtab.links.readiness import ready

FIRST_WAIT, LONGEST_WAIT = 0.05, 2.0
"""Seconds between two attempts to connect: doubled after each that failed."""
STEADY = 1.0
"""A connection that lasted this long (s) makes the next attempt the first again."""
SLICE = 0.2
"""Longest single wait (s), so that a link closed by another thread is noticed."""
PIECE = 65536
"""Most bytes that one call takes."""
UNFIT = (errno.EMSGSIZE, errno.EINVAL, errno.ENOBUFS, errno.ENOMEM)
"""Errors that concern one packet, not the connection."""


class Dialer(Protocol):
    """Makes connections, and never waits for one."""

    def dial(self) -> int:
        """A connected descriptor that doesn't block, -1 while one is under way; OSError where an attempt failed."""
        ...

    def awaits(self) -> tuple[int, int]:
        """Descriptor and poll mask that tell when to dial again; (-1, 0) where only time does."""
        ...

    def close(self) -> None:
        """Give back what is held besides the connection."""
        ...


class StreamLink:
    """Bytes over a connection; what breaks is dialled again, at first at once, then less and less often.

    One thread receives, another may send. A packet is written whole, or the rest of it before the next one, or it is
    dropped: what the system's buffer doesn't take is not queued here.
    """

    def __init__(self, dialer: Dialer) -> None:
        self._dialer, self._counts, self._lock = dialer, Counts(), threading.RLock()
        self._fd, self._rest, self._closed = -1, b"", False
        self._wait, self._next, self._since = FIRST_WAIT, 0.0, 0.0
        self._connection()

    @property
    def statistics(self) -> LinkStatistics:
        """What it has carried."""
        return self._counts.statistics(self._fd >= 0)

    def receive(self, timeout: float) -> bytes | None:
        """The next piece of the stream; None when `timeout` seconds have passed without one."""
        deadline = time.monotonic() + timeout
        while not self._closed:
            connection = self._connection()
            left = min(max(deadline - time.monotonic(), 0.0), SLICE)
            if connection < 0:
                self._pause(left)
            elif ready(connection, select.POLLIN | (select.POLLOUT if self._rest else 0), left):
                piece = self._read(self._counts.connections)
                if piece:
                    return piece
            if time.monotonic() >= deadline:
                return None
        return None

    def send(self, packet: bytes) -> bool:
        """Hand a packet to the system's buffer; False where that is full, or where nothing is connected."""
        with self._lock:
            if self._closed or self._connection() < 0 or not self._flush():
                return self._counts.drop()
            written = self._write(packet)
            if not written:
                return self._counts.drop()
            self._rest = packet[written:]
            return self._counts.sent(len(packet))

    def vouch(self) -> None:
        """Nothing to do: there is one peer, and it is connected."""

    def fileno(self) -> int:
        """For select(); -1 while there is no connection."""
        return self._fd

    def close(self) -> None:
        """Give the transport back."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._hang_up()
            self._dialer.close()

    def _connection(self) -> int:
        """The descriptor of the connection, made now if it is due; -1: none."""
        with self._lock:
            now = time.monotonic()
            if self._fd >= 0 or self._closed or now < self._next:
                return self._fd
            try:
                self._fd = self._dialer.dial()
            except OSError:
                self._next = now + self._wait
                self._wait = min(2 * self._wait, LONGEST_WAIT)
                return -1
            if self._fd >= 0:
                self._counts.connections += 1
                self._since = now
            return self._fd

    def _pause(self, left: float) -> None:
        """Wait until it may be worth while to dial again, `left` seconds at most."""
        fd, mask = self._dialer.awaits()
        due = self._next - time.monotonic()
        if fd >= 0 and due <= 0:
            ready(fd, mask, left)
        else:
            time.sleep(min(left, max(due, 0.001)))

    def _hang_up(self) -> None:
        if self._fd < 0:
            return
        with contextlib.suppress(OSError):
            os.close(self._fd)
        if self._rest:
            self._counts.drop()
        self._fd, self._rest = -1, b""
        now = time.monotonic()
        if now - self._since >= STEADY:
            self._wait, self._next = FIRST_WAIT, now
        else:
            self._wait, self._next = min(2 * self._wait, LONGEST_WAIT), now + self._wait

    def _read(self, connection: int) -> bytes | None:
        """What has come; None where nothing has, or where the connection (its number) is not the one looked at."""
        with self._lock:
            if self._fd < 0 or connection != self._counts.connections:
                return None
            if self._rest:
                self._flush()
            try:
                piece = os.read(self._fd, PIECE) if self._fd >= 0 else b""
            except BlockingIOError:
                return None
            except OSError:
                piece = b""
            if piece:
                return self._counts.received(piece)
            self._hang_up()
            return None

    def _flush(self) -> bool:
        """Write what is left of the last packet; whether nothing of it is left and the connection stands."""
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
        return not self._rest and self._fd >= 0

    def _write(self, data: bytes) -> int:
        """How many bytes were taken; an error that isn't the packet's ends the connection."""
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            if error.errno not in UNFIT:
                self._hang_up()
            return 0
