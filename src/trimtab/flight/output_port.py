"""Port of a vehicle's outputs: shared memory with the output values to apply now, for the driver of servos and motors.

    struct, little-endian     count of writes (u64, odd during a write), time of the write, time of the last sign of
                              life, delay of the lift fan (ns each, i64), number of values n (u16), state (u8),
                              lift (u8)
    n float64, n float64      the applied values, the safe values

Every 20 ms, even if no value changes, the process of the outputs writes the current time into the port as a sign of
life. A driver must read the port at least every 20 ms, and compare the time of the last sign of life with the monotonic
clock. If the last sign of life is older than 100 ms, the process is dead or frozen. The driver then applies the safe
values, and stops the lift fan after its delay. `OutputReader` implements this rule. The port is in shared memory and
not on the disk of the log, because a disk may hang.

This module imports only the standard library, because it runs in the process of the outputs and in drivers.
Source: docs page, Vehicle (Watchdog).
"""

import contextlib
import mmap
import os
import stat
import struct
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

PORT_HEAD = struct.Struct("<QqqqHB?")
LIFE_OFFSET = 16
"""Byte offset in the port at which the time of the last sign of life is stored."""
MOST_READS = 100
"""Maximum number of attempts to read the port while the values are being written."""
LIFE_PERIOD, LIFE_TIMEOUT = 20_000_000, 100_000_000
"""Time (ns) between two signs of life, and age (ns) of the last sign of life above which a driver treats the writing
process as dead."""
STATES = ("waiting", "driven", "safe", "latched", "stale")
WAITING, DRIVEN, SAFE, LATCHED, STALE = range(5)
SHARED_MEMORY = Path("/dev/shm")


class OutputRow(NamedTuple):
    """Output row of a vehicle: the values that a driver applies to all outputs at a time.

    state: index in STATES.  lift: True if the lift fan turns.  values: elements of the command, in the order in which
    the command's record declares them.
    """

    state: int
    lift: bool
    values: tuple[float, ...]


def memory_folder() -> Path:
    """Return this user's folder in shared memory, or in the temporary folder if the system has no shared memory.

    Raise PermissionError if other users have access to the folder.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = (SHARED_MEMORY if SHARED_MEMORY.is_dir() else Path(tempfile.gettempdir())) / f"trimtab-{user}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != user or status.st_mode & 0o077:
        raise PermissionError(f"other users have access to the folder {folder}")
    return folder


def port_path(process: int) -> Path:
    """Return the path of the port of a process of outputs. process: process id."""
    return memory_folder() / f"outputs-{process}.bin"


class OutputPort:
    """Writer of the port, used in the process of the outputs."""

    def __init__(self, path: Path, safe: Sequence[float], lift_delay: int) -> None:
        """Make the port, with the safe values as the first output row.

        Args:
            path: file to make in shared memory. An existing file is replaced.
            safe: output values that make the vehicle safe.
            lift_delay: time (ns) for which the lift fan keeps turning after the safe row takes effect.
        """
        self.path, self._lift_delay, self._count = path, lift_delay, 0
        self._numbers = struct.Struct(f"<{len(safe)}d")
        size = PORT_HEAD.size + 2 * self._numbers.size
        path.unlink(missing_ok=True)
        with open(path, "x+b", opener=_open_own) as file:
            os.posix_fallocate(file.fileno(), 0, size)  # fails if memory is full; a write would raise a signal
            self._memory = mmap.mmap(file.fileno(), size)
        self._numbers.pack_into(self._memory, PORT_HEAD.size + self._numbers.size, *safe)
        self.write(OutputRow(WAITING, False, tuple(safe)), 0)

    def write(self, row: OutputRow, now: int) -> None:
        """Write the output row that a driver must apply from time now (ns) on."""
        self._count += 2
        numbers = self._count - 1, now, now, self._lift_delay, len(row.values), row.state, row.lift
        PORT_HEAD.pack_into(self._memory, 0, *numbers)
        self._numbers.pack_into(self._memory, PORT_HEAD.size, *row.values)
        struct.pack_into("<Q", self._memory, 0, self._count)

    def renew(self, now: int) -> None:
        """Write the time now (ns) as a sign of life, which shows that this process works."""
        struct.pack_into("<q", self._memory, LIFE_OFFSET, now)

    def close(self) -> None:
        """Remove the file of the port. A driver that still has the port open sees no more signs of life."""
        self.path.unlink(missing_ok=True)


class OutputReader:
    """Reader of the port, used by a driver of servos and motors."""

    def __init__(self, path: Path) -> None:
        """path: the file `outputs.bin` of a vehicle."""
        with path.open("rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._numbers = struct.Struct(f"<{PORT_HEAD.unpack_from(self._memory, 0)[4]}d")
        self._stale_since: int | None = None
        self._newest = 0, OutputRow(WAITING, False, self.safe_values)

    @property
    def safe_values(self) -> tuple[float, ...]:
        """Output values that make the vehicle safe."""
        return self._numbers.unpack_from(self._memory, PORT_HEAD.size + self._numbers.size)

    def read(self) -> tuple[int, OutputRow]:
        """Return the newest complete output row, unchanged even if it is old, and the time (ns) at which it was
        written.

        If the writer stops in the middle of a row, the reader returns the previous row.
        """
        for _ in range(MOST_READS):
            count, written, _, _, _, state, lift = PORT_HEAD.unpack_from(self._memory, 0)
            values = self._numbers.unpack_from(self._memory, PORT_HEAD.size)
            if count % 2 == 0 and struct.unpack_from("<Q", self._memory, 0)[0] == count:
                self._newest = written, OutputRow(state, lift, values)
                break
        return self._newest

    def row_to_apply(self, now: int) -> OutputRow:
        """Return the output row that a driver must apply at time now (ns, monotonic clock). This is the safe row if
        signs of life are missing.

        If the lift fan was turning, it keeps turning for its delay after the last sign of life.
        """
        row = self.read()[1]
        _, _, life, lift_delay, *_ = PORT_HEAD.unpack_from(self._memory, 0)
        if now - life < LIFE_TIMEOUT:
            self._stale_since = None
            return row
        if self._stale_since is None:
            self._stale_since = now
        return OutputRow(STALE, row.lift and now - self._stale_since < lift_delay, self.safe_values)


def _open_own(path: str, flags: int) -> int:
    """Open a file that only its owner can read and write, whatever the umask, because its content moves the vehicle."""
    return os.open(path, flags, 0o644)
