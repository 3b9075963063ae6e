"""A scenario ready to fly in C: library, inputs, and the meaning of what comes out. Needs no JAX, so it can be kept."""

import ctypes
import functools
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, children, is_record, leaves
from trimtab.core.time import Timetable, timetable, to_seconds
from trimtab.logs.log import Log, provenance
from trimtab.native.build import load_library

SHORT = 5_000_000
"""Instants of all runs up to which a call is not watched: a second or so."""


class FlightJob(ctypes.Structure):
    """What the library is given: the struct `job` of the generated text."""

    _fields_ = [
        ("shared", ctypes.c_void_p),
        ("own", ctypes.c_void_p),
        ("own_count", ctypes.c_int64),
        ("runs", ctypes.c_int64),
        ("n", ctypes.c_int32),
        ("rows", ctypes.c_int32),
        ("t", ctypes.c_void_p),
        ("h", ctypes.c_void_p),
        ("row", ctypes.c_void_p),
        ("log", ctypes.c_void_p),
        ("stats", ctypes.c_void_p),
        ("final", ctypes.c_void_p),
        ("next", ctypes.c_int64),
        ("done", ctypes.c_int64),
        ("stop", ctypes.c_int64),
    ]


class RunResults(NamedTuple):
    """What came of some runs.

    log: (runs, rows, width), or None.  stats: (runs, width, 4): least, largest, sum and sum of squares of the logged
    rows, or None.  final: (runs, count), the last values.
    """

    log: Any
    stats: Any
    final: Any


@functools.lru_cache(maxsize=64)
def _load_entry(path: Path) -> Any:
    function = load_library(path).trimtab_fly
    function.argtypes = [ctypes.POINTER(FlightJob), ctypes.c_int32]
    function.restype = ctypes.c_int32
    return function


def thread_count(threads: int | None) -> int:
    """How many threads fly: as many as asked for, or as this process has cores."""
    if threads is not None:
        return max(1, min(threads, 256))
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fly_runs(
    path: Path,
    shared: Any,
    own: Any,
    table: Timetable,
    row: Any,
    widths: tuple[int, int],
    *,
    log: bool = True,
    stats: bool = False,
    threads: int = 1,
    progress: Callable[[int], None] | None = None,
) -> RunResults:
    """Fly runs on a library of a walk's text.

    Args:
        path: the library.
        shared: float64, the inputs that all runs share, flat in order.
        own: float64 (runs, k), the inputs of each run.
        table: the instants.
        row: int32 (n,), the row of the log that each instant writes; its largest + 1 for none.
        widths: numbers in a row, and last values.
        log, stats: what is kept besides the last values.
        threads: how many fly; the interpreter is free meanwhile.
        progress: called a few times a second with the number of runs that are done.
    """
    width, count = widths
    runs, rows = len(own), int((row < len(row)).sum())
    t, h = np.ascontiguousarray(table.t, np.int64), np.ascontiguousarray(table.h, np.int64)
    arrays = (np.ascontiguousarray(shared, np.float64), np.ascontiguousarray(own, np.float64), t, h, row)
    results = RunResults(
        log=np.empty((runs, rows, width)) if log else None,
        stats=np.empty((runs, width, 4)) if stats else None,
        final=np.empty((runs, count)),
    )
    at = [a.ctypes.data for a in arrays]
    out = [None if a is None else a.ctypes.data for a in results]
    job = FlightJob(at[0], at[1], arrays[1].shape[1], runs, len(t), rows, at[2], at[3], at[4], *out)
    if runs * len(t) < SHORT:
        _load_entry(path)(ctypes.byref(job), threads)
    else:
        _fly_in_thread(_load_entry(path), job, threads, progress)
    if job.done < runs:
        raise InputError("runs", f"there is no memory to fly {runs} of them on {threads} threads", fix="fewer threads")
    return results


