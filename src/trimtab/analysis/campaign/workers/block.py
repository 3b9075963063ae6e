"""Simulation of many runs of a campaign or a search together, and computation of the metrics of these runs.

A function of type `Workers` flies the blocks of a campaign, in this process (module `local`) or on other machines
(module `cluster`).
"""

import dataclasses
import itertools
from collections.abc import Callable, Generator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.analysis.campaign.sampling.spread import spread_arrays, spread_values
from trimtab.analysis.campaign.statistics.metrics import Metric, Rows
from trimtab.analysis.campaign.store.memo import FlightMemo
from trimtab.analysis.campaign.workers.prepare import (
    PreparedCampaign,
    draw_runs,
    identity,
    program_options,
    scenario_variant,
)
from trimtab.compiler.native.compiler import NoCompilerError, search_compiler
from trimtab.compiler.walk_program import WalkProgram
from trimtab.core.errors import InputError, argument_name
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.spatial import FLIGHT_DECLARED, find_flight, with_flight
from trimtab.loop.scenario import Scenario
from trimtab.run.inputs import run_inputs
from trimtab.run.known_signals import scenario_place
from trimtab.run.runner import choose_c, prepare_run
from trimtab.run.simulate import Batch, simulate, simulate_batch
from trimtab.run.walk_structure import lower_structure, walk_structure

JUDGED_ROWS = 48_000
"""Number of log rows from which metrics are computed at a time, so that the rows fit into the processor's cache."""
Blocks = list[tuple[int, int]]
BlockResults = Generator[tuple[int, dict[str, Any]], None, None]
Workers = Callable[[PreparedCampaign, Blocks, str], BlockResults]
"""Function that flies blocks of runs, given as (first run, last run + 1), on the backend "c" or "jax".

The function yields the first run and the results of each block, in any order.
"""


class WorkersLost(Exception):
    """Error raised if all workers of a cluster are lost. The campaign turns it into an InputError."""

    def __init__(self, part: str, problem: str, fix: str) -> None:
        super().__init__(problem)
        self.part, self.fix = part, fix


def batch_rows(scenario: Scenario, batch: Batch) -> Rows:
    """Return the logged rows of a batch as `Rows`, from which metrics are computed."""
    declared = {c.path: c.declaration for c in batch.columns if c.declaration is not None}
    flight = find_flight({c.path: c.shape for c in batch.columns}, declared)
    own, n = scenario_place(scenario) if flight else {}, len(batch.seeds)
    return Rows(
        to_seconds(batch.ticks),
        batch.log,
        tuple(scenario.targets),
        frozenset(path for path, one in {**declared, **FLIGHT_DECLARED}.items() if one.kind == "angle"),
        batch.final,
        flight=flight,
        end_time=to_seconds(scenario.duration),
        parameters={p: np.asarray(batch.spread.get(p, np.repeat(v, n)), float) for p, v in own.items()},
    )


