"""Process that writes a log during a flight, started by `logs.stream`.

The process reads its settings, a text line of JSON, from standard input. A later line may set the time of day. The log
ends after a line with the final values, or when the standard input is closed, e.g. because the flying process has died.
"""

import contextlib
import errno
import json
import math
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.logs.frames import POSE_COLUMNS, FrameWriter, frame_topics
from trimtab.logs.growing_file import GrowingFile, Message
from trimtab.logs.log import Log
from trimtab.logs.log_limit import LogLimit, format_size, numbered_file
from trimtab.logs.messages import (
    CLOCK,
    EPOCH,
    EVENT_SCHEMA,
    EVENTS,
    LAYOUT,
    NS_PER_TICK,
    RUN,
    Topic,
    dump_json,
    event_text,
    load_json,
    log_topics,
    message_texts,
    parse_quantity,
)
from trimtab.logs.ring import Ring

POLL_S, CHUNK_S = 0.05, 0.2
"""Time between two readings of the ring buffer (s), and time between two writes to the disk (s)."""
ROWS = 1000
"""Maximum number of rows in a chunk of the file."""
NICE = 5


class Recorder:
    """Recorder that writes the rows and texts of a ring buffer to a log file.

    Args:
        ring: ring buffer to read.
        file: descriptor of a new file.
        run, layout: metadata records of the run and of its signals, as text.
        frame: name of the vehicle's frame. If it is not empty, each row ends with the pose, and the recorder waits for
            the time of day before it writes.
        path: path of the file.
        limit: limit of the size of all files of the log, or None for no limit.
    """

    def __init__(
        self,
        ring: Ring,
        file: int,
        run: dict[str, str],
        layout: dict[str, str],
        *,
        frame: str = "",
        path: Path | None = None,
        limit: LogLimit | None = None,
    ) -> None:
        """Write the beginning of the file. Raise OSError if this fails."""
        self._ring, self._run, self._layout = ring, run, layout
        self._signals: dict[str, Any] = load_json(layout["signals"])
        self._declared = {path: parse_quantity(d) for path, d in load_json(layout["declared"]).items()}
        self._topics = log_topics(self._rows_as_log(np.empty((0, ring.columns)), np.empty(0), np.empty(0)))
        events = Topic(EVENTS, {}, EVENT_SCHEMA["title"], json.dumps(EVENT_SCHEMA).encode())
        self._frames = FrameWriter(frame) if frame else None
        self._topics_of_file = [*self._topics, events, *frame_topics()]
        self._file = GrowingFile(file, {RUN: run, LAYOUT: layout}, self._topics_of_file)
        self._path, self._limit = path, limit
        self._number, self._file_rows = 1, 0
        self._sizes: dict[Path, int] = {}
        self._head, self._removed = self._file.size, 0
        self._epoch = None if frame else 0
        self._rows: list[Any] = []
        self._dropped: list[Any] = []
        self._events: list[tuple[int, str]] = []
        self._last, self._taken, self._written, self._unwritten, self._lost = -1, 0, 0, 0, 0
        self._full = ""

    def set_epoch(self, epoch: int) -> None:
        """Set the time of day at time zero (ns since 1970). Call this before the first row.

        The time is not stored if the disk is full.
        """
        with contextlib.suppress(OSError):
            self._file.add_metadata({CLOCK: {EPOCH: str(epoch)}})
            self._epoch = epoch
            return
        self._epoch = 0

    def read_ring(self) -> None:
        """Read all rows and texts from the ring buffer, and store them until `write` is called."""
        heard = self._ring.read_texts()
        sequences, rows = self._ring.read_rows()
        later = np.maximum.accumulate(np.append(self._last, rows[:, 0]))
        good = rows[:, 0] > later[:-1]
        self._unwritten += int((~good).sum())
        self._events += [(0 if math.isnan(event.newest) else int(event.newest), event.text) for event in heard]
        dropped = sequences - np.arange(self._taken, self._taken + len(rows))
        self._taken += len(rows)
        if good.any():
            self._last = int(rows[good][-1, 0])
            self._rows.append(rows[good])
            self._dropped.append(dropped[good])

    def write(self, report_progress: Callable[[], None] = lambda: None) -> None:
        """Write all stored rows and texts to the disk. Do nothing while the time of day is needed but unknown.

        report_progress: function that is called after each chunk.
        """
        if self._epoch is None:
            return
        rows = np.concatenate([np.empty((0, self._ring.columns)), *self._rows])
        dropped = np.concatenate([np.empty(0, np.int64), *self._dropped])
        self._rows, self._dropped = [], []
        for first in range(0, len(rows), ROWS):
            self._write_chunk(rows[first : first + ROWS], dropped[first : first + ROWS])
            report_progress()
        if self._events:
            self._write_chunk(rows[:0], dropped[:0])

    def _write_chunk(self, rows: Any, dropped: Any) -> None:
        log = self._rows_as_log(rows, dropped, np.full(len(rows), self._unwritten))
        said = [f"the log has a gap of {self._lost} rows: {self._full}"] if self._full else []
        events = [*self._events, *((int(rows[0, 0]), text) for text in said if len(rows))]
        messages = [*self._log_messages(log), *self._event_messages(events), *self._frame_messages(rows)]
        if not messages:
            return
        if self._limit is not None and self._file.size >= self._limit.file_size:
            self._follow_limit(self._limit)
        try:
            if self._limit is not None and self._file.size >= self._limit.size:
                raise OSError(errno.EFBIG, f"the limit of {format_size(self._limit.size)} is reached")
            self._file.write(messages)
        except OSError as error:
            self._count_failure(error, len(rows))
            return
        self._written += len(rows)
        self._file_rows += len(rows)
        self._events = []
        if self._full and len(rows):
            _report(f"writes again, after a gap of {self._lost} rows")
            self._full, self._lost = "", 0

    def _follow_limit(self, limit: LogLimit) -> None:
        """End a full file, continue in a new file, and delete the oldest files of the log.

        If no new file can be created, do nothing.
        """
        if not limit.rolls or self._path is None or self._file.size >= limit.size:
            return
        before, following = self._file, self._open_next(numbered_file(self._path, self._number + 1))
        if following is None:
            return
        self._end_file(before, {"closed": dump_json(True)}, "{}")
        before.close()
        self._sizes[numbered_file(self._path, self._number)] = before.size
        self._file, self._number, self._file_rows = following, self._number + 1, 0
        if self._frames is not None:
            self._frames.begin_file()
        while self._sizes and sum(self._sizes.values()) + limit.file_size > limit.size:
            oldest = next(iter(self._sizes))
            with contextlib.suppress(OSError):
                oldest.unlink()
            self._removed += self._sizes.pop(oldest)

    def _open_next(self, path: Path) -> GrowingFile | None:
        """Open the next file of the log with the same metadata. Return None if this fails, e.g. on a full disk."""
        try:
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except OSError:
            return None
        try:
            run = self._run | {"file": dump_json(self._number + 1)}
            following = GrowingFile(file, {RUN: run, LAYOUT: self._layout}, self._topics_of_file)
            if self._epoch:
                following.add_metadata({CLOCK: {EPOCH: str(self._epoch)}})
        except OSError:
            os.close(file)
            path.unlink(missing_ok=True)
            return None
        return following

    def _end_file(self, file: GrowingFile, about: dict[str, str], final: str) -> bool:
        """Write the last metadata and the end of a file. Return False if this fails, e.g. on a full disk."""
        layout = {**self._layout, "rows": dump_json(self._file_rows), "final": final}
        number = {"file": dump_json(self._number)} if self._number > 1 else {}
        try:
            file.add_metadata({RUN: self._run | number | about, LAYOUT: layout})
            file.finish()
        except OSError as error:
            _report(f"has no end ({error.strerror}); what was written can be read")
            return False
        return True

    def _count_failure(self, error: OSError, rows: int) -> None:
        """Count rows that could not be written, and report the first failure to the user. The flight continues."""
        if not self._full:
            _report(f"can't be written ({error.strerror}); the flight goes on, rows are counted, free some space")
        self._full = error.strerror or str(error)
        self._lost += rows
        self._unwritten += rows
        self._events = self._events[-self._ring.events :]

    def _log_messages(self, log: Log) -> list[Message]:
        texts = [message_texts(log, topic.fields, slice(None)) for topic in self._topics]
        times = ((self._epoch or 0) + log.ticks * NS_PER_TICK).tolist()
        return [
            (channel, self._written + i, time, topic[i])
            for i, time in enumerate(times)
            for channel, topic in enumerate(texts, 1)
        ]

    def _event_messages(self, events: list[tuple[int, str]]) -> list[Message]:
        channel, said = (
            len(self._topics) + 1,
            [((self._epoch or 0) + ticks * NS_PER_TICK, text) for ticks, text in events],
        )
        return [(channel, 0, time, event_text(time, text)) for time, text in said]

    def _frame_messages(self, rows: Any) -> list[Message]:
        if self._frames is None:
            return []
        first = len(self._topics) + 2
        messages = self._frames.messages(rows[:, 0].astype(np.int64), rows[:, -POSE_COLUMNS:], self._epoch or 0)
        return [(first + m.topic, 0, m.time, m.text) for m in messages]

    def _rows_as_log(self, rows: Any, dropped: Any, unwritten: Any) -> Log:
        """Return rows of the ring buffer as a log, with each signal converted to the declared data type."""
        ticks, arrays, at = rows[:, 0].astype(np.int64), {}, 1
        for path, about in self._signals.items():
            if path in ("log.dropped", "log.unwritten"):
                continue
            size = int(np.prod(about["shape"]))
            with np.errstate(invalid="ignore"):
                values = rows[:, at : at + size].astype(about["dtype"])
            arrays[path] = values.reshape(len(rows), *about["shape"])
            at += size
        arrays |= {"log.dropped": dropped.astype(np.int64), "log.unwritten": unwritten.astype(np.int64)}
        return Log(t=to_seconds(ticks), ticks=ticks, signals=arrays, declarations=self._declared)

    def finish(self, final: str | None, report_progress: Callable[[], None] = lambda: None) -> dict[str, Any]:
        """Write the remaining rows and the end of the file. Return the fields of `LogFileSummary`.

        final: final values as JSON text, or None if the flying process sent no final values.
        report_progress: function that is called after each chunk.
        """
        if final is None:
            self._events.append((max(self._last, 0), "the flying process is gone, without a word"))
        self.read_ring()
        self._epoch = self._epoch or 0
        self.write(report_progress)
        counts = {"rows": self._written, "dropped": self._ring.dropped_rows, "unwritten": self._unwritten}
        about = {"log": dump_json(counts), "closed": dump_json(final is not None)}
        whole = self._end_file(self._file, about, final or "{}")
        size = self._file.size + sum(self._sizes.values())
        costs = {"size": size, "minute_size": self._minute_size(size), "cpu_s": time.process_time(), "whole": whole}
        return counts | costs

    def _minute_size(self, size: int) -> float | None:
        """Return the growth of the log (bytes) per minute of flight, including deleted files, or None before the second
        row."""
        return None if self._last <= 0 else 60 * (size + self._removed - self._head) / to_seconds(self._last)


