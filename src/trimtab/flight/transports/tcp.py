"""Link over a TCP connection, ``tcp://HOST:PORT``, e.g. to the serial port of an emulated microcontroller."""

import contextlib
import socket
from typing import Any

from trimtab.flight.transports.accepting_dialer import AcceptingDialer
from trimtab.flight.transports.open_link import Address
from trimtab.flight.transports.reconnecting_stream import ConnectingDialer, StreamLink

GONE_MS = 5000
"""Time (ms) without an acknowledgement of sent data after which a peer counts as disconnected."""


def open_tcp(address: Address, *, listen: bool = False) -> StreamLink:
    """Connect to a peer, even before the peer exists. With `listen`, listen for one peer at a time. Only programs on
    this machine can connect, unless the address has a host.
    """
    address.validate_options()
    family, place = resolve_host(address, socket.SOCK_STREAM)
    if not listen:
        return StreamLink(ConnectingDialer(lambda: _configure_tcp(socket.socket(family, socket.SOCK_STREAM)), place))
    listener = bind_socket(address, socket.socket(family, socket.SOCK_STREAM), place)
    return StreamLink(AcceptingDialer(listener, _configure_tcp))


def resolve_host(address: Address, kind: int) -> tuple[int, Any]:
    """Return the address family and the socket address for connect() and bind(). Raise InputError for an unknown
    host."""
    host, port = address.host_and_port()
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=kind)[0]
    except (OSError, UnicodeError) as error:
        raise address.input_error(f"unknown host {host!r} ({error})") from None
    return family, place


def bind_socket(address: Address, s: socket.socket, place: Any) -> socket.socket:
    """Bind a socket to an address and return it. Raise InputError if that fails."""
    if s.type == socket.SOCK_STREAM:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        s.bind(place)
    except (OSError, OverflowError) as error:
        s.close()
        fix = f"use another port, or find the program that uses it: ss -lnp | grep {place[1]}"
        raise address.input_error(f"cannot listen there ({error})", fix) from None
    return s


def _configure_tcp(s: socket.socket) -> socket.socket:
    """Set a socket to send without delay and to detect a vanished peer. Return the socket."""
    with contextlib.suppress(OSError, AttributeError):
        s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        s.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        s.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GONE_MS)
    return s
