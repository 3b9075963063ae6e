"""Link over a serial line, ``serial:///dev/ttyUSB0?baud=115200``, with eight data bits, no parity, one stop bit, no
flow control."""

import errno
import os
from pathlib import Path
from typing import Any

from trimtab.flight.transports.open_link import Address
from trimtab.flight.transports.reconnecting_stream import StreamLink

DEFAULT_BAUD = 115200
DEVICES = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyS*", "rfcomm*")


def open_serial(address: Address, *, listen: bool = False) -> StreamLink:
    """Open a serial line. The two ends of a serial line are alike, so `listen` has no effect. Raise InputError if the
    device is missing.

    If the device is unplugged, it is opened again as soon as its path exists again.
    """
    del listen
    if address.place or not address.path:
        raise address.input_error("the address must contain the path of a device, which starts with a third '/'")
    speed = _parse_speed(address)
    line = _SerialDialer(address.path, speed)
    try:
        os.close(line.dial())
    except OSError as error:
        raise _opening_error(address, error) from None
    return StreamLink(line)


class _SerialDialer:
    """Dialer that opens the device of a serial line."""

    def __init__(self, path: str, speed: int) -> None:
        self._path, self._speed = path, speed

    def dial(self) -> int:
        """Return the file descriptor of the device, in raw mode, with empty buffers, and locked for this program. Raise
        OSError if the device is in use."""
        import fcntl  # not available on every system
        import termios

        fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            fcntl.ioctl(fd, termios.TIOCEXCL)  # this also excludes programs that ignore the lock
            termios.tcsetattr(fd, termios.TCSANOW, _raw_settings(termios, termios.tcgetattr(fd), self._speed))
            termios.tcflush(fd, termios.TCIFLUSH)
        except termios.error as error:
            os.close(fd)
            raise OSError(*error.args) from None
        except OSError:
            os.close(fd)
            raise
        return fd

    def wait_event(self) -> tuple[int, int]:
        """Return no event, since the system signals no event when a device is plugged in again."""
        return -1, 0

    def exchange(self, fd: int) -> int:
        """Return -1, because a device has only one peer."""
        return -1

    def close(self) -> None:
        """Do nothing: the dialer has no resources."""


def _raw_settings(termios: Any, flags: list[Any], speed: int) -> list[Any]:
    """Return terminal settings with which every byte is transferred unchanged."""
    flags[:4] = 0, 0, termios.CS8 | termios.CREAD | termios.CLOCAL, 0
    flags[4] = flags[5] = speed
    flags[6][termios.VMIN], flags[6][termios.VTIME] = 1, 0
    return flags


def _parse_speed(address: Address) -> int:
    """Return the system's code for the baud rate in the address."""
    text = address.validate_options("baud").get("baud", str(DEFAULT_BAUD))
    try:
        import termios
    except ImportError:
        raise address.input_error("this system has no termios", "write udp://HOST:PORT") from None
    speeds = {n[1:]: int(value) for n, value in vars(termios).items() if n[0] == "B" and n[1:].isdigit() and value}
    if text not in speeds:
        problem = f"{text!r} is not a baud rate of this system"
        raise address.input_error(problem, choices=sorted(speeds, key=int))
    return speeds[text]


def _opening_error(address: Address, error: OSError) -> Exception:
    """Return an InputError, with a fix, for a device that cannot be opened."""
    devices = sorted(str(p) for pattern in DEVICES for p in Path("/dev").glob(pattern))
    fix = (
        f"serial://{devices[0]}?baud={DEFAULT_BAUD}"
        if devices
        else "plug the device in; the command  ls /dev/tty*  lists the devices"
    )
    if error.errno in (errno.EWOULDBLOCK, errno.EBUSY):
        fix = f"end the other program; the command  fuser {address.path}  shows its process id"
        return address.input_error("another program uses the device", fix)
    if isinstance(error, PermissionError):
        fix = "sudo usermod -a -G dialout $USER, and log in again"
    return address.input_error(f"the device can't be opened ({error.strerror})", fix, choices=devices[:12])