def _fly_in_thread(entry: Any, job: FlightJob, threads: int, progress: Callable[[int], None] | None) -> None:
    """Fly beside the interpreter, so that Ctrl-C ends it: after the runs that are under way."""
    landed = threading.Event()  # a join that Ctrl-C breaks off takes a thread that still flies for ended

    def flight() -> None:
        entry(ctypes.byref(job), threads)
        landed.set()

    threading.Thread(target=flight).start()
    try:
        while not landed.wait(0.1):
            if progress is not None:
                progress(min(job.done, job.runs))
    finally:
        job.stop = 1
        landed.wait()
    if progress is not None:
        progress(min(job.done, job.runs))


def row_numbers(written: Any) -> Any:
    """int32 (n,): the row of each instant that is written, and n for those that are not."""
    return np.where(written, np.cumsum(written) - 1, len(written)).astype(np.int32)


class Column(NamedTuple):
    """One signal of a row, or one of the last values."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None = None


class Program(NamedTuple):
    """A compiled scenario.

    library: scalar C.  shared: its inputs, float64, with the key words (seed, run) at `words` to be filled in.
    periods, duration, max_step: what the timetable follows from.  columns: of a row.  final: the last values.
    metadata: what a log says besides seed and backend.
    """

    library: Path
    shared_inputs: Any
    words: tuple[int, int]
    periods: tuple[int, ...]
    duration: int
    max_step: int
    columns: list[Column]
    final: list[Column]
    metadata: dict[str, Any]

    def fly(self, seed: int, run: int, log_period: int) -> Log:
        """One run, as `simulate` gives it."""
        table = timetable(self.periods, self.duration, self.max_step)
        written = table.t % log_period == 0
        shared = self.shared_inputs.copy()
        shared[list(self.words)] = seed, run
        widths = row_width(self.columns), row_width(self.final)
        results = fly_runs(self.library, shared, np.empty((1, 0)), table, row_numbers(written), widths)
        metadata = self.metadata | {"seed": seed, "run": run, "log_period_s": to_seconds(log_period), "backend": "c"}
        return make_log(self.columns, self.final, results, 0, table.t[written], metadata)


def check_seed(seed: int) -> None:
    """Refuse a number that is no seed, or no number of a run."""
    if not 0 <= seed < 2**32:
        raise InputError("--seed", f"{seed} is not in 0 … {2**32 - 1}", fix="--seed 0")


def row_width(columns: list[Column]) -> int:
    """How many numbers some columns take."""
    return sum(int(np.prod(c.shape)) for c in columns)


def split_columns(rows: Any, columns: list[Column]) -> dict[str, Any]:
    """Columns by path, each in its own type and shape, of rows (..., width); what has its type already is a view."""
    signals, start = {}, 0
    for c in columns:
        stop = start + int(np.prod(c.shape))
        signals[c.path] = rows[..., start:stop].reshape((*rows.shape[:-1], *c.shape)).astype(c.dtype, copy=False)
        start = stop
    return signals


def make_log(
    columns: list[Column], final: list[Column], results: RunResults, run: int, ticks: Any, metadata: dict[str, Any]
) -> Log:
    """The log of one of the runs."""
    signals, last = split_columns(results.log[run], columns), split_columns(results.final[run], final)
    return Log(
        t=to_seconds(ticks),
        ticks=ticks,
        signals=signals,
        declarations={c.path: c.declaration for c in columns if c.declaration is not None},
        metadata=metadata,
        final={path: value[()] for path, value in last.items() if path.startswith("truth.")},
    )


def describe_scenario(scenario: Any) -> dict[str, Any]:
    """What a log says of its scenario; `choices` where it was built by name, so that a replay builds it alike."""
    return {
        "scenario": scenario.name,
        **({"choices": scenario.choices} if scenario.choices else {}),
        "duration_s": to_seconds(scenario.duration),
        "parameters": {p: plain_setting(v) for p, v, _ in leaves(scenario)},
        "parts": part_classes(scenario),
        **provenance(),
    }


def part_classes(tree: Any, path: str = "") -> dict[str, str]:
    """Path of each record below a tree -> the name of its class."""
    classes = {}
    for name, child, _ in children(tree):
        here = f"{path}.{name}" if path else name
        classes |= ({here: type(child).__name__} if is_record(child) else {}) | part_classes(child, here)
    return classes


def plain_setting(value: Any) -> Any:
    """A quantity or an option as a log's metadata has it."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    return np.asarray(value).tolist()
