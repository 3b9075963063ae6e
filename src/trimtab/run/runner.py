"""Execution of one or many runs with backend C or JAX. `simulate` and `simulate_batch` use this module."""

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from trimtab.compiler.native.build import BuildError
from trimtab.compiler.native.compiler import NoCompilerError, find_compiler, lane_count
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import replace
from trimtab.core.suggestions import closest
from trimtab.core.time import Timetable, format_time, timetable
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import WalkResult, walk
from trimtab.run.inputs import RunInputs, flat_inputs, own_rows
from trimtab.run.program import Column, RunResults, check_seed, fly_runs, row_numbers, row_width
from trimtab.run.walk_structure import WalkStructure, build_walk_library, final_columns, row_columns, walk_structure

MAX_INSTANTS = 200_000_000
BACKENDS = ("auto", "c", "jax")
LEAST_LANE_RUNS = 64
"""Minimum number of runs for which the program is compiled with vector instructions, which compute several runs at a
time."""
_reported_parts: set[str] = set()

T = TypeVar("T")


def prepare_run(
    scenario: Scenario, seeds: list[int], duration: int | None, log_period: int
) -> tuple[Scenario, Timetable, Any]:
    """Return the checked scenario, the instants of a run, and a mask of the logged instants.

    duration: duration of the run (100 ns), or None for the scenario's.  log_period: time between log rows (100 ns).
    """
    if duration is not None:
        scenario = replace(scenario, duration=duration)
    scenario.check()
    length = scenario.duration
    if 0 < length < min(scenario.world.periods()) and length < scenario.autopilot.period:
        problem = f"{length} units of 100 ns are {format_time(length)}, which is less than any period of the loop"
        raise InputError("duration", problem, fix=f'duration="{length} s", or duration=seconds({length})')
    for seed in seeds:
        check_seed(seed)
    if log_period < 1:
        problem = f"must be above 0 s, got {format_time(log_period)}"
        raise InputError(argument_name("log_period"), problem, fix=argument("log_period", "1 ms"))
    periods = [*scenario.world.periods(), scenario.autopilot.period]
    count = sum(scenario.duration // p for p in set(periods))
    if count > MAX_INSTANTS:
        problem = f"{format_time(scenario.duration)} takes about {count:.1e} instants, more than {MAX_INSTANTS:.0e}"
        raise InputError("duration", problem, fix="choose a shorter duration, or longer periods")
    table = timetable(periods, scenario.duration, scenario.world.max_step)
    return scenario, table, table.t % log_period == 0


def choose_c(backend: str, prepare: Callable[[], T]) -> T | None:
    """Return the result of `prepare`, which compiles the program, if the backend is C, or None if the backend is JAX.

    backend: "c", "jax", or "auto" for C if available, else JAX. JAX is about ten times slower. If "auto" selects JAX, a
    note is printed once.
    """
    if backend not in BACKENDS:
        raise InputError("backend", f"{backend!r} is not a valid backend", choices=BACKENDS, fix='backend="auto"')
    if backend == "jax":
        return None
    try:
        return prepare()
    except InputError as error:
        if backend == "c" or not (isinstance(error, NoCompilerError | BuildError) or error.part == "export"):
            raise
        _report_once(f"running on JAX, which is about ten times slower than C: {error}", error.part)
        return None


def _report_once(note: str, part: str) -> None:
    if part not in _reported_parts:
        _reported_parts.add(part)
        print(f"note: {note}", file=sys.stderr)


def check_signals(of: WalkStructure) -> None:
    """Raise InputError if a signal that the user requested does not exist in the loop."""
    paths = [column.path for column in row_columns(of._replace(signals=()))]
    for name in of.signals:
        if not any(path == name or path.startswith(name + ".") for path in paths):
            near = closest(name, paths, 6) or sorted({p.split(".")[0] for p in paths})
            raise InputError("signals", f"there is no signal {name!r}", choices=near, fix=f"signals=({near[0]!r},)")


class RunJob(NamedTuple):
    """Description of the runs to execute.

    inputs: inputs of a run.  own: position of each input that differs from run to run -> values, with the run as first
    axis. It is empty for a single run.  table: instants of a run.  written: mask of the logged instants.  signals:
    paths of the signals to log or to reduce to statistics. Empty: all signals.  log: True to keep the log rows.  stats:
    True to compute statistics of the log rows.  threads: number of threads.  progress: function called a few times a
    second with the number of completed runs.
    """

    inputs: RunInputs
    own: dict[int, Any]
    table: Timetable
    written: Any
    signals: tuple[str, ...]
    log: bool = True
    stats: bool = False
    threads: int = 1
    progress: Callable[[int], None] | None = None

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return len(next(iter(self.own.values()))) if self.own else 1


class FlownRuns(NamedTuple):
    """Results of runs, and the columns of these results.

    backend: backend that was used: "c", "c lanes" (C with vector instructions, several runs at a time) or "jax".
    """

    results: RunResults
    columns: list[Column]
    final: list[Column]
    backend: str


def fly(job: RunJob, backend: str) -> FlownRuns:
    """Execute the runs of a job and return the results. backend: "auto", "c" or "jax", see `choose_c`."""
    of = walk_structure(job.inputs, job.table.always, job.signals)
    check_signals(of)
    columns, final = row_columns(of), final_columns(of)
    library = choose_c(backend, lambda: _build_library(of, job))
    if library is None:
        return FlownRuns(_fly_jax(job), columns, final, "jax")
    path, lanes = library
    results = fly_runs(
        path,
        flat_inputs(job.inputs, frozenset(job.own)),
        own_rows(job.own, job.runs),
        job.table,
        row_numbers(job.written),
        (row_width(columns), row_width(final)),
        log=job.log,
        stats=job.stats,
        threads=job.threads,
        progress=job.progress,
    )
    return FlownRuns(results, columns, final, "c lanes" if lanes else "c")


def _build_library(of: WalkStructure, job: RunJob) -> tuple[Path, int]:
    """Return the path of the compiled library, and the number of runs that it computes at a time (0: one run)."""
    own = frozenset(job.own)
    compiler = find_compiler("c++") if job.runs >= LEAST_LANE_RUNS else None
    lanes = lane_count(compiler) if compiler is not None else 1
    if lanes > 1:
        try:
            return build_walk_library(of, lanes, own), lanes
        except InputError as error:  # falls back to scalar code
            if error.part != "lanes":
                _report_once(f"computing runs one by one, not {lanes} at a time: {error}", error.part)
    return build_walk_library(of, 0, own), 0


def _fly_jax(job: RunJob) -> RunResults:
    """Execute the runs of a job on JAX. Several runs are computed together, by vmap over the inputs that differ."""
    rows = int(job.written.sum())
    row = np.minimum(row_numbers(job.written), rows).astype(np.int32)
    timing = (job.table.t, job.table.h, row)
    how = tuple(job.own), rows, job.table.always, job.signals
    walked = _walk_jax(job.inputs, list(job.own.values()), timing, *how)
    ends = jax.tree.leaves((walked.x, walked.integrated))
    log = np.asarray(walked.rows).reshape(job.runs, rows, -1)
    final = np.concatenate([np.asarray(v).reshape(job.runs, -1).astype(np.float64) for v in ends], axis=1)
    stats = np.stack([log.min(1), log.max(1), log.sum(1), (log**2).sum(1)], axis=-1) if job.stats else None
    return RunResults(log if job.log else None, stats, final)


@functools.partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _walk_jax(
    inputs: RunInputs,
    own: list[Any],
    timing: Any,
    at: tuple[int, ...],
    rows: int,
    always: frozenset[int],
    signals: tuple[str, ...],
) -> WalkResult:
    shared, tree = jax.tree.flatten(inputs)

    def one(values: list[Any]) -> WalkResult:
        leaves = list(shared)
        for i, value in zip(at, values, strict=True):
            leaves[i] = value
        run: RunInputs = jax.tree.unflatten(tree, leaves)
        return walk(run.world, run.autopilot, run.initial, run.key, timing, rows, always, signals)

    return jax.vmap(one)(own) if own else one(own)
