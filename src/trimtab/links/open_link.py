"""Open a real transport by its address."""

import importlib

from trimtab.core.interfaces import Link
from trimtab.links.uri import parse


def open_link(uri: str, *, listen: bool = False) -> Link:
    """Open a link; what can't be opened is refused here, and nothing raises afterwards.

    Args:
        uri: ``serial:///dev/ttyUSB0?baud=115200``, ``udp://HOST:PORT``, ``tcp://HOST:PORT``,
            ``rfcomm://AA:BB:CC:DD:EE:FF/1`` or ``loopback://NAME``.
        listen: be the end that is called; on udp and tcp for this machine only (``udp://:14550``) unless a host is
            written (``udp://0.0.0.0:14550``).

    Returns:
        A link that comes back by itself when its device, or its peer, does.
    """
    address = parse(uri)
    module = importlib.import_module(f"trimtab.links.{address.scheme}")
    return getattr(module, f"open_{address.scheme}")(address, listen=listen)
