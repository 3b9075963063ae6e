"""A link over one connection that may break and come back: serial lines, TCP, RFCOMM, Unix sockets."""

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
"""Bytes under way at most: what a slow link can't carry is dropped here and now, not seconds later."""
FIRST_WAIT, LONGEST_WAIT = 0.05, 2.0
"""Seconds between two attempts to connect: doubled after each that failed."""
STEADY = 1.0
"""A connection that lasted this long (s) makes the next attempt the first again."""
SLICE = 0.2
"""Longest single wait (s), so that a link closed by another thread is noticed."""
PIECE = 65536
"""Most bytes that one call takes."""
LONGEST_MUTE = 3.0
"""Seconds that a peer may say nothing good while another waits for its place."""
UNFIT = (errno.EMSGSIZE, errno.EINVAL, errno.ENOBUFS, errno.ENOMEM)
"""Errors that concern one packet, not the connection."""


class Dialer(Protocol):
    """Makes connections, and never waits for one."""

    def dial(self) -> int:
        """A connected descriptor that doesn't block, -1 while one is under way; OSError where an attempt failed."""
        ...

    def wait_event(self) -> tuple[int, int]:
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

    def __init__(self, dialer: Dialer, clock: Clock = SYSTEM_CLOCK) -> None:
        self._dialer, self._counts, self._lock = dialer, LinkCounters(), threading.RLock()
        self._clock = clock
        self._fd, self._rest, self._closed = -1, b"", False
        self._wait, self._next, self._since, self._vouched = FIRST_WAIT, 0.0, 0.0, 0.0
        self._connect()

    @property
    def statistics(self) -> LinkStatistics:
        """What it has carried."""
        return self._counts.statistics(self._fd >= 0)

    def receive(self, timeout: float) -> bytes | None:
        """The next piece of the stream; None when `timeout` seconds have passed without one."""
        deadline = self._seconds() + timeout
        while not self._closed:
            self._dismiss_mute()
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
        """Hand a packet to the system's buffer; False where that is full, or where nothing is connected."""
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
        """Whether it is the one peer's, who gets what is private."""
        return audience is not Audience.PUBLIC

    def accept_sender(self, *, is_private: bool = False) -> None:
        """The one peer that is connected has said something good: it may stay, whoever else waits."""
        self._vouched = self._seconds()

    def reply(self, packet: bytes) -> bool:
        """To the one peer there is."""
        return self.send(packet)

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

    def _seconds(self) -> float:
        return self._clock.monotonic_ns() / NS_PER_SECOND

    def _connect(self) -> int:
        """The descriptor of the connection, made now if it is due; -1: none."""
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
                self._counts.connections += 1
                self._since = self._vouched = now
            return self._fd

    def _dismiss_mute(self) -> None:
        """End a connection that has brought nothing good for long, if somebody waits for its place."""
        if self._fd < 0 or self._seconds() - self._vouched < LONGEST_MUTE:
            return
        fd, mask = self._dialer.wait_event()
        if fd >= 0 and wait_until_ready(fd, mask, 0.0):
            with self._lock:
                self._hang_up()

    def _pause(self, left: float) -> None:
        """Wait until it may be worth while to dial again, `left` seconds at most."""
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
        if self._rest:
            self._counts.count_dropped()
        self._fd, self._rest = -1, b""
        now = self._seconds()
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
                return self._counts.count_received(piece)
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


class LinkCounters:
    """Counters of one link since it was opened."""

    def __init__(self) -> None:
        self.bytes_in = self.bytes_out = self.packets_in = self.packets_out = self.dropped = 0
        self.connections = 0

    def count_received(self, packet: bytes) -> bytes:
        """A packet came in; it is given back."""
        self.bytes_in += len(packet)
        self.packets_in += 1
        return packet

    def count_sent(self, size: int) -> bool:
        """A packet of this size went out: True."""
        self.bytes_out += size
        self.packets_out += 1
        return True

    def count_dropped(self) -> bool:
        """A packet could not be sent: False."""
        self.dropped += 1
        return False

    def statistics(self, connected: bool) -> LinkStatistics:
        """All of it, as it stands; every connection after the first is a reconnection."""
        again = max(self.connections - 1, 0)
        into, out = (self.bytes_in, self.bytes_out), (self.packets_in, self.packets_out)
        return LinkStatistics(*into, *out, self.dropped, again, connected)


class ConnectingDialer:
    """Dials a peer.

    Args:
        make: a new socket.
        address: of the peer, as connect() takes it.
    """

    def __init__(self, make: Callable[[], socket.socket], address: Any) -> None:
        self._make, self._address = make, address
        self._under_way: socket.socket | None = None

    def dial(self) -> int:
        """The connected descriptor, -1 while the peer has not answered; OSError where it refuses."""
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
        """The socket that is being connected becomes writable."""
        return (-1, 0) if self._under_way is None else (self._under_way.fileno(), select.POLLOUT)

    def close(self) -> None:
        """Stop dialling."""
        if self._under_way is not None:
            self._under_way.close()
            self._under_way = None


class AcceptingDialer:
    """Takes one peer after the other from a listening socket; those who come meanwhile wait.

    Args:
        listener: bound; it is made to listen here.
        prepare: what to do to each connection.
        closed: what to do when it is given back.
    """

    def __init__(
        self,
        listener: socket.socket,
        prepare: Callable[[socket.socket], object] = lambda _: None,
        closed: Callable[[], object] = lambda: None,
    ) -> None:
        self._listener, self._prepare, self._closed = configure_socket(listener), prepare, closed
        listener.listen(4)

    def dial(self) -> int:
        """The peer that waits longest; -1 where none does."""
        try:
            peer, _ = self._listener.accept()
        except BlockingIOError:
            return -1
        with contextlib.suppress(OSError):
            self._prepare(peer)
        return configure_socket(peer).detach()

    def wait_event(self) -> tuple[int, int]:
        """The listening socket becomes readable."""
        return self._listener.fileno(), select.POLLIN

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()
        self._closed()


def _is_self_connection(s: socket.socket) -> bool:
    """Whether a socket that dialled a port of this machine at which nobody listens was given that port as its own."""
    try:
        return s.family in (socket.AF_INET, socket.AF_INET6) and s.getsockname() == s.getpeername()
    except OSError:
        return True


def configure_socket(s: socket.socket) -> socket.socket:
    """Non-blocking, with a small buffer for what is sent."""
    s.setblocking(False)
    with contextlib.suppress(OSError):
        s.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return s
