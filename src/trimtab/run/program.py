"""Compiled scenario, which runs without JAX: C library, inputs, and names of the logged signals."""

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
from trimtab.loop.model_mismatch import model_mismatches

SHORT = 5_000_000
"""Largest number of instants, over all runs, that are simulated without a check for Ctrl-C. This takes about a
second."""


class FlightJob(ctypes.Structure):
    """Argument of the compiled library's function: the struct `job` in the generated C text."""

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

    log: log rows (runs, rows, width), or None.  stats: minimum, maximum, sum and sum of squares of each column over the
    log rows of a run (runs, width, 4), or None.  final: values at the end of each run (runs, count).
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
    """Return the number of threads to use.

    threads: requested number, limited to 1 … 256. None: the number of processor cores available to this process.
    """
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
    """Run a scenario one or many times with its compiled library, and return the results.

    Args:
        path: path of the library.
        shared: inputs that are equal in all runs, as a vector, float64.
        own: inputs that differ from run to run, float64 (runs, k).
        table: instants of a run.
        row: index of the log row of each of the n instants, int32 (n,), or n for an instant that is not logged.
        widths: number of values in a log row, and number of final values.
        log: True to return the log rows.
        stats: True to return statistics of the log rows.
        threads: number of threads. Other Python threads can run meanwhile.
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
        raise InputError("runs", f"not enough memory for {runs} runs on {threads} threads", fix="use fewer threads")
    return results


def _fly_in_thread(entry: Any, job: FlightJob, threads: int, progress: Callable[[int], None] | None) -> None:
    """Fly the runs of a job in another thread, so that Ctrl-C ends the call when the runs in progress are complete."""
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
    """Return the index of the log row of each of n instants, int32 (n,), or n for an instant that is not logged.

    written: mask (n,) of the logged instants.
    """
    return np.where(written, np.cumsum(written) - 1, len(written)).astype(np.int32)


class Column(NamedTuple):
    """Signal in the log rows or in the final values: path, shape, data type, and declaration of the field."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None = None


class Program(NamedTuple):
    """Compiled scenario.

    library: path of the library, which computes one run at a time.  shared_inputs: inputs of a run, float64.  words:
    indices, in these inputs, of seed and run number.  periods, duration, max_step: times that determine the instants of
    a run.  columns: signals in a log row.  final: signals in the final values.  metadata: metadata of a log, except
    seed, run and backend.  noise: random key words of the scenario. If the scenario has such words, the run number is
    added to each word, and the words are written to the inputs from the index of the run number on.
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
        """Run the scenario once and return the log, as `simulate` does. log_period: time between log rows (100 ns)."""
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
    """Return the instants of a run, the index of the log row of each instant, and the times of the logged instants."""
    table = timetable(periods, duration, max_step)
    written = table.t % log_period == 0
    return table, row_numbers(written), logged_instants(table, written)


def logged_instants(table: Timetable, written: Any) -> tuple[Any, Any]:
    """Return the times of the logged instants, in 100 ns and in s, as read-only arrays that several logs can share."""
    ticks = table.t[written]
    t = to_seconds(ticks)
    ticks.flags.writeable = t.flags.writeable = False
    return ticks, t


def check_seed(seed: Any, name: str = "seed") -> None:
    """Raise InputError if a value is not a valid seed or run number. name: name of the argument, for the message."""
    is_whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not (is_whole and 0 <= seed < 2**32):
        problem = f"must be a whole number in 0 … {2**32 - 1}, got {seed!r}"
        raise InputError(argument_name(name), problem, fix=argument(name, 0))


def check_log_period(log_period: int, duration: int) -> None:
    """Raise InputError if a log period is 0 or longer than the flight. A log period of 1 ms is valid for any flight."""
    if not 0 < log_period <= max(duration, ms(1)):
        problem = f"must be above 0 s and at most the flight's {format_time(duration)}, got {format_time(log_period)}"
        raise InputError(argument_name("log_period"), problem, fix=argument("log_period", "1 ms"))


def row_width(columns: list[Column]) -> int:
    """Return the number of values in a row with the given columns."""
    return sum(math.prod(c.shape) for c in columns)


def split_columns(rows: Any, columns: list[Column]) -> dict[str, Any]:
    """Return the values of each column in rows (..., width): path -> values, in the column's data type and shape.

    Values of type float64 are views of the rows.
    """
    return {
        path: rows[..., part].reshape((*rows.shape[:-1], *shape)).astype(dtype, copy=False)
        for path, (part, shape, dtype) in _column_places(columns).items()
    }


def _column_places(columns: list[Column]) -> dict[str, tuple[slice, tuple[int, ...], str]]:
    """Return path of a column -> slice of a row that contains the column, and shape and data type of the column."""
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
    """Return the log of one run. The array of a signal is created when the signal is first read.

    run: index of the run in the results.  instants: times of the log rows, see `logged_instants`.  metadata:
    JSON-compatible values, copied when they are read.
    """
    ticks, t = instants
    rows = results.log[run] if len(results.log) == 1 else results.log[run].copy()
    places = _column_places(columns)
    for path, (_, shape, _) in places.items():
        if len(shape) > 1:
            problem = f"must be a scalar or a vector at each instant, but has shape {shape}"
            raise InputError(f"log signal {path!r}", problem, fix=f"change the shape to () or ({math.prod(shape)},)")

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
    """Return the metadata by which a log describes the scenario.

    For a scenario built by name, the metadata include `choices`, from which a replay rebuilds the scenario.
    """
    mismatch = [m._asdict() for m in model_mismatches(scenario.autopilot, scenario.world.vehicle)]
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
