"""Log that a separate process writes during a flight, so that the disk never delays the flight.

The flying process passes the rows to the writing process in a ring buffer.
"""

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.logs.frames import POSE_COLUMNS
from trimtab.logs.log import Log, provenance
from trimtab.logs.log_limit import LogLimit
from trimtab.logs.messages import EPOCH, EVENTS, dump_json, layout_record, run_record
from trimtab.logs.ring import Ring

Signal = tuple[str, tuple[int, ...], Any, Quantity | None]
"""Signal of a stream: path, shape of the value at one instant, type, and declaration or None."""
COUNTER_SIGNALS: dict[str, Quantity] = {
    "log.dropped": Quantity("1", "Number of rows lost before this row because the ring buffer was full.", kind="count"),
    "log.unwritten": Quantity("1", "Number of rows lost before this row because the disk had no room.", kind="count"),
}
"""Signals that the writing process adds to each row: path -> declaration."""
START_S, END_S, KILL_S = 30.0, 5.0, 1.0
"""Time limits (s) of the writing process: for its start, for each chunk at the end of the log, and for its end after it
was killed."""


class LogFileSummary(NamedTuple):
    """Summary of a log file.

    rows: number of rows in the file.  dropped: number of rows lost because the ring buffer was full.  unwritten: number
    of rows lost because the disk was full, or because their time was not later than that of the row before.
    size: size of the file (bytes).  minute_size: bytes per minute of flight, or None for fewer than two rows.
    cpu_s: processor time of the writing process (s).  whole: True if the file was completed.  gone: True if the file
    was deleted or moved during the flight.
    """

    rows: int
    dropped: int
    unwritten: int
    size: int
    minute_size: float | None
    cpu_s: float
    whole: bool
    gone: bool = False


class LogStream:
    """Control of the process that writes a log. The methods never wait and never fail, except `close`."""

    def __init__(self, path: Path, process: "subprocess.Popen[bytes]") -> None:
        """Control a process that `start_writer` has started. path: path of the log."""
        self.path, self._process = path, process

    @property
    def is_alive(self) -> bool:
        """Return True while the writing process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Return the process ID of the writing process."""
        return self._process.pid

    def set_epoch(self, epoch: int) -> None:
        """Set the time of day (ns since 1970) at time zero of the log. Call this before the first row."""
        with contextlib.suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps({EPOCH: epoch}).encode() + b"\n")
            self._process.stdin.flush()

    def close(self, final: Mapping[str, Any] | None = None) -> LogFileSummary | None:
        """End the log, wait until it is on the disk, and return a summary.

        Return None if the writing process has ended or does not respond.

        Args:
            final: path of a signal -> value at the end of the run, see `Log`.
        """
        values = {} if final is None else {p: np.asarray(v) for p, v in final.items()}
        text = dump_json({p: {"dtype": v.dtype.str, "value": v.tolist()} for p, v in values.items()})
        try:
            said = self._await_end(json.dumps({"final": text}).encode() + b"\n")
            return LogFileSummary(**json.loads(said.splitlines()[-1]), gone=not self.path.exists())
        except (OSError, ValueError, IndexError, subprocess.TimeoutExpired):
            self._process.kill()
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):  # a slow disk delays the process's end
                self._process.communicate(timeout=KILL_S)
        return None

    def _await_end(self, order: bytes | None) -> bytes:
        """Send the last command and return the process's output. Raise TimeoutExpired after END_S without progress."""
        heard = b""
        while True:
            try:
                return self._process.communicate(order, timeout=END_S)[0]
            except subprocess.TimeoutExpired as late:
                if len(late.output or b"") <= len(heard):
                    raise
                order, heard = None, late.output


def start_writer(
    path: str | os.PathLike[str],
    ring: Ring,
    *,
    signals: Sequence[Signal],
    metadata: Mapping[str, Any],
    frame: str = "",
    limit: LogLimit | None = None,
) -> LogStream:
    """Start a process that writes the content of a ring buffer to a log file, at least four times a second.

    A row of the ring buffer contains the time (100 ns, increasing, not negative), and then the numbers of the signals.

    Args:
        path: path of a new file.
        ring: ring buffer that this process has created.
        signals: signals in a row, after the time.
        metadata: metadata of the log, e.g. scenario, parameters, seed, backend, calibration. Version, machine and time
            of day are added.
        frame: name of the vehicle's frame. If it is not empty, each row must end with the pose, see `logs.frames`.
        limit: limit of the log's size on the disk, or None for no limit.

    Raises:
        InputError: the signals do not match the width of the ring buffer, or the file exists or cannot be written.
    """
    target, empty = Path(path), _empty_log(signals, metadata)
    width = 1 + sum(int(np.prod(shape)) for _, shape, _, _ in signals) + (POSE_COLUMNS if frame else 0)
    if width != ring.columns:
        problem = f"the rows of the ring have {ring.columns} numbers, but the time and these signals have {width}"
        raise InputError("ring", problem, fix=f"Ring.create(columns={width})")
    about = {"path": str(target), "ring": ring.name, "run": run_record(empty), "layout": layout_record(empty)}
    orders = about | {"frame": frame, "limit": limit}
    process = subprocess.Popen(
        [sys.executable, "-m", "trimtab.logs.stream_writer"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        start_new_session=True,
    )
    _await_start(process, json.dumps(orders).encode() + b"\n")
    return LogStream(target, process)


def _empty_log(signals: Sequence[Signal], metadata: Mapping[str, Any]) -> Log:
    """Return an empty log with the signals and metadata. Raise InputError if a signal has a reserved name."""
    taken = [path for path, _, _, _ in signals if path.startswith(("log.", f"{EVENTS[1:]}."))]
    if taken:
        problem = f"signal {taken[0]!r} has a name reserved for the log"
        raise InputError("log", problem, fix=f"give the signal another name, e.g. 'flight.{taken[0]}'")
    arrays = {path: np.empty((0, *shape), dtype) for path, shape, dtype, _ in signals}
    declared = {path: quantity for path, _, _, quantity in signals if quantity is not None}
    began = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
    nothing = np.empty(0, np.int64)
    return Log(
        t=nothing.astype(np.float64),
        ticks=nothing,
        signals=arrays | dict.fromkeys(COUNTER_SIGNALS, nothing),
        declarations=declared | COUNTER_SIGNALS,
        metadata=provenance() | began | dict(metadata),
    )


def _await_start(process: "subprocess.Popen[bytes]", about: bytes) -> None:
    """Send the settings to the writing process. Raise InputError if it rejects them or does not start."""
    said = b""
    with contextlib.suppress(OSError):
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(about)
        process.stdin.flush()
        if select.select([process.stdout], [], [], START_S)[0]:
            said = process.stdout.readline()
    answer = (
        json.loads(said)
        if said
        else {"part": "log", "problem": "the process that writes the log did not start", "fix": ""}
    )
    if answer:
        process.kill()
        process.communicate()
        raise InputError(answer["part"], answer["problem"], fix=answer["fix"])
