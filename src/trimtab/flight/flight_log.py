"""Log of a flight: rows are filled from the vectors of compiled steps, and passed to a separate writer process.

Source: docs page, Fly.
"""

import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from trimtab.compiler.structs import Member
from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.record import Quantity
from trimtab.core.time import to_seconds
from trimtab.flight.mavlink.endpoint import FrameCounts
from trimtab.logs.frames import no_pose
from trimtab.logs.log_limit import LogLimit
from trimtab.logs.ring import Ring
from trimtab.logs.stream import END_S, LogFileSummary, LogStream, Signal, start_writer
from trimtab.loop.scenario import Scenario
from trimtab.run.program import describe_scenario

FRAMES = {"vehicle": "vehicle", "autopilot": "estimate"}
"""Name of the coordinate frame that moves with the vehicle, in the log of each side of the link."""
ROWS = 16384
"""Number of rows in the ring buffer, which bridges the time for which a disk delays the writer."""
WRITER_DIED = f"the log's writer died, or wrote nothing for {END_S:g} s; the rows written before are kept"


class LogSource(NamedTuple):
    """Vector whose numbers go into each row of a log.

    name: function from a member's path to its path in the log; the result None means that the member is not logged.
    """

    vector: Any
    members: Sequence[Member]
    name: Callable[[str], str | None]


def frame_signals(prefix: str) -> dict[str, tuple[str, Quantity]]:
    """Return the log signals that count a link's frames; paths start with `prefix`. `count_frames` gives the values."""
    return {
        f"{prefix}.refused": ("i8", Quantity("1", "Frames refused so far.", kind="count")),
        f"{prefix}.lost": ("i8", Quantity("1", "Frames lost so far, by gaps in the numbering.", kind="count")),
        f"{prefix}.damaged": ("i8", Quantity("1", "Frames with a wrong checksum so far.", kind="count")),
        f"{prefix}.garbage": ("i8", Quantity("1", "Bytes outside frames so far.", kind="count")),
    }


def count_frames(counts: FrameCounts) -> tuple[int, int, int, int]:
    """Return the current values of the signals of `frame_signals`."""
    return counts.refusals, counts.lost, counts.checksum, counts.garbage


class FlightRows:
    """Layout of a log row of a flight: numbers from vectors of compiled steps, then numbers that the caller passes with
    the row.
    """

    def __init__(self, sources: Sequence[LogSource], own: Mapping[str, tuple[str, Quantity]]) -> None:
        """Define the layout of a row.

        Args:
            sources: vectors whose numbers go into each row.
            own: type and declaration of each number that the caller passes with a row, by path.
        """
        self.signals: list[Signal] = []
        self._picks: list[tuple[Any, Any, slice]] = []
        stop = 0
        for source in sources:
            slots, start = _select_numbers(source, self.signals), stop
            stop += len(slots)
            self._picks.append((source.vector, np.array(slots, np.intp), slice(start, stop)))
        self.signals += [(path, (), np.dtype(dtype), declared) for path, (dtype, declared) in own.items()]
        self._own, self.width = slice(stop, stop + len(own)), stop + len(own)

    def fill(self, row: Any, own: Sequence[float]) -> None:
        """Write the current numbers into a row, float64 (width,)."""
        for vector, index, where in self._picks:
            row[where] = vector[index]
        row[self._own] = own


class FlightRecorder(Protocol):
    """Interface of the log of one end of a live flight. Only the method `await_room` waits."""

    pose: Any
    """Pose of the vehicle, as in `logs.frames`. Each row of the log contains the pose that was set last."""
    unread_rows: int
    """Number of rows that the writer's process had not read when it died."""

    def start_clock(self, start: int, clock: Clock) -> None:
        """Set the log's time zero to `start`, a time of the monotonic clock (ns). Call this before the first row."""
        ...

    def write_row(self, t: int, own: Sequence[float] = ()) -> None:
        """Write the row of time t: the current numbers of the vectors, then the numbers in `own`."""
        ...

    def await_room(self) -> None:
        """Wait until the log has room for a row. Call this in lockstep, where a flight may be faster than the disk."""
        ...

    def write_event(self, text: str) -> None:
        """Write a line of text into the log, between two rows."""
        ...

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log. Return None if the writer's process has died or has stopped writing."""
        ...


