"""Connections of stream sockets that are made without waiting: towards a peer, and from one."""

import contextlib
import errno
import select
import socket
from collections.abc import Callable
from typing import Any

TUNE_SEND_BUFFER = 32 * 1024
"""Bytes under way at most: what a slow link can't carry is dropped here and now, not seconds later."""


def tuned(found: socket.socket) -> socket.socket:
    """Non-blocking, with a small buffer for what is sent."""
    found.setblocking(False)
    with contextlib.suppress(OSError):
        found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, TUNE_SEND_BUFFER)
    return found


class Calling:
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
            self._under_way = tuned(self._make())
            try:
                self._under_way.connect(self._address)
            except OSError as error:
                if error.errno == errno.EINPROGRESS:
                    return -1
                self.close()
                raise
        elif not _writable(self._under_way):
            return -1
        error = self._under_way.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error or _met_itself(self._under_way):
            self.close()
            raise OSError(error or errno.ECONNREFUSED, "connect")
        found, self._under_way = self._under_way, None
        return found.detach()

    def awaits(self) -> tuple[int, int]:
        """The socket that is being connected becomes writable."""
        return (-1, 0) if self._under_way is None else (self._under_way.fileno(), select.POLLOUT)

    def close(self) -> None:
        """Stop dialling."""
        if self._under_way is not None:
            self._under_way.close()
            self._under_way = None


class Answering:
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
        self._listener, self._prepare, self._closed = tuned(listener), prepare, closed
        listener.listen(4)

    def dial(self) -> int:
        """The peer that waits longest; -1 where none does."""
        try:
            found, _ = self._listener.accept()
        except BlockingIOError:
            return -1
        with contextlib.suppress(OSError):
            self._prepare(found)
        return tuned(found).detach()

    def awaits(self) -> tuple[int, int]:
        """The listening socket becomes readable."""
        return self._listener.fileno(), select.POLLIN

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()
        self._closed()


def _met_itself(found: socket.socket) -> bool:
    """Whether a socket that dialled a port of this machine at which nobody listens was given that port as its own."""
    try:
        return found.family in (socket.AF_INET, socket.AF_INET6) and found.getsockname() == found.getpeername()
    except OSError:
        return True


def _writable(found: socket.socket) -> bool:
    poll = select.poll()
    poll.register(found, select.POLLOUT)
    return bool(poll.poll(0))