def main() -> None:
    """Write a log with the settings from standard input, and send replies to standard output."""
    _isolate_process()
    orders = json.loads(sys.stdin.buffer.readline())
    try:
        ring = Ring.attach(orders["ring"])
        try:
            file = os.open(orders["path"], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
            recorder = Recorder(
                ring,
                file,
                orders["run"],
                orders["layout"],
                frame=orders["frame"],
                path=Path(orders["path"]),
                limit=None if orders["limit"] is None else LogLimit(*orders["limit"]),
            )
        except OSError as error:
            fix = "use the path of a new file, in a folder that you can write to"
            problem = f"cannot be written: {error.strerror or error}"
            raise InputError(f"log file '{orders['path']}'", problem, fix=fix) from None
    except InputError as error:
        print(json.dumps({"part": error.part, "problem": error.problem, "fix": error.fix}), flush=True)
        return
    print("{}", flush=True)
    said = record_until_stopped(recorder)
    result = recorder.finish(said, lambda: _answer(""))
    _answer(json.dumps(result))
    ring.close()


def record_until_stopped(recorder: Recorder) -> str | None:
    """Write the log until the final values arrive on standard input, and return these values.

    Return None if the standard input is closed before.
    """
    due, heard = time.monotonic() + CHUNK_S, b""
    while True:
        if select.select([sys.stdin.buffer], [], [], POLL_S)[0]:
            more = os.read(sys.stdin.fileno(), 2**20)
            *lines, heard = (heard + more).split(b"\n")
            for word in map(json.loads, lines):
                if "final" in word:
                    return word["final"]
                recorder.set_epoch(word[EPOCH])
            if not more:
                return None
        recorder.read_ring()
        if time.monotonic() >= due:
            recorder.write()
            due = time.monotonic() + CHUNK_S


def _isolate_process() -> None:
    """Ignore the signals (e.g. Ctrl-C) that end the flying process, and lower the priority of this process."""
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)


def _answer(text: str) -> None:
    """Send a text line to the flying process, which may have ended. An empty line reports progress."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), text.encode() + b"\n")


def _report(text: str) -> None:
    print(f"log: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
