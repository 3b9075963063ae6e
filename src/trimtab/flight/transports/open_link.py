"""Opening of a real link (serial, UDP, TCP, Bluetooth, loopback) by its address, ``SCHEME://PLACE?NAME=VALUE``."""

import importlib
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link

EXAMPLES: Mapping[str, str] = MappingProxyType(
    {
        "serial": "serial:///dev/ttyUSB0?baud=115200",
        "udp": "udp://192.168.4.1:14550",
        "tcp": "tcp://127.0.0.1:5760",
        "rfcomm": "rfcomm://00:11:22:AA:BB:CC/1",
        "loopback": "loopback://hovercraft",
    }
)
"""Example of an address for each type of link, by the scheme of the address."""

COPY_EXAMPLE = "write an address in the form of one of the choices"
LOOPBACK_HOST = "127.0.0.1"


class Address(NamedTuple):
    """Parsed address of a link. place: part of the address between ``//`` and the path."""

    text: str
    scheme: str
    place: str
    path: str
    options: Mapping[str, str]

    def input_error(self, problem: str, fix: str = "", choices: Iterable[str] = ()) -> InputError:
        """Return an InputError about this address. The default for the fix is an example of an address with the same
        scheme."""
        return InputError(f"link {self.text!r}", problem, choices=choices, fix=fix or EXAMPLES[self.scheme])

    def validate_options(self, *names: str) -> Mapping[str, str]:
        """Return the options in the address, by name. Raise InputError if an option is not in `names`."""
        for name in self.options:
            if name not in names:
                problem = f"{self.scheme} has no option {name!r}"
                fix = "" if names else f"{self.scheme}://{self.place}{self.path}"
                raise self.input_error(problem, fix, choices=names)
        return self.options

    def host_and_port(self) -> tuple[str, int]:
        """Return the host and the port in ``HOST:PORT``, ``[IPV6]:PORT`` or ``:PORT``. The form ``:PORT`` means this
        machine only."""
        host, colon, port = self.place.rpartition(":")
        number = int(port) if port.isascii() and port.isdigit() else 0
        if not colon or not 0 < number < 65536 or self.path not in ("", "/"):
            raise self.input_error(f"{self.place + self.path!r} is not HOST:PORT with a port from 1 to 65535")
        if host.startswith("[") and host.endswith("]"):
            host = host[1:-1]
        elif ":" in host:
            raise self.input_error(
                f"the host {host!r} contains colons, but has no brackets", f"{self.scheme}://[{host}]:{number}"
            )
        return host or LOOPBACK_HOST, number


def parse_uri(uri: str) -> Address:
    """Parse an address. Raise InputError if the scheme is not one of EXAMPLES."""
    scheme, separator, _ = uri.partition("://")
    if not separator or scheme not in EXAMPLES:
        raise InputError(f"link {uri!r}", _describe_scheme(uri), choices=EXAMPLES.values(), fix=COPY_EXAMPLE)
    try:
        parts = urlsplit(uri)
    except ValueError as error:
        raise InputError(f"link {uri!r}", str(error), fix=EXAMPLES[scheme]) from None
    bare = Address(uri, scheme, parts.netloc, parts.path, MappingProxyType({}))
    if parts.fragment or "@" in parts.netloc:
        raise bare.input_error("an address must not contain '#' or '@'")
    pairs = parse_qsl(parts.query, keep_blank_values=True)
    options = dict(pairs)
    if len(options) < len(pairs):
        raise bare.input_error("an option is given twice")
    return bare._replace(options=MappingProxyType(options))


def _describe_scheme(uri: str) -> str:
    """Return a description of the error in an address that does not begin with a valid scheme and "://"."""
    scheme, separator, _ = uri.partition("://")
    if separator:
        return f"unknown scheme {scheme!r}"
    scheme = uri.partition(":")[0]
    return f"'//' is missing after '{scheme}:'" if scheme in EXAMPLES else "the address has no scheme"


def open_link(uri: str, *, listen: bool = False) -> Link:
    """Open a link. Raise InputError if the link cannot be opened. The methods of an open link raise no exceptions.

    Args:
        uri: ``serial:///dev/ttyUSB0?baud=115200``, ``udp://HOST:PORT``, ``tcp://HOST:PORT``,
            ``rfcomm://AA:BB:CC:DD:EE:FF/1`` or ``loopback://NAME``.
        listen: True to listen for peers. On udp and tcp, only this machine can connect (``udp://:14550``), unless the
            address has a host (``udp://0.0.0.0:14550``).

    Returns:
        A link that reconnects automatically when its device or peer is available again.
    """
    address = parse_uri(uri)
    module = importlib.import_module(f"trimtab.flight.transports.{address.scheme}")
    return getattr(module, f"open_{address.scheme}")(address, listen=listen)
