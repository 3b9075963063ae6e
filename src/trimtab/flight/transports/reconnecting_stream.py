"""Link over one connection (serial line, TCP, RFCOMM or Unix socket), which reconnects after an interruption."""

import contextlib
import errno
import os
import select
import socket
import threading
from collections.abc import Callable
from typing import Any, Protocol

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock, wait_until_ready
from trimtab.core.interfaces import Audience, LinkStatistics

SEND_BUFFER_BYTES = 32 * 1024
"""Size of the send buffer (bytes). The buffer is small, so that a slow link drops data immediately instead of sending
it seconds later."""
FIRST_WAIT, LONGEST_WAIT = 0.05, 2.0
"""Shortest and longest time (s) between two attempts to connect. The time starts at the shortest and is doubled after
each failure."""
STEADY = 1.0
"""Duration (s) of a connection above which attempts to reconnect start with the shortest waiting time again."""
SLICE = 0.2
"""Longest single wait (s). The limit ensures that the receiving thread detects that another thread has closed the
link."""
PIECE = 65536
"""Maximum number of bytes that one call of `receive` reads."""
LONGEST_MUTE = 3.0
"""Time (s) without an accepted packet after which a peer loses the link to another peer that sends data."""
TRIAL = 0.3
"""Time (s) within which a new peer must send an accepted packet. Otherwise it loses the link to another peer that sends
data."""
UNFIT = (errno.EMSGSIZE, errno.EINVAL, errno.ENOBUFS, errno.ENOMEM)
"""Error codes (errno) that concern only one packet. After such an error, the connection is kept."""


class Dialer(Protocol):
    """Interface of an object that makes connections without blocking."""

    def dial(self) -> int:
        """Return a connected, non-blocking file descriptor, or -1 while connecting. Raise OSError if an attempt has
        failed."""
        ...

    def wait_event(self) -> tuple[int, int]:
        """Return file descriptor and poll mask of the event after which `dial` must be called again, or (-1, 0) if no
        event signals this."""
        ...

    def exchange(self, fd: int) -> int:
        """Return the file descriptor of another peer that has sent data, or -1 without such a peer.

        If there is such a peer, the current connection `fd` waits from then on.
        """
        ...

    def close(self) -> None:
        """Release all resources except the current connection."""
        ...


