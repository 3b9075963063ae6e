"""Many runs of one scenario at once: compiled over lanes and threads; signals logged, or reduced while they fly."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.time import ms
from trimtab.loop.scenario import Scenario
from trimtab.run.inputs import own_inputs, run_inputs
from trimtab.run.program import Column, split_columns, thread_count
from trimtab.run.runner import FlownRuns, RunJob, fly, prepare_run


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
    inputs = run_inputs(scenario)
    own, threads = own_inputs(inputs, chosen, runs, spread), thread_count(threads)
    job = RunJob(inputs, own, table, written, signals, log=log, stats=True, threads=threads, progress=progress)
    return _make_batch(chosen, table.t[written], fly(job, backend))


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