def compute_metrics(ready: PreparedCampaign, rows: Rows) -> dict[str, Any]:
    """Compute the results of n runs by name, each (n,): metrics, `success`, and `lost` (True if the run diverged).

    rows.final must contain the last values of all true states.
    """
    n = len(next(iter(rows.final.values())))
    metrics: dict[str, Any] = {m.name: np.empty(n) for m in ready.metrics}
    together = max(JUDGED_ROWS // max(len(rows.t), 1), 1)
    for first in range(0, n, together):
        part = slice(first, min(first + together, n))
        three = (rows.signals, rows.final, rows.parameters)
        signals, ends, own = ({path: v[part] for path, v in of.items()} for of in three)
        some = dataclasses.replace(rows, signals=signals, final=ends, parameters=own)
        with np.errstate(over="ignore", invalid="ignore"):  # a diverged run is counted, without a warning
            for metric in ready.metrics:
                metrics[metric.name][part] = _metric_column(metric, some, part.stop - first)
    last = np.stack([np.asarray(v, np.float64).reshape(n, -1).sum(axis=1) for v in rows.final.values()])
    lost = ~np.isfinite(last).all(axis=0)
    success = ~lost
    for condition in ready.success:
        success &= condition.holds(metrics[condition.metric])
    return {**metrics, "success": success, "lost": lost}


def compute_log_metrics(ready: PreparedCampaign, log: Log) -> dict[str, Any]:
    """Compute the metrics, `success` and `lost` from the log of one run, as `compute_metrics`."""
    log = with_flight(log)
    angles = frozenset(path for path, declared in log.declarations.items() if declared.kind == "angle")
    signals = {path: signal[None] for path, signal in log.signals.items()}
    final = {path: np.asarray(value)[None] for path, value in log.final.items()}
    return compute_metrics(ready, Rows(to_seconds(log.ticks), signals, tuple(ready.scenario.targets), angles, final))


def repeat_run(ready: PreparedCampaign, scenario: Scenario, backend: str, run: int = 0) -> dict[str, Any]:
    """Fly one run alone, and return its metrics, `success` and `lost` (True if the run diverged).

    run: number of the run, which selects the random numbers.
    """
    period, signals = ready.plan.log_period, ready.logged_signals
    log = simulate(scenario, seed=ready.plan.seed, run=run, log_period=period, signals=signals, backend=backend)
    return {name: column[0] for name, column in compute_log_metrics(ready, log).items()}


def open_memo(folder: Path | None, ready: PreparedCampaign, backend: str) -> FlightMemo:
    """Return the cache of a search's flights. folder: folder of the cache, or None to store nothing."""
    return FlightMemo(folder, identity(ready.plan, ready.scenario, backend), ready.plan.scenario)


def _metric_column(metric: Metric, rows: Rows, n: int) -> Any:
    column = np.asarray(metric.of(rows), np.float64)
    if column.shape != (n,):
        problem = f"returned shape {column.shape}, but must return {(n,)}"
        raise InputError(argument_name("metrics", metric.name), problem, fix="return one number for each run")
    return column


def fly_block(ready: PreparedCampaign, first: int, last: int, **options: Any) -> dict[str, Any]:
    """Fly runs first … last - 1. Return varied parameters, metrics, `success` and `lost` by name, each (n,).

    options: backend, threads and progress, as in `simulate_batch`.
    """
    drawn, values = draw_runs(ready, first, last)
    return {**values, **_fly_values(ready, values, drawn.words, options)}


def fly_points(
    ready: PreparedCampaign,
    u: Any,
    words: Any,
    *,
    progress: Callable[[int], None] | None = None,
    memo: FlightMemo | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Fly n runs with given parameters and random numbers. Return metrics, `success` and `lost` by name, each (n,).

    Args:
        ready: the prepared campaign or search.
        u: probabilities (n, d) at which the quantiles of the d varied parameters are taken.
        words: random key (n,) that selects the random numbers of each run.
        progress: function called with the number of runs flown since the last call.
        memo: cache of earlier flights.
        options: backend and threads, as in `simulate_batch`.
    """
    parts: list[dict[str, Any]] = []
    for first in range(0, len(words), max(ready.block, 1)):
        part = slice(first, first + max(ready.block, 1))
        fly = partial(_fly_levels, ready, u[part], words[part], options)
        parts.append(fly() if memo is None else memo.recall((u[part], words[part]), fly))
        if progress is not None:
            progress(len(words[part]))
    return {name: np.concatenate([columns[name] for columns in parts]) for name in parts[0]}


def _fly_levels(ready: PreparedCampaign, u: Any, words: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metrics of runs whose parameters are the quantiles at u (n, d)."""
    return _fly_values(ready, spread_values(ready.spread, ready.scenario, u), words, options)


def _fly_values(
    ready: PreparedCampaign, values: Mapping[str, Any], words: Any, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the metrics of runs with given values of the varied parameters, each (n,)."""
    arrays = spread_arrays(ready.spread, ready.scenario, values)
    columns: dict[str, Any] = {m.name: np.empty(len(words)) for m in ready.metrics}
    columns |= {"success": np.empty(len(words), bool), "lost": np.empty(len(words), bool)}
    for picks, chosen in _group_by_program(values, list(program_options(ready)), len(words)):
        batch = simulate_batch(
            scenario_variant(ready, picks),
            seeds=[ready.plan.seed] * len(chosen),
            runs=words[chosen],
            spread={path: array[chosen] for path, array in arrays.items()},
            signals=ready.logged_signals,
            log_period=ready.plan.log_period,
            log=True,
            **options,
        )
        for name, column in compute_metrics(ready, batch_rows(ready.scenario, batch)).items():
            columns[name][chosen] = column
    return columns


def uses_c(ready: PreparedCampaign, backend: str) -> bool:
    """Return True if the runs are simulated by compiled C code (backend "c").

    This is the case on request, or with "auto" if a C compiler is found and the loop can be written in C.
    """

    def lower() -> WalkProgram:
        search = search_compiler("c")
        if search.compiler is None:
            raise NoCompilerError("compiler", search.problem, fix=search.fix)
        _, table, _ = prepare_run(ready.scenario, [], None, ready.plan.log_period)
        return lower_structure(walk_structure(run_inputs(ready.scenario), table.always, ready.logged_signals))

    return choose_c(backend, lower) is not None


def _group_by_program(values: Mapping[str, Any], options: list[str], n: int) -> list[tuple[dict[str, int], Any]]:
    """Group the runs of a block by the values of the varied options. Each combination of values needs its own program.

    Return for each group the value of each option, and the indices of its runs in the block.
    """
    if not options:
        return [({}, np.arange(n))]
    groups = []
    for picks in itertools.product(*(np.unique(values[o]) for o in options)):
        inside = np.all([values[o] == p for o, p in zip(options, picks, strict=True)], axis=0)
        if inside.any():
            groups.append(({o: int(p) for o, p in zip(options, picks, strict=True)}, np.flatnonzero(inside)))
    return groups
