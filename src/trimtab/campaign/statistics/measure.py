"""Metrics of runs that were flown."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.statistics.metrics import Metric, Rows
from trimtab.campaign.workers.ready import Ready
from trimtab.core.errors import InputError
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.batch import Batch
from trimtab.run.program import Column


class Flights(NamedTuple):
    """Of some runs: ticks of the rows, signals (n, rows, …), last values of the truth (n, …), what the columns are."""

    ticks: Any
    log: Mapping[str, Any]
    final: Mapping[str, Any]
    columns: list[Column]


TOGETHER = 128
"""Runs whose rows are looked at in one go: a cache holds them, memory is slow."""


def rows_of(scenario: Scenario, batch: Flights | Batch, which: slice = slice(None)) -> Rows:
    """What metrics see of some runs."""
    angles = frozenset(c.path for c in batch.columns if c.declared is not None and c.declared.kind == "angle")
    log = {path: signal[which] for path, signal in batch.log.items()}
    return Rows(to_seconds(batch.ticks), log, tuple(scenario.targets), angles)


def measured(ready: Ready, batch: Flights | Batch) -> dict[str, Any]:
    """Metrics, success and lost of some runs, each (n,)."""
    n = len(next(iter(batch.final.values())))
    found: dict[str, Any] = {m.name: np.empty(n) for m in ready.metrics}
    for first in range(0, n, TOGETHER):
        some = slice(first, min(first + TOGETHER, n))
        rows = rows_of(ready.scenario, batch, some)
        with np.errstate(over="ignore", invalid="ignore"):  # a run that ran away is counted, not warned of
            for metric in ready.metrics:
                found[metric.name][some] = _column(metric, rows, some.stop - first)
    ends = np.stack([np.asarray(v, np.float64).reshape(n, -1).sum(axis=1) for v in batch.final.values()])
    lost = ~np.isfinite(ends).all(axis=0)
    success = ~lost
    for condition in ready.success:
        success &= condition.holds(found[condition.metric])
    return {**found, "success": success, "lost": lost}


def measured_log(ready: Ready, log: Log) -> dict[str, Any]:
    """The same of the log of one run."""
    columns = [Column(path, (), "float64", declared) for path, declared in log.declared.items()]
    one = {path: signal[None] for path, signal in log.signals.items()}
    final = {path: np.asarray(value)[None] for path, value in log.final.items()}
    return measured(ready, Flights(log.ticks, one, final, columns))


def _column(metric: Metric, rows: Rows, n: int) -> Any:
    column = np.asarray(metric.of(rows), np.float64)
    if column.shape != (n,):
        raise InputError(
            f"--metric {metric.name}", f"gave shape {column.shape}, wanted is {(n,)}", fix="one number a run"
        )
    return column
