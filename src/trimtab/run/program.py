"""Compiled scenario: its C library, its inputs, and the signals that its outputs represent. It runs without JAX."""

import ctypes
import functools
import math
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.compiler.native.build import load_library
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import Quantity, leaves, part_classes, plain_setting
from trimtab.core.time import Timetable, format_time, ms, timetable, to_seconds
from trimtab.logs.log import LazyMapping, Log, provenance, to_plain
from trimtab.loop.model_mismatch import belief_mismatches

SHORT = 5_000_000
"""Largest number of instants, over all runs, that are flown without a check for Ctrl-C. They take about a second."""


class FlightJob(ctypes.Structure):
    """Argument of the library's function: the struct `job` in the generated C text."""

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
    """Results of one or more runs.

    log: logged rows (runs, rows, width), or None.  stats: minimum, maximum, sum and sum of squares of each number over
    the logged rows (runs, width, 4), or None.  final: values at the end of each run (runs, count).
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
    """Return the number of threads: as requested, up to 256, or the number of cores available to this process."""
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
    """Fly runs with the compiled library of a walk.

    Args:
        path: path of the library.
        shared: inputs that all runs share, as a vector, float64.
        own: inputs that differ between runs, float64 (runs, k).
        table: instants of a run.
        row: index of the log row of each instant, int32 (n,), or n for an instant that is not logged.
        widths: number of values in a row, and number of final values.
        log, stats: True to return the logged rows, and True to return their statistics. Final values are always
            returned.
        threads: number of threads. The Python interpreter can run other threads meanwhile.
        progress: function called a few times a second with the number of completed runs.
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
        raise InputError("runs", f"not enough memory to fly {runs} runs on {threads} threads", fix="use fewer threads")
    return results


def _fly_in_thread(entry: Any, job: FlightJob, threads: int, progress: Callable[[int], None] | None) -> None:
    """Fly the runs in another thread. Ctrl-C then ends the call as soon as the runs in progress are complete."""
    landed = threading.Event()  # an event, because a join that Ctrl-C interrupts reports a running thread as ended

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
    """Return the index of the log row of each instant, int32 (n,), or n for an instant that is not logged."""
    return np.where(written, np.cumsum(written) - 1, len(written)).astype(np.int32)


class Column(NamedTuple):
    """Signal in a log row, or in the final values: path, shape, type and declaration."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None = None


class Program(NamedTuple):
    """Compiled scenario.

    library: path of the library, which flies one run at a time.  shared_inputs: inputs of a run, float64.  words:
    indices in these inputs at which seed and run number are written.  periods, duration, max_step: times that determine
    the instants of a run.  columns: signals in a log row.  final: signals in the final values.  metadata: metadata of a
    log, except seed, run and backend.  noise: random key words of the scenario. If there are any, the run number is
    added to each of them, and they are written from the second index on.
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
    noise: tuple[int, ...] = ()

    def fly(self, seed: int, run: int, log_period: int) -> Log:
        """Fly one run and return its log, as `simulate` does."""
        check_log_period(log_period, self.duration)
        table, row, instants = _log_rows(self.periods, self.duration, self.max_step, log_period)
        shared = self.shared_inputs.copy()
        shared[list(self.words)] = seed, run
        for i, word in enumerate(self.noise):
            shared[self.words[1] + i] = (word + run) % 2**32
        widths = row_width(self.columns), row_width(self.final)
        results = fly_runs(self.library, shared, np.empty((1, 0)), table, row, widths)
        metadata = self.metadata | {"seed": seed, "run": run, "log_period_s": to_seconds(log_period), "backend": "c"}
        return make_log(self.columns, self.final, results, 0, instants, metadata)


@functools.lru_cache(maxsize=8)
def _log_rows(periods: tuple[int, ...], duration: int, max_step: int, log_period: int) -> tuple[Timetable, Any, Any]:
    """Return the instants of a run, the index of the log row of each instant, and the logged instants."""
    table = timetable(periods, duration, max_step)
    written = table.t % log_period == 0
    return table, row_numbers(written), logged_instants(table, written)


