"""simulate: flies a scenario in virtual time, as one compiled walk over its instants.

It flies one run, or many at once over lanes and threads. Signals are logged, or reduced during the run.
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.core.explain_call import explain_call
from trimtab.core.time import as_time, ms, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import has_stepped_vehicle
from trimtab.run.cosimulation import cosimulate
from trimtab.run.inputs import flat_inputs, input_position, own_inputs, run_inputs
from trimtab.run.program import (
    Column,
    Program,
    check_log_period,
    check_seed,
    describe_scenario,
    logged_instants,
    make_log,
    split_columns,
    thread_count,
)
from trimtab.run.runner import FlownRuns, RunJob, check_signals, choose_c, fly, prepare_run
from trimtab.run.walk_structure import build_walk_library, final_columns, row_columns, walk_structure
from trimtab.scenarios.build import find_scenario

BUILT = {name: f'simulate(build("SCENARIO", {name}=…))' for name in ("settings", "without", "faults", "calibration")}
"""Arguments that `build` takes -> the call with them."""


@explain_call(BUILT)
def simulate(
    scenario: Scenario | str,
    *,
    seed: int = 0,
    run: int = 0,
    duration: int | str | None = None,
    log_period: int | str = ms(1),
    signals: tuple[str, ...] = (),
    backend: str = "auto",
) -> Log:
    """Run a scenario in virtual time and return its log.

    >>> from trimtab import simulate
    >>> len(simulate("hovercraft/spin", seed=7, duration="100 ms"))
    100

    Args:
        scenario: the scenario, or its name (`scenarios.build`); checked completely before the run.
        seed: seed of the random numbers, 0 … 2**32 - 1.
        run: number of the run within a study; (seed, run) decides every random number.
        duration: "30 s", or integer time (100 ns units); the scenario's own when None.
        log_period: time between rows of the log, likewise; multiples of it at which some block is due are logged.
        signals: signals to log, e.g. ("truth", "law.mode"): a name includes all signals below it; all when empty.
        backend: "c" compiles the loop with the machine's C compiler, "jax" flies it on JAX; "auto" uses C if available.
        Results agree to rounding (docs page, Backends).

    Returns:
        The log: every signal by its path, the true state at the end, and all data needed to repeat the run.

    Raises:
        InputError: an invalid value, period, name or pair of parts, with the fix.
    """
    check_seed(seed)
    check_seed(run, "run")
    own, length, each = _resolve(scenario, duration, log_period)
    if has_stepped_vehicle(own):
        return cosimulate(own, seed=seed, run=run, duration=length, log_period=each)
    program = choose_c(backend, lambda: _find_program(own, length, signals))
    if program is not None:
        return program.fly(seed, run, each)
    own, table, written = prepare_run(own, [seed, run], length, each)
    flown = fly(RunJob(run_inputs(own, seed, run), {}, table, written, signals), "jax")
    metadata = describe_scenario(own)
    metadata |= {"seed": seed, "run": run, "log_period_s": to_seconds(each), "backend": flown.backend}
    return make_log(flown.columns, flown.final, flown.results, 0, logged_instants(table, written), metadata)


def _resolve(
    scenario: Scenario | str, duration: int | str | None, log_period: int | str
) -> tuple[Scenario, int | None, int]:
    """Return the scenario of a name, and the times of texts."""
    length = None if duration is None else as_time("duration", duration)
    own, each = find_scenario(scenario), as_time("log_period", log_period)
    check_log_period(each, own.duration if length is None else length)
    return own, length, each


def compile_scenario(scenario: Scenario, *, duration: int | None = None, signals: tuple[str, ...] = ()) -> Program:
    """Return a scenario as a compiled program, which flies without JAX. Raise as `simulate`, or without a compiler."""
    scenario, table, _ = prepare_run(scenario, [], duration, ms(1))
    inputs = run_inputs(scenario)
    of = walk_structure(inputs, table.always, signals)
    check_signals(of)
    return Program(
        library=build_walk_library(of),
        shared_inputs=flat_inputs(inputs),
        words=(input_position(inputs, "key.seed"), input_position(inputs, "key.run")),
        periods=(*scenario.world.periods(), scenario.autopilot.period),
        duration=scenario.duration,
        max_step=scenario.world.max_step,
        columns=row_columns(of),
        final=final_columns(of),
        metadata=describe_scenario(scenario),
        noise=tuple(scenario.words),
    )


class _KeptProgram(NamedTuple):
    """A program with its inputs: structure and leaves of the scenario, and the contents of its arrays."""

    program: Program
    tree: Any
    leaves: list[Any]
    contents: list[Any]


@functools.lru_cache(maxsize=8)
def _kept_programs(_: Scenario, __: int | None, ___: tuple[str, ...]) -> list[_KeptProgram]:
    """Return the cache of the program for this very scenario object; empty until compiled."""
    return []


def _find_program(scenario: Scenario, duration: int | None, signals: tuple[str, ...]) -> Program:
    """Return the scenario's program, compiled if not cached, or if a mapping or array in it has changed since."""
    kept = _kept_programs(scenario, duration, signals)
    leaves, tree = jax.tree.flatten(scenario)
    contents = [v.tobytes() for v in leaves if isinstance(v, np.ndarray)]
    if kept:
        old = kept[0]
        same = len(leaves) == len(old.leaves) and all(a is b for a, b in zip(leaves, old.leaves, strict=True))
        if same and tree == old.tree and contents == old.contents:
            return old.program
    program = compile_scenario(scenario, duration=duration, signals=signals)
    kept[:] = [_KeptProgram(program, tree, leaves, contents)]
    return program


