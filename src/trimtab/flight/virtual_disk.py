"""Logs of vehicle and autopilot in virtual time, kept in memory.

The rows and events of these logs equal those of a log file (tests/flight/test_virtual_disk.py), and are part of the
trace of the simulation.
Source: docs page, Testing.
"""

import errno
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.clock import NS_PER_SECOND, Clock
from trimtab.core.time import to_seconds
from trimtab.flight.flight_log import ROWS, FlightRows
from trimtab.flight.virtual_time import VirtualTime
from trimtab.logs.frames import no_pose
from trimtab.logs.log import Log
from trimtab.logs.log_limit import LogLimit
from trimtab.logs.messages import EPOCH
from trimtab.logs.stream import COUNTER_SIGNALS, END_S, LogFileSummary

LOOK_S = 0.001
"""Time (s) between two checks whether a hanging disk accepts rows again."""
FREE_BYTES = 10_000_000_000
NUMBER_BYTES = 8
NO_SPACE = os.strerror(errno.ENOSPC)


class VirtualDisk:
    """Disk of one machine in virtual time. It opens logs in memory, with the interface of `flight_log.SystemDisk`."""

    def __init__(self, time: VirtualTime, owner: str, tell: Callable[[str], None] = lambda _: None) -> None:
        """owner: name of the machine, for the trace.  tell: function that receives the messages for the user."""
        self._time, self.owner, self.tell = time, owner, tell
        self.is_full = False
        self.is_writer_dead = False
        """True once the process that writes the logs has died. The flying program continues."""
        self.is_dead = False
        """True once the program whose logs are on this disk has been killed. No more rows are then written."""
        self.hangs = False
        """True while the disk hangs, like a stalled memory card. Rows then wait in the ring buffer of each log."""
        self.logs: list[MemoryLog] = []

    def free_bytes(self, folder: Path) -> int:
        """Return the free space on this disk (bytes)."""
        return 0 if self.is_full else FREE_BYTES

    def open_log(
        self, path: Path, rows: FlightRows, metadata: Mapping[str, Any], frame: str, limit: LogLimit | None
    ) -> "MemoryLog":
        """Open a log. The arguments are those of `flight_log.FlightLog`. The size limit has no effect in memory."""
        log = MemoryLog(self, self._time, rows, metadata)
        self.logs.append(log)
        return log


class MemoryLog:
    """Log in memory, with the interface `flight_log.FlightRecorder`."""

    def __init__(self, disk: VirtualDisk, time: VirtualTime, rows: FlightRows, metadata: Mapping[str, Any]) -> None:
        self._disk, self._time, self._rows, self._metadata = disk, time, rows, dict(metadata)
        self.pose: Any = no_pose()
        self._numbers: list[Any] = []
        self._ticks: list[int] = []
        self._unwritten_before: list[int] = []
        self._events: list[tuple[int, str]] = []
        self._unwritten = self._gap = 0
        self._final: Mapping[str, Any] = {}
        self._epoch = 0
        self.is_closed = False
        self.unread_rows = 0
        self._dropped = 0
        self._written = 0, 0
        """Number of rows and number of events that have been written to the disk."""

    def start_clock(self, start: int, clock: Clock) -> None:
        """Set the log's time zero to `start`, a time of the monotonic clock (ns)."""
        self._epoch = round(clock.unix() * NS_PER_SECOND) - clock.monotonic_ns() + start

    def write_row(self, t: int, own: Sequence[float] = ()) -> None:
        """Write the row of time t. If the disk is full, or t is not later than the previous row, only count the row."""
        if self._disk.is_dead:
            return
        row = np.empty(self._rows.width)
        self._rows.fill(row, own)
        self._time.note("row", self._disk.owner, t, row.tobytes())
        if self._disk.is_writer_dead:
            return
        if self._disk.hangs and len(self._ticks) - self._written[0] >= ROWS:
            self._dropped += 1
            return
        if self._disk.is_full or (self._ticks and t <= self._ticks[-1]):
            self._unwritten += 1
            self._note_gap()
            return
        if self._gap:
            self._events.append((t, f"the log has a gap of {self._gap} rows: {NO_SPACE}"))
            self._gap = 0
        self._ticks.append(t)
        self._numbers.append(row)
        self._unwritten_before.append(self._unwritten)
        self._note_written()

    def _note_written(self) -> None:
        if not self._disk.hangs:
            self._written = len(self._ticks), len(self._events)

    def await_room(self) -> None:
        """Return immediately, because memory always has room for a row."""

    def _note_gap(self) -> None:
        if self._disk.is_full:
            if not self._gap:
                self._disk.tell(f"log: can't be written ({NO_SPACE}); the flight goes on, rows are counted")
            self._gap += 1

    def write_event(self, text: str) -> None:
        """Write a line of text into the log, between two rows."""
        if not self._disk.is_dead and not self._disk.is_writer_dead:
            self._time.note("event", self._disk.owner, text)
            self._events.append((max(self._ticks[-1] if self._ticks else 0, 0), text))
            self._note_written()

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log."""
        if self._disk.is_dead or self._disk.is_writer_dead or not self._await_disk():
            return None
        self.is_closed, self._final = True, dict(final or {})
        size = NUMBER_BYTES * self._rows.width * len(self._ticks)
        last = self._ticks[-1] if self._ticks else 0
        minute_size = 60 * size / to_seconds(last) if last > 0 else None
        return LogFileSummary(
            len(self._ticks), self._dropped, self._unwritten, size, minute_size, 0.0, not self._disk.is_full
        )

    def _await_disk(self) -> bool:
        """Wait at most `END_S` seconds for a hanging disk. If the disk still hangs, drop the unwritten rows and return
        False."""
        clock = self._time.running.clock if self._disk.hangs else None
        given_up = self._time.now + END_S * NS_PER_SECOND
        while clock is not None and self._disk.hangs and self._time.now < given_up:
            clock.wait(None, LOOK_S)
        if not self._disk.hangs:
            return True
        rows, events = self._written
        self.unread_rows = len(self._ticks) - rows
        del self._ticks[rows:], self._numbers[rows:], self._unwritten_before[rows:], self._events[events:]
        return False

    def read(self) -> Log:
        """Return the log, as if it had been read from a log file."""
        events = list(self._events)
        if not self.is_closed:
            last = max(self._ticks[-1] if self._ticks else 0, 0)
            events.append((last, "the flying process is gone, without a word"))
        table = np.array(self._numbers).reshape(len(self._ticks), self._rows.width)
        arrays, declared, at = {}, {}, 0
        for path, shape, dtype, quantity in self._rows.signals:
            size = math.prod(shape)
            with np.errstate(invalid="ignore"):
                arrays[path] = table[:, at : at + size].astype(dtype).reshape(len(table), *shape)
            at += size
            if quantity is not None:
                declared[path] = quantity
        nothing, unwritten = np.zeros(len(table), np.int64), np.array(self._unwritten_before, np.int64)
        arrays |= dict(zip(COUNTER_SIGNALS, (nothing, unwritten), strict=True))
        said = [{"t": to_seconds(t), "text": text} for t, text in events]
        ticks = np.array(self._ticks, np.int64)
        return Log(
            t=to_seconds(ticks),
            ticks=ticks,
            signals=arrays,
            declarations=declared | COUNTER_SIGNALS,
            metadata=self._metadata | {EPOCH: self._epoch} | ({"events": said} if said else {}),
            final=self._final,
        )
