"""A sensor's own samples out of a log: each once, at the time it was measured, however often the log has rows.

A log's rows hold the last sample until there is a new one. Which is which, the sample's own time says.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.time import UNITS_PER_SECOND, format_time, to_seconds
from trimtab.logs.log import Log


class Samples(NamedTuple):
    """Evenly spaced samples.

    values: (n,) or (n, k).  ticks: int64 (n,), when each was measured.  period: s, from one to the next.
    """

    values: Any
    ticks: Any
    period: float


def samples(log: Log, path: str) -> Samples:
    """The samples of a signal, each once; refused where some are missing from the log, or come at uneven times.

    Args:
        log: of a run or of a sensor.
        path: a signal of a sample, e.g. ``sensors.imu.value.angular_rate``; of other signals the rows are the samples.
    """
    values, ticks = log[path], log.ticks
    sample = sample_path(log, path)
    if sample is not None:
        valid = log[f"{sample}.valid"].astype(bool) if f"{sample}.valid" in log else np.ones(len(log), bool)
        values, ticks = values[valid], log[f"{sample}.t"][valid].astype(np.int64)
        first = np.diff(ticks, prepend=-1) != 0
        values, ticks = values[first], ticks[first]
    if len(ticks) < 3:
        raise InputError(f"signal {path!r}", f"has {len(ticks)} samples in this log", fix="log it for longer")
    gaps = np.diff(ticks)
    usual = _usual_gap(log, sample, gaps)
    loose = 0.01 if sample else 0.5  # a sensor keeps its period; rows of other loggers come when they can
    uneven = np.flatnonzero(np.abs(gaps - usual) > loose * usual)
    if len(uneven):
        _refuse_gaps(log, path, ticks, uneven, usual, sampled=sample is not None)
    return Samples(values, ticks, float(to_seconds((ticks[-1] - ticks[0]) / (len(ticks) - 1))))


def _usual_gap(log: Log, sample: str | None, gaps: Any) -> float:
    """The time between samples (ticks): as the run's settings have it, or the usual one."""
    settings = log.metadata.get("parameters", {})
    period = settings.get(f"world.{sample}.period") if isinstance(settings, dict) else None
    return float(period or np.median(gaps))


def sample_path(log: Log, path: str) -> str | None:
    """The path of the sample that a signal belongs to, e.g. ``sensors.imu``; None where it belongs to none."""
    before, value, _ = path.partition(".value.")
    return before if value and f"{before}.t" in log else None


def _refuse_gaps(log: Log, path: str, ticks: Any, uneven: Any, usual: float, *, sampled: bool) -> None:
    at, gap = ticks[uneven[0]], np.diff(ticks)[uneven[0]]
    problem = f"its samples are not evenly spaced: usually {format_time(round(usual))}, but {format_time(int(gap))} at"
    problem += f" {at / UNITS_PER_SECOND:.4f} s, and {len(uneven) - 1} such gaps more"
    fix = "cut the log to a stretch without gaps, or log again"
    rows = float(np.median(np.diff(log.ticks)))
    if sampled and rows > min(usual, np.diff(ticks).min()):
        problem += f"; the rows of the log come each {format_time(round(rows))}, so it misses samples"
        fix = "log rows more often than there are samples, e.g. simulate(…, log_period=ms(1))"
    raise InputError(f"signal {path!r}", problem, fix=fix)