class FlightLog:
    """Log that puts each row into a ring buffer within a few microseconds. Only the method `await_room` waits."""

    def __init__(
        self,
        path: Path,
        rows: FlightRows,
        metadata: Mapping[str, Any],
        frame: str = "",
        limit: LogLimit | None = None,
    ) -> None:
        """Start the writer's process.

        Args:
            path: path of a new file.
            rows: layout of a row.
            metadata: metadata of the log.
            frame: name of the coordinate frame whose pose each row contains; empty: no pose, as in virtual time.
            limit: maximum size of the log on the disk; None: no limit.
        """
        self._rows, stop = rows, 1 + rows.width
        self.pose: Any = no_pose() if frame else np.zeros(0)
        """Pose as in `logs.frames`. Change its elements in place. Each row contains the pose at that time."""
        self._row = np.zeros(stop + len(self.pose))
        self._numbers, self._poses = self._row[1:stop], self._row[stop:]
        self._ring = Ring.create(columns=len(self._row), rows=ROWS)
        self.unread_rows = 0
        try:
            options = {"metadata": metadata, "frame": frame, "limit": limit}
            self._stream: LogStream = start_writer(path, self._ring, signals=rows.signals, **options)
        except BaseException:
            self._release_ring()
            raise

    def write_row(self, t: int, own: Sequence[float] = ()) -> None:
        """Write the row of time t: the current numbers of the vectors, then the numbers in `own`."""
        self._row[0] = t
        self._rows.fill(self._numbers, own)
        self._poses[:] = self.pose
        self._ring.write_row(self._row)

    def await_room(self) -> None:
        """Wait until the log has room for a row, or its writer has died. Virtual time may be faster than the disk."""
        while self._ring.waiting_rows >= self._ring.rows and self._stream.is_alive:
            SYSTEM_CLOCK.wait(None, 1e-3)

    def start_clock(self, start: int, clock: Clock = SYSTEM_CLOCK) -> None:
        """Set the log's time zero to `start`, a time of the monotonic clock (ns). Call this before the first row."""
        self._stream.set_epoch(round(clock.unix() * NS_PER_SECOND) - clock.monotonic_ns() + start)

    def write_event(self, text: str) -> None:
        """Write a line of text into the log, between two rows."""
        self._ring.write_text(text)

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log. Return None and set `unread_rows` if the writer has died or has stopped writing."""
        try:
            return self._stream.close(final)
        finally:
            self.unread_rows = self._ring.waiting_rows
            self._release_ring()

    def _release_ring(self) -> None:
        self._ring.unlink()
        self._ring.close()


def close_flight_log(
    log: FlightRecorder | None, lost_lines: int, final: Mapping[str, Any] | None = None
) -> LogFileSummary | None:
    """End a log. If lines for the user were lost, first write their number into the log.

    Args:
        log: the log; None: no log.
        lost_lines: number of lines for the user that were lost.
        final: final values that are stored in the log.
    """
    if log is None:
        return None
    if lost_lines:
        log.write_event(f"{lost_lines} lines for the user were lost: the terminal or the reader did not accept them")
    return log.close(final)


def list_log_problems(log: FlightRecorder | None, summary: LogFileSummary | None) -> list[str]:
    """Return the problems of a closed log. log: None for no log.  summary: None if the log's writer has died."""
    if log is None:
        return []
    if summary is None:
        return [f"{WRITER_DIED}, at least {log.unread_rows} rows are lost" if log.unread_rows else WRITER_DIED]
    count = summary.dropped + summary.unwritten
    problems = {
        f"the log lacks {count} rows": count > 0,
        "the log was deleted or moved before its end": summary.gone,
    }
    return [text for text, holds in problems.items() if holds]


class Disk(Protocol):
    """Disk for the logs of live ends: the disk of this machine, or a disk in virtual time."""

    def free_bytes(self, folder: Path) -> int:
        """Return the free space (bytes) on the disk of a folder."""
        ...

    def open_log(
        self, path: Path, rows: FlightRows, metadata: Mapping[str, Any], frame: str, limit: LogLimit | None
    ) -> FlightRecorder:
        """Open a log. The arguments are those of `FlightLog`."""
        ...


LOOK_S = 1.0
"""Time (s) between two measurements of the free space."""


class SystemDisk:
    """The disk of this machine. A separate process writes each log."""

    def __init__(self) -> None:
        self._free: dict[Path, int] = {}

    def free_bytes(self, folder: Path) -> int:
        """Return the free space (bytes) on the disk of a folder, as a thread last measured it; 0 if the folder is
        missing.

        The first call for a folder measures directly. A disk that hangs does not hold up later calls.
        """
        if folder not in self._free:
            self._free[folder] = _look_at_space(folder)
            threading.Thread(target=self._watch, args=(folder,), name="free space", daemon=True).start()
        return self._free[folder]

    def _watch(self, folder: Path) -> None:
        while True:
            SYSTEM_CLOCK.wait(None, LOOK_S)
            self._free[folder] = _look_at_space(folder)

    def open_log(
        self, path: Path, rows: FlightRows, metadata: Mapping[str, Any], frame: str, limit: LogLimit | None
    ) -> FlightLog:
        """Open a log. The arguments are those of `FlightLog`."""
        self.free_bytes(path.parent)
        return FlightLog(path, rows, metadata, frame, limit)


def _look_at_space(folder: Path) -> int:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


SYSTEM_DISK = SystemDisk()


def open_flight_log(
    path: Path | None,
    sources: Sequence[LogSource],
    own: Mapping[str, tuple[str, Quantity]],
    scenario: Scenario,
    *,
    side: str,
    seed: int,
    log_period: int,
    is_live: bool = False,
    limit: int | None = None,
    disk: Disk = SYSTEM_DISK,
) -> FlightRecorder | None:
    """Open the log of the vehicle or the autopilot. Return None without a path.

    Args:
        path: file of the log.
        sources: vectors whose numbers go into each row.
        own: type and declaration of each number that the caller passes with a row, by path.
        scenario: the scenario that is flown.
        side: "autopilot" or "vehicle".
        seed: seed of the random numbers.
        log_period: time between rows (100 ns).
        is_live: True if the flight runs by a clock, so that `start_clock` will be called.
        limit: maximum size of the log (bytes). At the limit, a vehicle's log drops its oldest files, and an
            autopilot's log stops.
        disk: disk on which the log is written.
    """
    if path is None:
        return None
    bound = None if limit is None else LogLimit(limit, rolls=side == "vehicle")
    about = {"side": side, "seed": seed, "run": 0, "backend": "c", "log_period_s": to_seconds(log_period)}
    metadata, frame = describe_scenario(scenario) | about, FRAMES[side] if is_live else ""
    return disk.open_log(path, FlightRows(sources, own), metadata, frame, bound)


def _select_numbers(source: LogSource, signals: list[Signal]) -> list[int]:
    """Return the indices of those numbers of a vector that are logged. Append their signals to `signals`."""
    slots, at = [], 0
    for m in source.members:
        path = source.name(m.name)
        if path is not None:
            signals.append((path, m.shape, m.numpy_type, m.declaration))
            slots += range(at, at + m.size)
        at += m.size
    return slots