def simulate_many(
    scenario: Scenario | str,
    *,
    seeds: Iterable[int],
    duration: int | str | None = None,
    log_period: int | str = ms(10),
    signals: tuple[str, ...] = (),
    backend: str = "auto",
    threads: int | None = None,
) -> list[Log]:
    """Run `simulate` for many seeds at once, one log each; log i equals that of the single run of seeds[i]."""
    chosen = list(seeds)
    own, length, each = _resolve(scenario, duration, log_period)
    own, table, written = prepare_run(own, chosen, length, each)
    if not chosen:
        return []
    inputs = run_inputs(own)
    job = RunJob(inputs, own_inputs(inputs, chosen), table, written, signals, threads=thread_count(threads))
    flown = fly(job, backend)
    shared = describe_scenario(own) | {"run": 0, "log_period_s": to_seconds(each), "backend": flown.backend}
    instants = logged_instants(table, written)
    return [
        make_log(flown.columns, flown.final, flown.results, i, instants, shared | {"seed": seed})
        for i, seed in enumerate(chosen)
    ]


class Batch(NamedTuple):
    """Results of many runs; dictionaries by path, arrays with the run as first axis.

    seeds: (n,).  ticks: instants of the rows, 100 ns.  log: signals (n, rows, …), or empty.
    least, most, mean, rms: of the logged rows of each run, (n, …).  final: last values of the truth, (n, …).
    backend: "c", "c lanes" or "jax".  spread: the parameters that differ between runs, (n, …).
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
    spread: Mapping[str, Any] = {}


@explain_call()
def simulate_batch(
    scenario: Scenario | str,
    *,
    seeds: Iterable[int],
    runs: Iterable[Any] | None = None,
    spread: Mapping[str, Any] | None = None,
    signals: tuple[str, ...] = (),
    log_period: int | str = ms(10),
    log: bool = False,
    duration: int | str | None = None,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Batch:
    """Fly a scenario with many seeds, and with parameters that differ from run to run.

    >>> from trimtab import simulate_batch
    >>> simulate_batch("hovercraft/spin", seeds=range(4), duration="100 ms").final["truth.yaw_rate"].shape
    (4,)

    Args:
        scenario: the scenario, or its name; checked completely before the runs.
        seeds: a seed for each run.
        runs: number of each run within a study, the second word of its key; 0 when None. For a scenario with words
        also the words of each run, (n, m).
        spread: path of a parameter -> its value in each run, shape (n, …), e.g. {"world.vehicle.mass": masses}.
        signals: signals to reduce, and to log with `log`; all when empty.
        log_period: time between rows; multiples of it at which some block is due.
        log: keep the rows of every run; memory grows with runs x rows.
        duration: "30 s", or integer time; the scenario's own when None.
        backend: "auto", "c" or "jax", as in `simulate`.
        threads: number of threads; the number of cores when None.
        progress: called a few times a second with the number of runs that are done; in C only.

    Returns:
        Least, most, mean and rms of the rows, last values, and the log if wanted.

    Raises:
        InputError: as `simulate`; or for a spread of an unknown path or of another shape.
    """
    chosen = list(seeds)
    flying, length, each = _resolve(scenario, duration, log_period)
    flying, table, written = prepare_run(flying, chosen, length, each)
    inputs = run_inputs(flying)
    own, threads = own_inputs(inputs, chosen, runs, spread), thread_count(threads)
    job = RunJob(inputs, own, table, written, signals, log=log, stats=True, threads=threads, progress=progress)
    return _make_batch(chosen, table.t[written], fly(job, backend))._replace(spread=spread or {})


def _make_batch(seeds: list[int], ticks: Any, flown: FlownRuns) -> Batch:
    log, stats, final = flown.results
    real = [c._replace(dtype="float64") for c in flown.columns]
    count = max(len(ticks), 1)
    return Batch(
        seeds=np.asarray(seeds),
        ticks=ticks,
        log=split_columns(log, flown.columns) if log is not None else {},
        least=split_columns(stats[..., 0], flown.columns),
        most=split_columns(stats[..., 1], flown.columns),
        mean=split_columns(stats[..., 2] / count, real),
        rms=split_columns(np.sqrt(stats[..., 3] / count), real),
        final={p: v for p, v in split_columns(final, flown.final).items() if p.startswith("truth.")},
        columns=flown.columns,
        backend=flown.backend,
    )
