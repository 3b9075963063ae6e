"""Log of a flight: each row contains inputs and outputs of compiled blocks. A separate process writes the rows to the
disk.

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
"""Name of the coordinate frame that moves with the vehicle, in the vehicle's log and in the autopilot's log."""
ROWS = 16384
"""Number of rows in the ring buffer, which keeps rows while the disk delays the writer's process."""
WRITER_DIED = f"the log's writer died, or wrote nothing for {END_S:g} s; the rows written before are kept"


class LogSource(NamedTuple):
    """Vector of numbers that is copied into each row of a log, e.g. the outputs of a compiled block.

    name: function from the path of a member in the vector to the member's path in the log. If the result is None, the
    member is not logged.
    """

    vector: Any
    members: Sequence[Member]
    name: Callable[[str], str | None]


def frame_signals(prefix: str) -> dict[str, tuple[str, Quantity]]:
    """Return the declarations of the log signals that count a link's frames. Their paths start with `prefix`.
    `count_frames` returns their values."""
    return {
        f"{prefix}.refused": ("i8", Quantity("1", "Number of received frames refused so far.", kind="count")),
        f"{prefix}.lost": (
            "i8",
            Quantity("1", "Number of frames lost so far, counted from gaps in the sequence numbers.", kind="count"),
        ),
        f"{prefix}.damaged": (
            "i8",
            Quantity("1", "Number of received frames with a wrong checksum so far.", kind="count"),
        ),
        f"{prefix}.garbage": ("i8", Quantity("1", "Number of received bytes outside frames so far.", kind="count")),
    }


def count_frames(counts: FrameCounts) -> tuple[int, int, int, int]:
    """Return the current values of the signals that `frame_signals` declares."""
    return counts.refusals, counts.lost, counts.checksum, counts.garbage


class FlightRows:
    """Layout of a log row of a flight: first the values from vectors of compiled blocks, then the values that the
    caller passes with the row.
    """

    def __init__(self, sources: Sequence[LogSource], own: Mapping[str, tuple[str, Quantity]]) -> None:
        """Define the layout of a row.

        Args:
            sources: vectors that are copied into each row.
            own: type and declaration of each signal whose value the caller passes with a row, by path.
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
        """Write the current values into a row, an array of float64 with shape (width,). own: values of the caller's
        signals."""
        for vector, index, where in self._picks:
            row[where] = vector[index]
        row[self._own] = own


class FlightRecorder(Protocol):
    """Interface of the log of a live vehicle or autopilot. Only the method `await_room` waits."""

    pose: Any
    """Pose of the vehicle, with the layout of `logs.frames`. Each row of the log contains the pose that was set
    last."""
    unread_rows: int
    """Number of rows that the writer's process had not read when this process died."""

    def start_clock(self, start: int, clock: Clock) -> None:
        """Set the log's time zero to `start`, a time of the monotonic clock (ns). Call this before the first row."""
        ...

    def write_row(self, t: int, own: Sequence[float] = ()) -> None:
        """Write the row of time t: the current values of the vectors, then the values in `own`."""
        ...

    def await_room(self) -> None:
        """Wait until the log's buffer has room for a row. Call this in lockstep, where a flight may be faster than the
        disk."""
        ...

    def write_event(self, text: str) -> None:
        """Write a line of text into the log, between two rows."""
        ...

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log. Return the summary of the log, or None if the writer's process has died or has stopped
        writing."""
        ...


class FlightLog:
    """Log of a live flight that copies each row into a ring buffer within a few microseconds. Only the method
    `await_room` waits."""

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
            frame: name of the coordinate frame whose pose each row contains. Empty: rows contain no pose.
            limit: maximum size of the log on the disk; None: no limit.
        """
        self._rows, stop = rows, 1 + rows.width
        self.pose: Any = no_pose() if frame else np.zeros(0)
        """Pose of the vehicle at the time of the next row, with the layout of `logs.frames`. Change it in place."""
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
        """Write the row of time t: the current values of the vectors, then the values in `own`."""
        self._row[0] = t
        self._rows.fill(self._numbers, own)
        self._poses[:] = self.pose
        self._ring.write_row(self._row)

    def await_room(self) -> None:
        """Wait until the log's buffer has room for a row or the writer's process has died. Call this in virtual time,
        which may be faster than the disk."""
        while self._ring.waiting_rows >= self._ring.rows and self._stream.is_alive:
            SYSTEM_CLOCK.wait(None, 1e-3)

    def start_clock(self, start: int, clock: Clock = SYSTEM_CLOCK) -> None:
        """Set the log's time zero to `start`, a time of the monotonic clock (ns). Call this before the first row."""
        self._stream.set_epoch(round(clock.unix() * NS_PER_SECOND) - clock.monotonic_ns() + start)

    def write_event(self, text: str) -> None:
        """Write a line of text into the log, between two rows."""
        self._ring.write_text(text)

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log and return the summary of the log. If the writer's process has died or has stopped writing,
        return None and set `unread_rows`."""
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
    """End a log and return the summary of the log. If lines of text for the user were lost, first write their number
    into the log.

    Args:
        log: the log, or None if no log is written.
        lost_lines: number of lines of text for the user that were lost.
        final: final values that are stored in the log.
    """
    if log is None:
        return None
    if lost_lines:
        log.write_event(f"{lost_lines} lines for the user were lost: the terminal or the reader did not accept them")
    return log.close(final)


def list_log_problems(log: FlightRecorder | None, summary: LogFileSummary | None) -> list[str]:
    """Return the problems of a closed log. log: the log, or None if no log was written.  summary: summary of the log,
    or None if the writer's process has died."""
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
    """Disk for the logs of live vehicles and autopilots: the disk of this machine, or a disk in virtual time."""

    def free_bytes(self, folder: Path) -> int:
        """Return the free space (bytes) on the disk that contains a folder."""
        ...

    def open_log(
        self, path: Path, rows: FlightRows, metadata: Mapping[str, Any], frame: str, limit: LogLimit | None
    ) -> FlightRecorder:
        """Open a log. The arguments are those of `FlightLog`."""
        ...


LOOK_S = 1.0
"""Time (s) between two measurements of the free space."""


class SystemDisk:
    """Disk of this machine. A separate process writes each log."""

    def __init__(self) -> None:
        self._free: dict[Path, int] = {}

    def free_bytes(self, folder: Path) -> int:
        """Return the last measured free space (bytes) on the disk that contains a folder, or 0 if the folder is
        missing.

        The first call for a folder measures the space. A thread then repeats the measurement, so that a disk that hangs
        does not delay later calls.
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
        sources: vectors that are copied into each row.
        own: type and declaration of each signal whose value the caller passes with a row, by path.
        scenario: the scenario that is flown.
        side: "autopilot" or "vehicle".
        seed: seed of the random numbers.
        log_period: time between rows (100 ns).
        is_live: True if the flight runs in real time, so that `start_clock` will be called.
        limit: maximum size of the log (bytes), or None. At the limit, a vehicle's log drops its oldest files, and an
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
    """Return the indices of the logged elements of a vector. Append a signal for each logged member to `signals`."""
    slots, at = [], 0
    for m in source.members:
        path = source.name(m.name)
        if path is not None:
            signals.append((path, m.shape, m.numpy_type, m.declaration))
            slots += range(at, at + m.size)
        at += m.size
    return slots
