"""A compiled flight in memory: parameters and timetable in, rows, statistics and last values out; needs no JAX."""

import ctypes
import functools
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import Timetable
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


def thread_count(wanted: int | None) -> int:
    """How many threads fly: as many as wanted, or as this process has cores."""
    if wanted is not None:
        return max(1, min(wanted, 256))
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
    """Fly runs on a library that `Flight.text` was built into.

    Args:
        path: the library.
        shared: float64, the inputs that all runs share, flat in order.
        own: float64 (runs, k), the inputs of each run.
        table: the instants.
        row: int32 (n,), the row of the log that each instant writes; its largest + 1 for none.
        widths: numbers in a row, and last values.
        log, stats: what is wanted besides the last values.
        threads: how many fly; the interpreter is free meanwhile.
        progress: called a few times a second with the number of runs that are done.
    """
    width, count = widths
    runs, rows = len(own), int((row < len(row)).sum())
    t, h = np.ascontiguousarray(table.t, np.int64), np.ascontiguousarray(table.h, np.int64)
    held = (np.ascontiguousarray(shared, np.float64), np.ascontiguousarray(own, np.float64), t, h, row)
    flown = RunResults(
        log=np.empty((runs, rows, width)) if log else None,
        stats=np.empty((runs, width, 4)) if stats else None,
        final=np.empty((runs, count)),
    )
    at = [a.ctypes.data for a in held]
    out = [None if a is None else a.ctypes.data for a in flown]
    job = FlightJob(at[0], at[1], held[1].shape[1], runs, len(t), rows, at[2], at[3], at[4], *out)
    if runs * len(t) < SHORT:
        _load_entry(path)(ctypes.byref(job), threads)
    else:
        _fly_in_thread(_load_entry(path), job, threads, progress)
    return flown


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
