"""Loopback link ``loopback://NAME``, which carries packets between programs of one user on one machine, or within a
program."""

import contextlib
import os
import re
import socket
import stat
import tempfile
from pathlib import Path

from trimtab.core.errors import InputError
from trimtab.flight.transports.accepting_dialer import AcceptingDialer
from trimtab.flight.transports.open_link import Address
from trimtab.flight.transports.reconnecting_stream import ConnectingDialer, StreamLink


def open_loopback(address: Address, *, listen: bool = False) -> StreamLink:
    """Connect to the listener with the name in `address`, even before the listener exists. With `listen`, listen under
    this name, for one peer at a time.

    The link uses Unix sockets that preserve the boundaries of packets, in a folder that only its owner may enter.
    """
    address.validate_options()
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,40}", address.place) or address.path:
        raise address.input_error(
            f"{address.place + address.path!r} is not a name of 1 to 40 letters, digits, '_', '-', '.'"
        )
    place = socket_folder() / f"{address.place}.link"
    if not listen:
        _make_socket(address).close()
        return StreamLink(ConnectingDialer(lambda: _make_socket(address), str(place)))
    lock = _acquire_lock(address, place)
    listener = _make_socket(address)
    try:
        place.unlink(missing_ok=True)
        listener.bind(str(place))
    except OSError as error:
        listener.close()
        os.close(lock)
        raise address.input_error(
            f"cannot listen there ({error})", "use another name, or set TMPDIR to a shorter path"
        ) from None

    def release() -> None:
        place.unlink(missing_ok=True)
        os.close(lock)

    return StreamLink(AcceptingDialer(listener, closed=release))


def socket_folder() -> Path:
    """Return the folder of the sockets, in the folder $XDG_RUNTIME_DIR or in the temporary folder.

    Raise InputError if other users may enter the folder.
    """
    user = os.getuid()
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "trimtab" if runtime else Path(tempfile.gettempdir()) / f"trimtab-{user}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700, parents=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != user or status.st_mode & 0o077:
        problem = "other users have access to the folder"
        raise InputError(
            f"folder of loopback links '{folder}'", problem, fix=f"chmod 700 {folder}, or remove the folder"
        )
    return folder


def _acquire_lock(address: Address, place: Path) -> int:
    """Return a lock that is held by the listener. The system releases the lock when the process ends."""
    import fcntl  # not available on every system

    lock = os.open(place.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise address.input_error("another process listens under this name", f"{address.text}-2") from None
    return lock


def _make_socket(address: Address) -> socket.socket:
    try:
        return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except (OSError, AttributeError):
        raise address.input_error(
            "this system has no Unix sockets that preserve the boundaries of packets", "udp://127.0.0.1:14550"
        ) from None
