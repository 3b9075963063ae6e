"""Simulation of a scenario in virtual time, as one compiled loop over all instants of a run.

`simulate` executes a single run. `simulate_batch` executes many runs in parallel, with vector instructions and threads.
Signals are logged, or reduced to minimum, maximum, mean and RMS during the run.
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
"""Argument of `build` that users may pass to `simulate` by mistake -> correct call."""


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
        scenario: scenario, or name of a scenario (`scenarios.build`). It is checked completely before the run.
        seed: seed of the random numbers, 0 … 2**32 - 1.
        run: number of the run within a study. Seed and run number together determine every random number.
        duration: duration of the run, as text ("30 s") or integer (100 ns). None: the scenario's duration.
        log_period: time between two log rows, as text ("10 ms") or integer (100 ns). A row is written at each multiple
            of this time at which a part of the loop runs.
        signals: signals to log, e.g. ("truth", "law.mode"). A name includes all signals below it. Empty: all signals.
        backend: "c" to compile the loop with the machine's C compiler, "jax" to run it on JAX, "auto" for C if
            available, else JAX. Results agree up to rounding (docs page, Backends).

    Returns:
        The log. It contains the signals by path, the true state at the end, and all data needed to repeat the run.

    Raises:
        InputError: a value, period or name is invalid, or parts of the scenario don't fit each other.
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
    """Return the scenario, the duration and the log period. Names are replaced by scenarios, and texts by times."""
    length = None if duration is None else as_time("duration", duration)
    own, each = find_scenario(scenario), as_time("log_period", log_period)
    check_log_period(each, own.duration if length is None else length)
    return own, length, each


def compile_scenario(scenario: Scenario, *, duration: int | None = None, signals: tuple[str, ...] = ()) -> Program:
    """Return a scenario as a compiled program, which runs without JAX.

    Raise InputError for an invalid scenario or signal, or if no C compiler is found.
    """
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
    """Cached program, with structure, leaves and array contents of the scenario, to detect changes of the scenario."""

    program: Program
    tree: Any
    leaves: list[Any]
    contents: list[Any]


@functools.lru_cache(maxsize=8)
def _kept_programs(_: Scenario, __: int | None, ___: tuple[str, ...]) -> list[_KeptProgram]:
    """Return the cache entry of a scenario object. It is a list, to which the compiled program is added later."""
    return []


def _find_program(scenario: Scenario, duration: int | None, signals: tuple[str, ...]) -> Program:
    """Return the compiled program of a scenario, from the cache if no value in the scenario has changed."""
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
    """Run a scenario with many seeds and return the logs. Log i equals that of `simulate` with seed seeds[i]."""
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
    """Results of n runs. The dictionaries have signal paths as keys, and arrays with the run as first axis as values.

    seeds: seeds of the runs (n,).  ticks: times of the log rows, 100 ns.  log: logged signals (n, rows, …), or empty.
    least, most, mean, rms: minimum, maximum, mean and RMS of each signal over the log rows of a run, (n, …).  final:
    true state at the end, (n, …).  columns: signals in a log row.  backend: "c", "c lanes" (C with vector instructions)
    or "jax".  spread: path of a parameter that differs from run to run -> values (n, …).
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
    """Run a scenario with many seeds, and with parameters that may differ from run to run.

    >>> from trimtab import simulate_batch
    >>> simulate_batch("hovercraft/spin", seeds=range(4), duration="100 ms").final["truth.yaw_rate"].shape
    (4,)

    Args:
        scenario: scenario, or name of a scenario. It is checked completely before the runs.
        seeds: seed of each run.
        runs: number of each run within a study, which, together with the seed, selects the random numbers of the run.
            None: 0 for all runs. For a scenario with m random key words, an array (n, m) with the words of each run is
            also possible.
        spread: path of a parameter -> value in each run, shape (n, …), e.g. {"world.vehicle.mass": masses}.
        signals: signals whose statistics are computed, and which are logged if `log` is True. Empty: all signals.
        log_period: time between two log rows. A row is taken at each multiple of this time at which a part of the loop
            runs.
        log: True to keep the log rows of every run. The memory is proportional to runs x rows.
        duration: duration of a run, as text ("30 s") or integer (100 ns). None: the scenario's duration.
        backend: "auto", "c" or "jax", as in `simulate`.
        threads: number of threads. None: the number of cores.
        progress: function called a few times a second with the number of completed runs (only with backend C).

    Returns:
        Minimum, maximum, mean and RMS of each signal, the true state at the end, and the log rows if `log` is True.

    Raises:
        InputError: as for `simulate`. Also if `spread` contains an unknown path or values of a wrong shape.
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
