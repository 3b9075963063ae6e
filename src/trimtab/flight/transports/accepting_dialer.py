"""Dialer for a listening socket. Several peers may connect, and the peer whose packets are accepted keeps the link."""

import contextlib
import os
import select
import socket
from collections.abc import Callable

from trimtab.flight.transports.reconnecting_stream import configure_socket

MOST_WAITING = 16
"""Maximum number of connections that wait for the link. If another peer connects, the oldest waiting connection is
closed."""


class AcceptingDialer:
    """Dialer that accepts peers from a listening socket. One peer has the link, and the others wait.

    Waiting peers that have sent data get the link before peers that have sent none.

    Args:
        listener: bound socket, on which the dialer calls listen().
        prepare: function that is called with the socket of each connection.
        closed: function that is called when the dialer is closed.
    """

    def __init__(
        self,
        listener: socket.socket,
        prepare: Callable[[socket.socket], object] = lambda _: None,
        closed: Callable[[], object] = lambda: None,
    ) -> None:
        self._listener, self._prepare, self._closed = configure_socket(listener), prepare, closed
        self._waiting: list[int] = []
        listener.listen(MOST_WAITING)

    def dial(self) -> int:
        """Return the file descriptor of a peer's connection, or -1 without a peer. Peers that have sent data are
        preferred, otherwise the peer that has waited longest."""
        self._accept_waiting()
        speakers = self._find_speakers()
        if not self._waiting:
            return -1
        fd = (speakers or self._waiting)[0]
        self._waiting.remove(fd)
        return fd

    def exchange(self, fd: int) -> int:
        """Exchange the current connection `fd` for the connection of a waiting peer that has sent data, and return the
        new one. The current connection then waits.

        Return -1 if no waiting peer has sent data.
        """
        self._accept_waiting()
        speakers = self._find_speakers()
        if not speakers:
            return -1
        self._waiting.remove(speakers[0])
        self._waiting.append(fd)
        return speakers[0]

    def _accept_waiting(self) -> None:
        for _ in range(MOST_WAITING):
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            with contextlib.suppress(OSError):
                self._prepare(peer)
            self._waiting.append(configure_socket(peer).detach())
            if len(self._waiting) > MOST_WAITING:
                os.close(self._waiting.pop(0))

    def _find_speakers(self) -> list[int]:
        """Return the waiting connections that have received data, in the order of connecting. Close connections that
        have ended."""
        heard = {fd: _count_waiting_bytes(fd) for fd in self._waiting}
        for fd, count in heard.items():
            if count == 0:
                self._waiting.remove(fd)
                os.close(fd)
        return [fd for fd, count in heard.items() if count]

    def wait_event(self) -> tuple[int, int]:
        """Return the event after which `dial` must be called again: the listening socket is readable."""
        return self._listener.fileno(), select.POLLIN

    def close(self) -> None:
        """Stop listening."""
        for fd in self._waiting:
            os.close(fd)
        self._waiting.clear()
        self._listener.close()
        self._closed()


def _count_waiting_bytes(fd: int) -> int | None:
    """Return 1 if a connection has unread bytes, 0 if the connection has ended, or None if it is open and has no unread
    bytes."""
    s = socket.socket(fileno=fd)
    try:
        return len(s.recv(1, socket.MSG_PEEK))
    except BlockingIOError:
        return None
    except OSError:
        return 0
    finally:
        s.detach()
