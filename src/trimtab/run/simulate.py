"""simulate: a scenario in virtual time, one compiled walk over its instants."""

import functools
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np

from trimtab.core.record import Quantity, leaves
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import Signals, WalkResult, logged_signals, walk
from trimtab.run import compiled
from trimtab.run.batch import simulate_batch
from trimtab.run.prepare import check_signals, choose_c, prepare_run, run_inputs
from trimtab.run.program import Program, describe_scenario


def simulate(
    scenario: Scenario,
    *,
    seed: int = 0,
    run: int = 0,
    duration: int | None = None,
    log_period: int = ms(1),
    signals: tuple[str, ...] = (),
    backend: str = "auto",
) -> Log:
    """Run a scenario in virtual time and give its log.

    Args:
        scenario: what flies; checked whole before anything runs.
        seed: of the random numbers, 0 … 2**32 - 1.
        run: number of the run within a study; (seed, run) decides every random number.
        duration: integer time (100 ns units); the scenario's own when None.
        log_period: how often signals are logged; a multiple of it is logged where some block is due.
        signals: which signals are logged, e.g. ("truth", "law.mode"): a name takes all below it; all when empty.
        backend: "c" compiles the loop with the machine's C compiler, "jax" flies it on JAX; "auto" takes C where it
            can be had. Results agree to rounding (docs page, Backends).

    Returns:
        The log: every signal by its path, the true state at the end, and what is needed to run it again.

    Raises:
        InputError: a value, a period, a name or a pair of parts that can't be flown, with the fix.
    """
    scenario, table, written = prepare_run(scenario, [seed, run], duration, log_period)
    whole = run_inputs(scenario, seed, run)
    made: list[Program] = []
    if choose_c(backend, lambda: made.append(_compile_program(scenario, whole, table.always, signals))):
        return made[0].fly(seed, run, log_period)
    rows = int(written.sum())
    index = np.where(written, np.cumsum(written) - 1, rows).astype(np.int32)
    walked = _walk_jax(whole, (table.t, table.h, index), rows, table.always, signals)
    check_signals(walked.template, signals)
    about = {"seed": seed, "run": run, "log_period_s": to_seconds(log_period)}
    return _make_walk_log(describe_scenario(scenario) | about, walked, table.t[written], signals)


def compile_scenario(scenario: Scenario, *, duration: int | None = None, signals: tuple[str, ...] = ()) -> Program:
    """A scenario as a compiled program, which flies without JAX; refused as `simulate` refuses, or with no compiler."""
    scenario, table, _ = prepare_run(scenario, [], duration, ms(1))
    return _compile_program(scenario, run_inputs(scenario, 0, 0), table.always, signals)


def simulate_many(
    scenario: Scenario,
    *,
    seeds: Iterable[int],
    duration: int | None = None,
    log_period: int = ms(10),
    signals: tuple[str, ...] = (),
    backend: str = "auto",
    threads: int | None = None,
) -> list[Log]:
    """`simulate` for many seeds at once, one log each; row i is equal to the single run of seeds[i]."""
    chosen = list(seeds)
    scenario, _, _ = prepare_run(scenario, chosen, duration, log_period)
    if not chosen:
        return []
    batch = simulate_batch(
        scenario,
        seeds=chosen,
        signals=signals,
        log_period=log_period,
        log=True,
        backend=backend,
        threads=threads,
    )
    shared = describe_scenario(scenario) | {"run": 0, "log_period_s": to_seconds(log_period), "backend": batch.backend}
    declared = {c.path: c.declaration for c in batch.columns if c.declaration is not None}
    return [
        Log(
            t=to_seconds(batch.ticks),
            ticks=batch.ticks,
            signals={path: values[i] for path, values in batch.log.items()},
            declarations=declared,
            metadata=shared | {"seed": seed},
            final={path: values[i] for path, values in batch.final.items()},
        )
        for i, seed in enumerate(chosen)
    ]


def _compile_program(scenario: Scenario, whole: Any, always: frozenset[int], signals: tuple[str, ...]) -> Program:
    check_signals(compiled.lower_structure(compiled.program_structure(whole, always, signals)).signals, signals)
    return compiled.compile_program(scenario, whole, always, signals)


@functools.partial(jax.jit, static_argnums=(2, 3, 4))
def _walk_jax(fly: Any, instants: Any, rows: int, always: frozenset[int], signals: tuple[str, ...]) -> WalkResult:
    world, autopilot, x, key = fly
    return walk(world, autopilot, x, key, instants, rows, always, signals)


def _make_walk_log(metadata: dict[str, Any], walked: WalkResult, ticks: Any, wanted: tuple[str, ...]) -> Log:
    signals, declared = _unpack_rows(np.asarray(walked.rows), walked.template, wanted)
    final = {f"truth.{p}": np.asarray(v)[()] for p, v, _ in leaves(walked.x)}
    about = metadata | {"backend": "jax"}
    return Log(t=to_seconds(ticks), ticks=ticks, signals=signals, declarations=declared, metadata=about, final=final)


def _unpack_rows(rows: Any, seen: Signals, wanted: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Quantity]]:
    """Columns of the log by path, each in its own type, and what they mean."""
    signals: dict[str, Any] = {}
    declared: dict[str, Quantity] = {}
    start = 0
    for path, value, meaning in logged_signals(seen, wanted):
        shape, dtype = np.shape(value), np.asarray(value).dtype
        stop = start + int(np.prod(shape))
        signals[path] = rows[:, start:stop].reshape(len(rows), *shape).astype(dtype)
        declared[path] = meaning
        start = stop
    return signals, declared
