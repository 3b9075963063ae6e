"""A TCP connection: ``tcp://HOST:PORT``, e.g. the serial port of an emulated microcontroller on a socket."""

import contextlib
import socket
from typing import Any

from trimtab.links.open_link import Address
from trimtab.links.stream import AcceptingDialer, ConnectingDialer, StreamLink

GONE_MS = 5000
"""A peer that acknowledges nothing for this long counts as gone."""


def open_tcp(address: Address, *, listen: bool = False) -> StreamLink:
    """Connect to a peer, there already or not; or listen for one at a time, on this machine only without a host."""
    address.validate_options()
    family, place = resolve_host(address, socket.SOCK_STREAM)
    if not listen:
        return StreamLink(ConnectingDialer(lambda: _configure_tcp(socket.socket(family, socket.SOCK_STREAM)), place))
    listener = bind_socket(address, socket.socket(family, socket.SOCK_STREAM), place)
    return StreamLink(AcceptingDialer(listener, _configure_tcp))


def resolve_host(address: Address, kind: int) -> tuple[int, Any]:
    """Address family and the address that connect() and bind() take; refused where the host has none."""
    host, port = address.host_and_port()
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=kind)[0]
    except (OSError, UnicodeError) as error:
        raise address.input_error(f"the host {host!r} is not known ({error})") from None
    return family, place


def bind_socket(address: Address, s: socket.socket, place: Any) -> socket.socket:
    """The socket, bound to a place; refused where that can't be."""
    if s.type == socket.SOCK_STREAM:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        s.bind(place)
    except (OSError, OverflowError) as error:
        s.close()
        fix = f"another port, or who has it: ss -lnp | grep {place[1]}"
        raise address.input_error(f"it can't be listened at ({error})", fix) from None
    return s


def _configure_tcp(s: socket.socket) -> socket.socket:
    """No waiting for more to send, and a peer that vanished is noticed."""
    with contextlib.suppress(OSError, AttributeError):
        s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        s.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        s.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GONE_MS)
    return s