class StreamLink:
    """Link that sends bytes over one connection. After an interruption the link reconnects, first immediately, then at
    increasing intervals.

    One thread receives, and another thread may send. A packet is either dropped or written completely. The next packet
    is not written before the last bytes of this packet. Data that exceed the system's buffer are not queued.
    """

    def __init__(self, dialer: Dialer, clock: Clock = SYSTEM_CLOCK) -> None:
        self._dialer, self._counts, self._lock = dialer, LinkCounters(), threading.RLock()
        self._clock = clock
        self._fd, self._rest, self._closed = -1, b"", False
        self._wait, self._next, self._since, self._vouched = FIRST_WAIT, 0.0, 0.0, 0.0
        self._is_accepted = False
        self._connect()

    @property
    def statistics(self) -> LinkStatistics:
        """Return the statistics of the link."""
        return self._counts.statistics(self._fd >= 0)

    def receive(self, timeout: float) -> bytes | None:
        """Return the next received bytes, or None after `timeout` seconds without data."""
        deadline = self._seconds() + timeout
        while not self._closed:
            self._change_speaker()
            connection = self._connect()
            left = min(max(deadline - self._seconds(), 0.0), SLICE)
            if connection < 0:
                self._pause(left)
            elif wait_until_ready(connection, select.POLLIN | (select.POLLOUT if self._rest else 0), left):
                piece = self._read(self._counts.connections)
                if piece:
                    return piece
            if self._seconds() >= deadline:
                return None
        return None

    def send(self, packet: bytes, audience: Audience = Audience.ALL) -> bool:
        """Write a packet to the system's buffer. Return False if the buffer is full or there is no connection."""
        if audience is Audience.PUBLIC:
            return False
        with self._lock:
            if self._closed or self._connect() < 0 or not self._flush():
                return self._counts.count_dropped()
            written = self._write(packet)
            if not written:
                return self._counts.count_dropped()
            self._rest = packet[written:]
            return self._counts.count_sent(len(packet))

    def has_audience(self, audience: Audience) -> bool:
        """Return True unless the audience is PUBLIC, because the only peer of the link counts as private."""
        return audience is not Audience.PUBLIC

    def accept_sender(self, *, is_private: bool = False) -> None:
        """Accept the connected peer after a valid packet. The peer then keeps the link even if other peers wait."""
        self._vouched, self._is_accepted = self._seconds(), True

    def reply(self, packet: bytes) -> bool:
        """Send a packet to the only peer."""
        return self.send(packet)

    def fileno(self) -> int:
        """Return the file descriptor for select(), or -1 without a connection."""
        return self._fd

    def close(self) -> None:
        """Close the transport."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._hang_up()
            self._dialer.close()

    def _seconds(self) -> float:
        return self._clock.monotonic_ns() / NS_PER_SECOND

    def _connect(self) -> int:
        """Return the file descriptor of the connection, or -1 if not connected. If an attempt to connect is due, make
        it."""
        with self._lock:
            now = self._seconds()
            if self._fd >= 0 or self._closed or now < self._next:
                return self._fd
            try:
                self._fd = self._dialer.dial()
            except OSError:
                self._next = now + self._wait
                self._wait = min(2 * self._wait, LONGEST_WAIT)
                return -1
            if self._fd >= 0:
                self._take_line(self._fd)
            return self._fd

    def _take_line(self, fd: int) -> None:
        self._fd, self._is_accepted = fd, False
        self._since = self._vouched = self._seconds()
        self._counts.connections += 1

    def _change_speaker(self) -> None:
        """Give the link to another peer that sends data, if the current peer has sent no accepted packet for too
        long."""
        if self._fd < 0 or self._seconds() - self._vouched < (LONGEST_MUTE if self._is_accepted else TRIAL):
            return
        with self._lock:
            other = self._dialer.exchange(self._fd)
            if other >= 0:
                self._leave_line()
                self._take_line(other)

    def _pause(self, left: float) -> None:
        """Wait until the next attempt to connect, at most `left` seconds."""
        fd, mask = self._dialer.wait_event()
        due = self._next - self._seconds()
        if fd >= 0 and due <= 0:
            wait_until_ready(fd, mask, left)
        else:
            self._clock.wait(None, min(left, max(due, 0.001)))

    def _hang_up(self) -> None:
        if self._fd < 0:
            return
        with contextlib.suppress(OSError):
            os.close(self._fd)
        self._leave_line()
        now = self._seconds()
        if now - self._since >= STEADY:
            self._wait, self._next = FIRST_WAIT, now
        else:
            self._wait, self._next = min(2 * self._wait, LONGEST_WAIT), now + self._wait

    def _leave_line(self) -> None:
        if self._rest:
            self._counts.count_dropped()
        self._fd, self._rest = -1, b""

    def _read(self, connection: int) -> bytes | None:
        """Return received bytes, or None if no bytes have arrived or the connection has changed. connection: number of
        the expected connection."""
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
                return self._counts.count_received(piece)
            self._hang_up()
            return None

    def _flush(self) -> bool:
        """Write the remaining bytes of the last packet. Return True if this packet is complete and the connection is
        still open."""
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
        return not self._rest and self._fd >= 0

    def _write(self, data: bytes) -> int:
        """Write data, and return the number of written bytes. An error ends the connection, unless it concerns only
        this packet."""
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            if error.errno not in UNFIT:
                self._hang_up()
            return 0


class LinkCounters:
    """Counters of packets and bytes of one link since it was opened."""

    def __init__(self) -> None:
        self.bytes_in = self.bytes_out = self.packets_in = self.packets_out = self.dropped = 0
        self.connections = 0

    def count_received(self, packet: bytes) -> bytes:
        """Count a received packet and return it."""
        self.bytes_in += len(packet)
        self.packets_in += 1
        return packet

    def count_sent(self, size: int) -> bool:
        """Count a sent packet of `size` bytes. Return True, the result of `send`."""
        self.bytes_out += size
        self.packets_out += 1
        return True

    def count_dropped(self) -> bool:
        """Count a packet that could not be sent. Return False, the result of `send`."""
        self.dropped += 1
        return False

    def statistics(self, connected: bool) -> LinkStatistics:
        """Return the values of the counters. Every connection after the first counts as a reconnection."""
        again = max(self.connections - 1, 0)
        into, out = (self.bytes_in, self.bytes_out), (self.packets_in, self.packets_out)
        return LinkStatistics(*into, *out, self.dropped, again, connected)


class ConnectingDialer:
    """Dialer that connects to a given peer.

    Args:
        make: function that makes a new socket.
        address: address of the peer, for connect().
    """

    def __init__(self, make: Callable[[], socket.socket], address: Any) -> None:
        self._make, self._address = make, address
        self._under_way: socket.socket | None = None

    def dial(self) -> int:
        """Return the connected file descriptor, or -1 while the peer has not answered. Raise OSError if the peer
        refuses the connection."""
        if self._under_way is None:
            self._under_way = configure_socket(self._make())
            try:
                self._under_way.connect(self._address)
            except OSError as error:
                if error.errno == errno.EINPROGRESS:
                    return -1
                self.close()
                raise
        elif not wait_until_ready(self._under_way.fileno(), select.POLLOUT, 0.0):
            return -1
        error = self._under_way.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error or _is_self_connection(self._under_way):
            self.close()
            raise OSError(error or errno.ECONNREFUSED, "connect")
        connected, self._under_way = self._under_way, None
        return connected.detach()

    def wait_event(self) -> tuple[int, int]:
        """Return the event after which `dial` must be called again: the connecting socket is writable."""
        return (-1, 0) if self._under_way is None else (self._under_way.fileno(), select.POLLOUT)

    def exchange(self, fd: int) -> int:
        """Return -1, because this dialer has only one peer."""
        return -1

    def close(self) -> None:
        """Stop dialling."""
        if self._under_way is not None:
            self._under_way.close()
            self._under_way = None


def _is_self_connection(s: socket.socket) -> bool:
    """Return True if a socket is connected to itself. This happens if it connects to an unused local port and the
    system assigns this same port to it."""
    try:
        return s.family in (socket.AF_INET, socket.AF_INET6) and s.getsockname() == s.getpeername()
    except OSError:
        return True


def configure_socket(s: socket.socket) -> socket.socket:
    """Make a socket non-blocking, with a small send buffer, and return the socket."""
    s.setblocking(False)
    with contextlib.suppress(OSError):
        s.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return s
