"""Link over a Bluetooth serial port: ``rfcomm://AA:BB:CC:DD:EE:FF/1``, with the module's address and the channel."""

import re
import socket
from collections.abc import Callable
from typing import Any

from trimtab.flight.transports.accepting_dialer import AcceptingDialer
from trimtab.flight.transports.open_link import Address
from trimtab.flight.transports.reconnecting_stream import ConnectingDialer, Dialer, StreamLink

MOST_CHANNELS = 30
ANY_ADAPTER = "00:00:00:00:00:00"


def open_rfcomm(
    address: Address, *, listen: bool = False, stack: "Callable[[str, int, bool], Dialer] | None" = None
) -> StreamLink:
    """Connect to a Bluetooth module, or listen on an adapter of this machine. The address 00:00:00:00:00:00 means any
    adapter.

    Args:
        address: parsed address.
        listen: True to wait for a peer.
        stack: function that returns a dialer for address, channel and `listen`, or None to use the Bluetooth sockets of
            the system's kernel.
    """
    address.validate_options()
    place = _parse_place(address)
    return StreamLink(_kernel_dialer(address, place, listen) if stack is None else stack(*place, listen))


def _kernel_dialer(address: Address, place: tuple[str, int], listen: bool) -> Dialer:
    make = _bluetooth_socket_factory(address)
    if not listen:
        return ConnectingDialer(make, place)
    listener = make()
    try:
        listener.bind(place)
        return AcceptingDialer(listener)
    except OSError as error:
        listener.close()
        fix = f"rfcomm://{ANY_ADAPTER}/{place[1]}; the command hciconfig lists the adapters"
        raise address.input_error(f"cannot listen there ({error.strerror})", fix) from None


def _parse_place(address: Address) -> tuple[str, int]:
    """Return the address of the Bluetooth module, and the channel."""
    channel = address.path.removeprefix("/")
    if not re.fullmatch(r"([0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}", address.place):
        raise address.input_error(
            f"{address.place!r} is not the address of a module: six hexadecimal bytes, separated by colons"
        )
    if not (channel.isascii() and channel.isdigit() and 1 <= int(channel) <= MOST_CHANNELS):
        raise address.input_error(f"{channel!r} is not a channel from 1 to {MOST_CHANNELS}")
    return address.place.upper(), int(channel)


def _bluetooth_socket_factory(address: Address) -> Callable[[], socket.socket]:
    """Return a function that makes the system's Bluetooth sockets. Raise InputError without Bluetooth."""
    names: Any = socket
    if not hasattr(names, "AF_BLUETOOTH"):
        fix = (
            "use a Python built with Bluetooth headers (e.g. the Python of your distribution), or bind a serial "
            "port: rfcomm bind 0 ADDRESS 1"
        )
        raise address.input_error("this Python was built without Bluetooth", fix)

    def make() -> socket.socket:
        return socket.socket(names.AF_BLUETOOTH, socket.SOCK_STREAM, names.BTPROTO_RFCOMM)

    try:
        make().close()
    except OSError as error:
        fix = "load the module: sudo modprobe rfcomm; or use another transport"
        raise address.input_error(f"this kernel has no Bluetooth ({error.strerror})", fix) from None
    return make
