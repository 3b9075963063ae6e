"""Runs flown together, those of a campaign or at points that a search asks for, and what the metrics say of them.

Metrics of runs that were flown.

Who flies the blocks of a campaign: this process (`here`) or others (`cluster`).
"""

import itertools
from collections.abc import Callable, Generator, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.sampling.spread import spread_arrays, spread_values
from trimtab.campaign.statistics.metrics import Metric, Rows
from trimtab.campaign.workers.prepare import PreparedCampaign, draw_runs, program_options, scenario_variant
from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.native.compiler import NoCompilerError, search_compiler
from trimtab.run.inputs import run_inputs
from trimtab.run.program import Column
from trimtab.run.runner import choose_c, prepare_run
from trimtab.run.simulate import Batch, simulate_batch
from trimtab.run.walk_program import WalkProgram, lower_structure, walk_structure

Blocks = list[tuple[int, int]]
BlockResults = Generator[tuple[int, dict[str, Any]], None, None]
Workers = Callable[[PreparedCampaign, Blocks, str], BlockResults]
"""Flies blocks, each (first, last + 1), on the backend "c" or "jax": first run and columns of each, in any order."""


class WorkersLost(Exception):
    """Those who fly are gone; the campaign says how many runs are kept. part, fix: as of an InputError."""

    def __init__(self, part: str, problem: str, fix: str) -> None:
        super().__init__(problem)
        self.part, self.fix = part, fix


class LoggedRuns(NamedTuple):
    """Of some runs: ticks of the rows, signals (n, rows, …), last values of the truth (n, …), what the columns are."""

    ticks: Any
    log: Mapping[str, Any]
    final: Mapping[str, Any]
    columns: list[Column]


TOGETHER = 128
"""Runs whose rows are looked at in one go: a cache holds them, memory is slow."""


def batch_rows(scenario: Scenario, batch: LoggedRuns | Batch, which: slice = slice(None)) -> Rows:
    """What metrics see of some runs."""
    angles = frozenset(c.path for c in batch.columns if c.declaration is not None and c.declaration.kind == "angle")
    log = {path: signal[which] for path, signal in batch.log.items()}
    return Rows(to_seconds(batch.ticks), log, tuple(scenario.targets), angles)


def compute_metrics(ready: PreparedCampaign, batch: LoggedRuns | Batch) -> dict[str, Any]:
    """Metrics, success and lost of some runs, each (n,)."""
    n = len(next(iter(batch.final.values())))
    found: dict[str, Any] = {m.name: np.empty(n) for m in ready.metrics}
    for first in range(0, n, TOGETHER):
        some = slice(first, min(first + TOGETHER, n))
        rows = batch_rows(ready.scenario, batch, some)
        with np.errstate(over="ignore", invalid="ignore"):  # a run that ran away is counted, not warned of
            for metric in ready.metrics:
                found[metric.name][some] = _metric_column(metric, rows, some.stop - first)
    ends = np.stack([np.asarray(v, np.float64).reshape(n, -1).sum(axis=1) for v in batch.final.values()])
    lost = ~np.isfinite(ends).all(axis=0)
    success = ~lost
    for condition in ready.success:
        success &= condition.holds(found[condition.metric])
    return {**found, "success": success, "lost": lost}


def compute_log_metrics(ready: PreparedCampaign, log: Log) -> dict[str, Any]:
    """The same of the log of one run."""
    columns = [Column(path, (), "float64", declared) for path, declared in log.declarations.items()]
    one = {path: signal[None] for path, signal in log.signals.items()}
    final = {path: np.asarray(value)[None] for path, value in log.final.items()}
    return compute_metrics(ready, LoggedRuns(log.ticks, one, final, columns))


def _metric_column(metric: Metric, rows: Rows, n: int) -> Any:
    column = np.asarray(metric.of(rows), np.float64)
    if column.shape != (n,):
        raise InputError(
            f"--metric {metric.name}", f"gave shape {column.shape}, wanted is {(n,)}", fix="one number a run"
        )
    return column


def fly_block(
    ready: PreparedCampaign,
    first: int,
    last: int,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Rows first … last - 1: by name what differs, then each metric, `success` and `lost`, each (n,)."""
    of, values = draw_runs(ready, first, last)
    flags = {"backend": backend, "threads": threads, "progress": progress}
    return {**values, **_fly_values(ready, values, of.words, flags)}


def fly_points(
    ready: PreparedCampaign,
    u: Any,
    words: Any,
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Metrics, `success` and `lost` at points u (n, d) of the spread, with the random numbers that words (n,) name.

    progress: is given how many more were flown, from time to time.
    """
    found: list[dict[str, Any]] = []
    for first in range(0, len(words), max(ready.block, 1)):
        part = slice(first, first + max(ready.block, 1))
        values = spread_values(ready.spread, ready.scenario, u[part])
        found.append(_fly_values(ready, values, words[part], {"backend": backend, "threads": threads}))
        if progress is not None:
            progress(len(words[part]))
    return {name: np.concatenate([f[name] for f in found]) for name in found[0]}


def _fly_values(
    ready: PreparedCampaign, values: Mapping[str, Any], words: Any, flags: dict[str, Any]
) -> dict[str, Any]:
    """What metrics say of runs with these values, by what was written, each (n,)."""
    arrays = spread_arrays(ready.spread, ready.scenario, values)
    kept: dict[str, Any] = {m.name: np.empty(len(words)) for m in ready.metrics}
    kept |= {"success": np.empty(len(words), bool), "lost": np.empty(len(words), bool)}
    for picks, chosen in _group_by_program(values, list(program_options(ready)), len(words)):
        batch = simulate_batch(
            scenario_variant(ready, picks),
            seeds=[ready.plan.seed] * len(chosen),
            runs=words[chosen],
            spread={path: array[chosen] for path, array in arrays.items()},
            signals=ready.logged_signals,
            log_period=ready.plan.log_period,
            log=True,
            **flags,
        )
        for name, column in compute_metrics(ready, batch).items():
            kept[name][chosen] = column
    return kept


def uses_c(ready: PreparedCampaign, backend: str) -> bool:
    """Whether C flies the runs: where it is asked for, or a compiler is here and the loop can be written in C."""

    def lower() -> WalkProgram:
        found = search_compiler("c")
        if found.compiler is None:
            raise NoCompilerError("compiler", found.problem, fix=found.fix)
        _, table, _ = prepare_run(ready.scenario, [], None, ready.plan.log_period)
        return lower_structure(walk_structure(run_inputs(ready.scenario), table.always, ready.logged_signals))

    return choose_c(backend, lower) is not None


def _group_by_program(values: Mapping[str, Any], options: list[str], n: int) -> list[tuple[dict[str, int], Any]]:
    """Runs of one program: what was picked for each option, and their places in the block."""
    if not options:
        return [({}, np.arange(n))]
    found = []
    for picks in itertools.product(*(np.unique(values[o]) for o in options)):
        inside = np.all([values[o] == p for o, p in zip(options, picks, strict=True)], axis=0)
        if inside.any():
            found.append(({o: int(p) for o, p in zip(options, picks, strict=True)}, np.flatnonzero(inside)))
    return found
