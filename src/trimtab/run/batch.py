"""Many runs of one scenario at once: compiled over lanes and threads; signals logged, or reduced while they fly."""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.time import Timetable, ms
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import WalkResult, walk
from trimtab.native.compiler import find_compiler, lane_count
from trimtab.run import compiled
from trimtab.run.library import RunResults, fly_runs, row_numbers, thread_count
from trimtab.run.prepare import check_signals, choose_c, prepare_run, run_inputs
from trimtab.run.program import Column, check_seed, row_width, split_columns

LEAST_LANE_RUNS = 64
"""From so many runs on it pays to compile the program over lanes as well."""


class Batch(NamedTuple):
    """What came of many runs; dictionaries by path, arrays with the run as first axis.

    seeds: (n,).  ticks: instants of the rows, 100 ns.  log: signals (n, rows, …), or empty.
    least, most, mean, rms: of the logged rows of each run, (n, …).  final: last values of the truth, (n, …).
    backend: "c", "c lanes" or "jax".
    """

    seeds: Any
    ticks: Any
    log: dict[str, Any]
    least: dict[str, Any]
    most: dict[str, Any]
    mean: dict[str, Any]
    rms: dict[str, Any]
    final: dict[str, Any]
    columns: list[Column]
    backend: str


def simulate_batch(
    scenario: Scenario,
    *,
    seeds: Iterable[int],
    runs: Iterable[int] | None = None,
    spread: Mapping[str, Any] | None = None,
    signals: tuple[str, ...] = (),
    log_period: int = ms(10),
    log: bool = False,
    duration: int | None = None,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Batch:
    """Fly a scenario with many seeds, and with parameters that differ from run to run.

    Args:
        scenario: what flies; checked whole before anything runs.
        seeds: one for each run.
        runs: number of each run within a study, the second word of its key; 0 when None.
        spread: path of a parameter -> its value in each run, shape (n, …), e.g. {"world.vehicle.mass": masses}.
        signals: which are reduced, and logged when `log`; all when empty.
        log_period: how often rows are taken; a multiple of it where some block is due.
        log: keep the rows of every run; memory grows with runs x rows.
        duration: integer time; the scenario's own when None.
        backend: "auto", "c" or "jax", as in `simulate`.
        threads: how many fly; as many as there are cores when None.
        progress: called a few times a second with the number of runs that are done; in C only.

    Returns:
        Rows reduced to least, most, mean and rms, last values, and the log when wanted.

    Raises:
        InputError: what `simulate` refuses; a spread of an unknown path or of another shape.
    """
    chosen = list(seeds)
    scenario, table, written = prepare_run(scenario, chosen, duration, log_period)
    whole = run_inputs(scenario, 0, 0)
    own = own_inputs(whole, chosen, None if runs is None else list(runs), dict(spread or {}))
    job = _BatchJob(whole, own, table, row_numbers(written), signals, log, thread_count(threads), progress)
    names = _fly_c(job) if choose_c(backend, lambda: _prepare_library(job)) else _fly_jax(job)
    flown, columns, last, used = names
    return _make_batch(chosen, table.t[written], flown, columns, last, used)


class _BatchJob(NamedTuple):
    fly: Any
    own: dict[int, Any]
    table: Timetable
    row: Any
    signals: tuple[str, ...]
    log: bool
    threads: int
    progress: Callable[[int], None] | None


def own_inputs(whole: Any, seeds: list[int], runs: list[int] | None, spread: dict[str, Any]) -> dict[int, Any]:
    """Position of each input that differs -> its values, the run as first axis."""
    known, found = compiled.input_paths(whole), jax.tree.leaves(whole)
    own: dict[int, Any] = {known.index("key.seed"): np.asarray(seeds, np.uint32)}
    if runs is not None:
        if len(runs) != len(seeds):
            fix = "give each run a seed and a number"
            raise InputError("simulate_batch", f"{len(runs)} numbers of runs for {len(seeds)} seeds", fix=fix)
        for run in runs:
            check_seed(int(run))
        own[known.index("key.run")] = np.asarray(runs, np.uint32)
    for path, values in spread.items():
        if path not in known or path.startswith("key."):
            near = closest(path, known, 6) or known[:6]
            raise InputError(f"spread {path!r}", "there is no such parameter", choices=near, fix=f"spread {near[0]!r}")
        at = known.index(path)
        array, wanted = np.asarray(values), (len(seeds), *np.shape(found[at]))
        if array.shape != wanted:
            problem = f"has shape {array.shape}, wanted is {wanted}: a value for each run"
            raise InputError(f"spread {path!r}", problem, fix=f"give {len(seeds)} values, one for each seed")
        if not np.isfinite(array).all():
            raise InputError(f"spread {path!r}", "not every value is finite", fix="leave NaN and infinity out")
        own[at] = array.astype(found[at].dtype)
    return dict(sorted(own.items()))


def _choose_lanes(job: _BatchJob) -> int:
    compiler = find_compiler("c++")
    runs = len(next(iter(job.own.values())))
    return lane_count(compiler) if compiler is not None and runs >= LEAST_LANE_RUNS else 1


def _prepare_library(job: _BatchJob) -> Any:
    """The library, scalar or over lanes, with the number of lanes."""
    of = compiled.program_structure(job.fly, job.table.always, job.signals)
    check_signals(compiled.lower_structure(of).signals, job.signals)
    n = _choose_lanes(job)
    if n > 1:
        try:
            return compiled.build_walk_library(of, n, frozenset(job.own)), n
        except InputError:
            pass  # numbers that lanes don't carry: scalar code flies them
    return compiled.build_walk_library(of, 0, frozenset(job.own)), 1


def _fly_c(job: _BatchJob) -> Any:
    of = compiled.program_structure(job.fly, job.table.always, job.signals)
    flight = compiled.lower_structure(of)
    path, n = _prepare_library(job)
    columns, last = compiled.row_columns(flight, job.signals), compiled.final_columns(flight)
    runs = len(next(iter(job.own.values())))
    own = np.concatenate([v.reshape(runs, -1).astype(np.float64) for v in job.own.values()], axis=1)
    shared = compiled.flat_inputs(job.fly, frozenset(job.own))
    widths = row_width(columns), row_width(last)
    wanted: dict[str, Any] = {"log": job.log, "stats": True, "threads": job.threads, "progress": job.progress}
    flown = fly_runs(path, shared, own, job.table, job.row, widths, **wanted)
    return flown, columns, last, "c lanes" if n > 1 else "c"


def _fly_jax(job: _BatchJob) -> Any:
    of = compiled.program_structure(job.fly, job.table.always, job.signals)
    flight = compiled.lower_structure(of)
    check_signals(flight.signals, job.signals)
    columns, last = compiled.row_columns(flight, job.signals), compiled.final_columns(flight)
    rows = int((job.row < len(job.row)).sum())
    index = np.minimum(job.row, rows).astype(np.int32)
    timing = (job.table.t, job.table.h, index)
    walked = _walk_batch(job.fly, list(job.own.values()), timing, tuple(job.own), rows, job.table.always, job.signals)
    log = np.asarray(walked.rows)
    stats = np.stack([log.min(1), log.max(1), log.sum(1), (log**2).sum(1)], axis=-1)
    runs = len(log)
    ends = [np.asarray(v).reshape(runs, -1).astype(np.float64) for v in jax.tree.leaves((walked.x, walked.sensors))]
    return RunResults(log if job.log else None, stats, np.concatenate(ends, axis=1)), columns, last, "jax"


@functools.partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _walk_batch(
    whole: Any, own: Any, timing: Any, at: tuple[int, ...], rows: int, always: frozenset[int], signals: tuple[str, ...]
) -> WalkResult:
    found, tree = jax.tree.flatten(whole)

    def one(values: Any) -> WalkResult:
        mine = list(found)
        for i, value in zip(at, values, strict=True):
            mine[i] = value
        world, autopilot, x, key = jax.tree.unflatten(tree, mine)
        return walk(world, autopilot, x, key, timing, rows, always, signals)

    return jax.vmap(one)(own)


def _make_batch(
    seeds: list[int], ticks: Any, flown: RunResults, columns: list[Column], last: list[Column], used: str
) -> Batch:
    real = [c._replace(dtype="float64") for c in columns]
    count = max(len(ticks), 1)
    reduced = [split_columns(v, real) for v in (flown.stats[..., 2] / count, np.sqrt(flown.stats[..., 3] / count))]
    final = {p: v for p, v in split_columns(flown.final, last).items() if p.startswith("truth.")}
    return Batch(
        seeds=np.asarray(seeds),
        ticks=ticks,
        log=split_columns(flown.log, columns) if flown.log is not None else {},
        least=split_columns(flown.stats[..., 0], columns),
        most=split_columns(flown.stats[..., 1], columns),
        mean=reduced[0],
        rms=reduced[1],
        final=final,
        columns=columns,
        backend=used,
    )
