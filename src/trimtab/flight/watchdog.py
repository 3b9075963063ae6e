"""Watchdog of the outputs: which row is applied, and the small file in which a driver reads it.

It needs only the standard library, since it runs in the process of the outputs.
Source: docs page, Vehicle (Watchdog).
"""

import mmap
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

PORT_HEAD = struct.Struct("<QqB?")
"""Head of the port: number of the write (odd during a write), time of the write (ns), state, lift."""
STATES = ("waiting", "driven", "safe", "latched")
WAITING, DRIVEN, SAFE, LATCHED = range(4)


class OutputRow(NamedTuple):
    """Row of outputs that is applied. values: of the command, in the order of its record."""

    state: int
    lift: bool
    values: tuple[float, ...]


class Watchdog:
    """Choice of the row that is applied, by the received rows and the time. Times are in ns of one clock."""

    def __init__(self, safe: Sequence[float], timeout: int, lift_delay: int, latch: int) -> None:
        """timeout: silence after which the safe row acts.  latch: silence after which it stays until disarmed.

        lift_delay: time for which the lift fan keeps turning after the safe row starts.
        """
        self._safe, self._timeout, self._lift_delay, self._latch = tuple(safe), timeout, lift_delay, latch
        self.row = OutputRow(WAITING, False, self._safe)
        self._stamp = self._lift_until = 0

    def take_row(self, stamp: int, is_commanded: bool, lift: bool, values: tuple[float, ...]) -> None:
        """Take a row handed over at a time. A latched safe row stays until the vehicle is no longer commanded."""
        state, lift_now = self.row.state, self.row.lift and self.row.state != DRIVEN
        latched = state == LATCHED or (state != WAITING and stamp - self._stamp >= self._latch)
        self._stamp = stamp
        if latched and is_commanded:
            self.row = OutputRow(LATCHED, lift_now, self._safe)
            return
        self.row = OutputRow(DRIVEN, lift, values)

    def check(self, now: int, is_gone: bool = False) -> bool:
        """Advance time to now. Return whether the safe row starts to act. is_gone: no more rows can come."""
        row = self.row
        if row.state == DRIVEN and (is_gone or now - self._stamp >= self._timeout):
            self._lift_until = now + (self._lift_delay if row.lift else 0)
            self.row = OutputRow(SAFE, row.lift and now < self._lift_until, self._safe)
            return True
        if row.lift and row.state != DRIVEN and now >= self._lift_until:
            self.row = row._replace(lift=False)
        if row.state == SAFE and (is_gone or now - self._stamp >= self._latch):
            self.row = self.row._replace(state=LATCHED)
        return False

    def next_check(self) -> int | None:
        """Return the time of the next change by time alone; None if there is none."""
        if self.row.state == DRIVEN:
            return self._stamp + self._timeout
        times = [self._lift_until] if self.row.lift else []
        times += [self._stamp + self._latch] if self.row.state == SAFE else []
        return min(times, default=None)

    def silence(self, now: int) -> int:
        """Return the time since the last row."""
        return now - self._stamp


def _open_own(path: str, flags: int) -> int:
    """Open a file that no other user can write, whatever the umask: a writer of this file moves the vehicle."""
    return os.open(path, flags, 0o644)


class OutputPort:
    """Small file in shared memory with the row that is applied now, for a driver or a test bench."""

    def __init__(self, path: Path, values: int, *, create: bool = False) -> None:
        """values: number of values in a row."""
        self._numbers = struct.Struct(f"<{values}d")
        size = PORT_HEAD.size + self._numbers.size
        with open(path, "x+b" if create else "r+b", opener=_open_own) as file:
            if create:
                os.posix_fallocate(file.fileno(), 0, size)  # a full disk fails here, not with a signal at the first row
            self._memory = mmap.mmap(file.fileno(), size)
        self._count = 0

    def write(self, row: OutputRow, now: int) -> None:
        """Apply a row from now (ns) on."""
        self._count += 2
        PORT_HEAD.pack_into(self._memory, 0, self._count - 1, now, row.state, row.lift)
        self._numbers.pack_into(self._memory, PORT_HEAD.size, *row.values)
        struct.pack_into("<Q", self._memory, 0, self._count)

    def read(self) -> tuple[int, OutputRow]:
        """Return the time when the current row was written (ns), and the row."""
        while True:
            count, stamp, state, lift = PORT_HEAD.unpack_from(self._memory, 0)
            values = self._numbers.unpack_from(self._memory, PORT_HEAD.size)
            if count % 2 == 0 and struct.unpack_from("<Q", self._memory, 0)[0] == count:
                return stamp, OutputRow(state, lift, values)
