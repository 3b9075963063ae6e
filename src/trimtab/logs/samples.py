"""Samples of a sensor: reading from a log, and creation of a log from samples.

Each row of a log contains the last sample of each sensor, with its time of measurement. So the same sample is repeated
until a new sample arrives. A sample that is repeated is read only once. From a CSV file of another program, a log with
one signal for each column of numbers can be made.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.quantity import Quantity
from trimtab.core.time import UNITS_PER_SECOND, format_time, to_seconds
from trimtab.core.units import UNITS, find_size
from trimtab.logs.csv_table import CsvColumn, read_table, split_heading, time_unit
from trimtab.logs.log import Log

BLOCK = "csv"
"""First component of the paths of signals that were read from a CSV file, as in ``csv.gyro_z``."""
GAPS_MAX = 0.01
"""Largest ratio of gaps to samples for which the longest section without gaps is used. Above this ratio, an error is
raised."""
PERIOD_MIN = 2e-5
"""Shortest plausible sample period of a sensor (s). It serves to detect a wrong time unit."""
PERIOD_MAX = 2.0
"""Longest plausible sample period of a sensor (s). It serves to check the assumed unit if a log states no time unit."""
PERIOD_LIKELY = 0.5
"""Longest likely sample period of a sensor (s). It serves to suggest a time unit in an error message."""

RECEIVED, TRUTH = "downlink", "truth"
"""First components of log paths: of the samples received by the autopilot, and of the true state."""


class Samples(NamedTuple):
    """Evenly spaced samples of a signal.

    values: samples (n,) or (n, k).  ticks: times of measurement, int64 (n,), in 100 ns.  period: time between two
    samples (s).  left_out: text about samples that are left out because of gaps, or empty.
    """

    values: Any
    ticks: Any
    period: float
    left_out: str = ""


class SampleSeries(NamedTuple):
    """Samples of one sensor, or of the true state.

    ticks: times of measurement, int64 (n,), in 100 ns, increasing.  values: name of a field -> values (n,) or (n, k).
    declarations: name of a field -> unit and meaning.
    """

    ticks: Any
    values: Mapping[str, Any]
    declarations: Mapping[str, Quantity] = {}


def log_samples(
    sensors: Mapping[str, SampleSeries], truth: SampleSeries | None = None, metadata: Mapping[str, Any] | None = None
) -> Log:
    """Return a log made from samples that another system recorded, for a replay of an estimator.

    The log has a row at each time of measurement, as if each sample had arrived without delay. Each row contains the
    newest sample of each sensor. Sample times may start at any value: they are shifted so that the first row is at 0.

    Args:
        sensors: name of a sensor, as in the estimator -> samples.
        truth: samples of the true state, which are interpolated to the rows, to compare the estimates with them.
        metadata: metadata to add to the log.

    Raises:
        InputError: no sensor is given, ticks do not increase, or a field has not one value for each tick.
    """
    if not sensors:
        raise InputError(
            "log_samples", "no sensor was given", fix='pass at least one sensor, e.g. {"ranging": SampleSeries(…)}'
        )
    every = dict(sensors) | ({TRUTH: truth} if truth is not None else {})
    for name, series in every.items():
        _check_series(name, series)
    instants = np.unique(np.concatenate([s.ticks for s in sensors.values()]).astype(np.int64))
    ticks = instants - instants[0]
    signals: dict[str, Any] = {}
    declared: dict[str, Quantity] = {}
    for name, series in sensors.items():
        base, at = f"{RECEIVED}.{name}", np.searchsorted(series.ticks, instants, side="right") - 1
        seen, held = at >= 0, np.maximum(at, 0)
        when = np.asarray(series.ticks, np.int64)[held] - instants[0]
        for field, values in series.values.items():
            array = np.asarray(values)
            mask = seen.reshape(-1, *(1,) * (array.ndim - 1))
            signals[f"{base}.value.{field}"] = np.where(mask, array[held], np.zeros((), array.dtype))
            declared[f"{base}.value.{field}"] = series.declarations.get(field, Quantity("1", f"Field {field}."))
        signals[f"{base}.t"] = np.where(seen, when, 0)
        signals[f"{base}.age"] = np.where(seen, to_seconds(ticks - when), 0.0)
        signals[f"{base}.fresh"] = seen & (when == ticks)
        signals[f"{base}.valid"] = seen
    for field, values in ({} if truth is None else truth.values).items():
        columns = np.asarray(values, float).reshape(len(values), -1).T
        rows = [np.interp(instants - instants[0], truth.ticks - instants[0], column) for column in columns]  # pyright: ignore[reportOptionalMemberAccess]
        signals[f"{TRUTH}.{field}"] = np.stack(rows, axis=1).reshape(len(instants), *np.shape(values)[1:])
    declared |= {f"{TRUTH}.{f}": d for f, d in ({} if truth is None else truth.declarations).items()}
    signals["log.dropped"] = np.zeros(len(ticks), np.int64)
    declared["log.dropped"] = Quantity(
        "1", "Number of rows lost before this row. Each row is one step of the autopilot.", kind="count"
    )
    return Log(to_seconds(ticks), ticks, signals, declared, dict(metadata or {}))


def _check_series(name: str, series: SampleSeries) -> None:
    ticks = np.asarray(series.ticks)
    if ticks.ndim != 1 or not len(ticks) or ticks.dtype.kind not in "iu" or (np.diff(ticks) <= 0).any():
        fix = "give whole numbers of 100 ns, sorted, each once: np.round(seconds * 1e7).astype(np.int64)"
        raise InputError(f"sensor {name!r}", "the ticks do not rise, or are not whole numbers", fix=fix)
    for field, values in series.values.items():
        if len(values) != len(ticks):
            problem = f"the field {field!r} has {len(values)} values, but there are {len(ticks)} ticks"
            raise InputError(f"sensor {name!r}", problem, fix="give one value for each tick")


def samples(log: Log, path: str, *, longest: bool = False) -> Samples:
    """Return the samples of a signal, without repetitions. Raise InputError if samples are missing or unevenly spaced.

    Args:
        log: log of a run or of a sensor.
        path: path of a sensor's signal, e.g. ``sensors.imu.value.angular_rate``, or of another signal, for which each
            row is a sample.
        longest: True to return the longest section without gaps if only few samples are missing.
    """
    values, ticks = log[path], log.ticks
    sample = sample_path(log, path)
    if sample is not None:
        valid = log[f"{sample}.valid"].astype(bool) if f"{sample}.valid" in log else np.ones(len(log), bool)
        values, ticks = values[valid], log[f"{sample}.t"][valid].astype(np.int64)
        first = np.diff(ticks, prepend=-1) != 0
        values, ticks = values[first], ticks[first]
    if len(ticks) < 3:
        raise InputError(f"signal {path!r}", f"has only {len(ticks)} samples in this log", fix="record a longer log")
    gaps = np.diff(ticks)
    settings = log.metadata.get("parameters", {})
    period = settings.get(f"world.{sample}.period") if isinstance(settings, dict) else None
    usual = float(period or np.median(gaps))  # period in the run's settings, or the median interval
    loose = 0.01 if sample else 0.5  # samples of a sensor are periodic; rows of other loggers vary
    uneven = np.flatnonzero(np.abs(gaps - usual) > loose * usual)
    left_out = ""
    if len(uneven):
        rows_hide = sample is not None and float(np.median(np.diff(log.ticks))) > min(usual, gaps.min())
        if rows_hide or not longest or len(uneven) > GAPS_MAX * len(ticks):
            _refuse_gaps(log, path, ticks, uneven, usual, rows_hide=rows_hide)
        ends = np.array([0, *(uneven + 1), len(ticks)])
        k = int(np.argmax(np.diff(ends)))
        kept = slice(int(ends[k]), int(ends[k + 1]))
        many = f"{len(uneven)} gap{'s' if len(uneven) > 1 else ''}, the first at {to_seconds(ticks[uneven[0]]):.4f} s"
        begin, end = (f"{to_seconds(tick):.4f}" for tick in (ticks[kept][0], ticks[kept][-1]))
        left_out = f"{many}: only its longest stretch without gaps is used, {begin} to {end} s"
        values, ticks = values[kept], ticks[kept]
    return Samples(values, ticks, float(to_seconds((ticks[-1] - ticks[0]) / max(len(ticks) - 1, 1))), left_out)


def sample_path(log: Log, path: str) -> str | None:
    """Return the path of the sensor sample that contains a signal, e.g. ``sensors.imu``, or None for other signals."""
    before, value, _ = path.partition(".value.")
    return before if value and f"{before}.t" in log else None


def _refuse_gaps(log: Log, path: str, ticks: Any, uneven: Any, usual: float, *, rows_hide: bool) -> None:
    at, gap = ticks[uneven[0]], np.diff(ticks)[uneven[0]]
    problem = (
        f"the samples are not evenly spaced: usually every {format_time(round(usual))}, but {format_time(int(gap))} at"
    )
    problem += f" {at / UNITS_PER_SECOND:.4f} s, and {len(uneven) - 1} more such gaps"
    fix = "cut the log to a stretch without gaps, or log again"
    rows = float(np.median(np.diff(log.ticks)))
    if rows_hide:
        problem += f"; the log has a row only every {format_time(round(rows))}, so it misses samples"
        fix = "log rows more often than samples come, e.g. simulate(…, log_period=ms(1))"
    raise InputError(f"signal {path!r}", problem, fix=fix)


def read_csv(path: str | os.PathLike[str], time: str | None = None) -> Log:
    """Return a log made from a CSV file. The times are shifted to start at 0, and rounded to 100 ns.

    A column with a cell that is not a finite number is left out. The log's metadata ``left_out`` contain the reason for
    each such column.

    Args:
        path: path of the file.
        time: name of the time column. Add the unit if the column's name and heading do not state it, e.g.
            ``stamp [us]``. None: the first column with a usual name of a time, such as t or stamp.
    """
    where = f"log file '{path}'"
    table = read_table(path)
    names = [column.name for column in table.columns]
    wanted, unit = split_heading(time or "")
    chosen = [n for n in names if (n == wanted if time else time_unit(n) is not None)]
    if not chosen:
        problem = f"has no column {wanted!r}" if time else "has no column of times"
        fix = f"name the column of times 'time' (in seconds), or give its name: {argument('time', 'NAME')}"
        raise InputError(where, problem, choices=names, fix=fix)
    paths = _signal_paths(where, names, chosen[0])
    clock = table.column(chosen[0])
    if clock.problem:
        raise InputError(where, clock.problem, fix="leave the line out; gaps are then reported by their time")
    _refuse_disorder(where, table.lines, clock.values, clock.values)
    since = (clock.values - clock.values[0]) * _time_scale(where, clock, unit)
    ticks = np.round(since * UNITS_PER_SECOND).astype(np.int64)
    _refuse_disorder(where, table.lines, clock.values, ticks)
    others = [column for column in table.columns if column.name in paths]
    good, left = [c for c in others if not c.problem], {c.name: c.problem for c in others if c.problem}
    if left and not good:
        raise InputError(where, next(iter(left.values())), fix="write a number, or leave such lines out")
    signals = {paths[c.name]: c.values for c in good}
    declared = {paths[c.name]: Quantity(c.unit or "1", f"Column {c.name}.") for c in good}
    about = {"file": Path(path).name} | ({"left_out": left} if left else {})
    return Log(to_seconds(ticks), ticks, signals, declared, about)


def _refuse_disorder(where: str, lines: Sequence[int], times: Any, rising: Any) -> None:
    """Raise InputError if `rising` (n,), computed from the times (n,), does not rise from row to row."""
    falls = np.flatnonzero(np.diff(rising) <= 0)
    if len(falls):
        at = int(falls[0])
        problem = f"the times must rise, but after line {lines[at]}: {times[at]}, then {times[at + 1]}"
        fix = "sort the file, remove repeated rows, and write times with a resolution of at least 100 ns"
        raise InputError(where, problem, fix=fix)


def _time_scale(where: str, clock: CsvColumn, unit: str) -> float:
    """Return the unit of the time column, as a number of seconds. Raise InputError for an unknown or implausible unit.

    unit: unit that the user typed, or "". If neither the user nor the file states a unit, seconds are assumed.
    """
    said = unit or clock.unit or time_unit(clock.name) or ""
    scale = find_size(said or "s", "s")
    if scale is None:
        problem = f"the column of times {clock.name!r} is in {said!r}"
        fix = f"convert the times to seconds and name the column {clock.name}, or {clock.name} [s]"
        raise InputError(where, problem, choices=UNITS["s"], fix=fix)
    period = usual_period(clock.values)
    if period * scale < PERIOD_MIN or (not said and period > PERIOD_MAX):
        taken = f"{said}, as written" if said else "s, as no unit is given"
        problem = f"the column of times {clock.name!r} has a row every {period:.6g} {taken}; no sensor has that period"
        likely = next((u for u in ("s", "ms", "us", "ns") if period * UNITS["s"][u] <= PERIOD_LIKELY), "ns")
        heading = f"{clock.name} [{likely}]"
        fix = f"write the unit in the heading, e.g. {heading}, or {argument('time', heading)}"
        raise InputError(where, problem, choices=UNITS["s"], fix=fix)
    return scale


def usual_period(times: Any) -> float:
    """Return the median difference of successive times (n,), in the unit of the times, or NaN for fewer than two."""
    return float(np.median(np.diff(times))) if len(times) > 1 else np.nan


def _signal_paths(where: str, names: list[str], time: str) -> dict[str, str]:
    """Return the name of a column -> path of the signal, for all columns except columns of times.

    Raise InputError if two paths are equal.
    """
    paths: dict[str, str] = {}
    for i, name in enumerate(names):
        whole, index = re.fullmatch(r"(.*?)((?:\[\d+\])?)", name).groups()  # pyright: ignore[reportOptionalMemberAccess]
        path = f"{BLOCK}.{re.sub(r'[^0-9A-Za-z]+', '_', whole)}{index}"
        same = next((n for n, p in paths.items() if p == path), None)
        if same is not None or name in names[:i]:
            problem = f"columns {same or name!r} and {name!r} have the same signal, {path}"
            raise InputError(
                where, problem, fix=f"give the columns names that differ in letters or digits, e.g. {name}_2"
            )
        if name != time and time_unit(name) is None:
            paths[name] = path
    return paths