def logged_instants(table: Timetable, written: Any) -> tuple[Any, Any]:
    """Return the logged instants, in 100 ns and in seconds. They are read-only, because several logs share them."""
    ticks = table.t[written]
    t = to_seconds(ticks)
    ticks.flags.writeable = t.flags.writeable = False
    return ticks, t


def check_seed(seed: Any, name: str = "seed") -> None:
    """Raise InputError if a value is not a valid seed or run number. name: name of the argument."""
    is_whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not (is_whole and 0 <= seed < 2**32):
        problem = f"must be a whole number in 0 … {2**32 - 1}, got {seed!r}"
        raise InputError(argument_name(name), problem, fix=argument(name, 0))


def check_log_period(log_period: int, duration: int) -> None:
    """Raise InputError if a log period is 0, or longer than the flight. 1 ms is valid for any flight."""
    if not 0 < log_period <= max(duration, ms(1)):
        problem = f"must be above 0 s and at most the flight's {format_time(duration)}, got {format_time(log_period)}"
        raise InputError(argument_name("log_period"), problem, fix=argument("log_period", "1 ms"))


def row_width(columns: list[Column]) -> int:
    """Return the total number of values in these columns."""
    return sum(math.prod(c.shape) for c in columns)


def split_columns(rows: Any, columns: list[Column]) -> dict[str, Any]:
    """Return path -> values of a column in rows (..., width), in its type and shape. float64 values are views."""
    return {
        path: rows[..., part].reshape((*rows.shape[:-1], *shape)).astype(dtype, copy=False)
        for path, (part, shape, dtype) in _column_places(columns).items()
    }


def _column_places(columns: list[Column]) -> dict[str, tuple[slice, tuple[int, ...], str]]:
    """Return path of a column -> slice of a row that contains the column, its shape and its type."""
    places, start = {}, 0
    for c in columns:
        stop = start + math.prod(c.shape)
        places[c.path] = slice(start, stop), c.shape, c.dtype
        start = stop
    return places


def make_log(
    columns: list[Column],
    final: list[Column],
    results: RunResults,
    run: int,
    instants: tuple[Any, Any],
    metadata: dict[str, Any],
) -> Log:
    """Return the log of one run. Each signal is created when it is first read.

    run: index of the run in the results.  instants: see `logged_instants`.  metadata: JSON-compatible values, copied
    when they are read.
    """
    ticks, t = instants
    rows = results.log[run] if len(results.log) == 1 else results.log[run].copy()
    places = _column_places(columns)
    for path, (_, shape, _) in places.items():
        if len(shape) > 1:
            problem = f"must be a number or a vector at each instant, but has shape {shape}"
            raise InputError(f"log signal {path!r}", problem, fix=f"give it shape () or ({math.prod(shape)},)")

    def signal(path: str) -> Any:
        part, shape, dtype = places[path]
        values = rows[:, part].reshape(len(rows), *shape).astype(dtype)
        values.flags.writeable = False
        return values

    last = split_columns(results.final[run], final)
    return Log.of_flight(
        t=t.view(),
        ticks=ticks.view(),
        signals=LazyMapping(places, signal),
        declarations={c.path: c.declaration for c in columns if c.declaration is not None},
        metadata=LazyMapping(metadata, lambda name: to_plain(f"log.metadata.{name}", metadata[name])),
        final={path: value[()] for path, value in last.items() if path.startswith(("truth.", "world."))},
    )


def describe_scenario(scenario: Any) -> dict[str, Any]:
    """Return the metadata with which a log describes its scenario.

    For a scenario built by name, they include `choices`, from which a replay rebuilds the scenario.
    """
    mismatch = [m._asdict() for m in belief_mismatches(scenario.autopilot, scenario.world.vehicle)]
    about = {
        "scenario": scenario.name,
        **({"choices": scenario.choices} if scenario.choices else {}),
        "duration_s": to_seconds(scenario.duration),
        "parameters": {p: plain_setting(v) for p, v, _ in leaves(scenario)},
        "parts": part_classes(scenario),
        **({"mismatch": mismatch} if mismatch else {}),
        **({"words": list(scenario.words)} if scenario.words else {}),
        **provenance(),
    }
    return to_plain("log.metadata", about)
