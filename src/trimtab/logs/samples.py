"""Samples of a sensor, from a log and into a log: each once, at the time of measurement, whatever the log's rows.

A log's rows hold the last sample until there is a new one; the sample's own time shows which. CSV files of other
loggers can be read: a line of names, optionally with units, ``gyro_z [rad/s]`` or ``gyro_z (rad/s)``, then a line of
numbers for each instant.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.quantity import Quantity
from trimtab.core.time import UNITS_PER_SECOND, format_time, to_seconds
from trimtab.core.units import UNITS, find_size
from trimtab.core.user_file import read_user_text
from trimtab.logs.log import Log

TIMES = ("t", "time", "time_s", "timestamp", "seconds")
"""Names of the column of times, in any case."""
BLOCK = "csv"
"""Block name before each signal's name: ``csv.gyro_z``."""

RECEIVED, TRUTH = "downlink", "truth"
"""Blocks of a log: signals received by the autopilot, and the truth."""


class Samples(NamedTuple):
    """Evenly spaced samples.

    values: (n,) or (n, k).  ticks: int64 (n,), times of measurement.  period: s, between samples.
    """

    values: Any
    ticks: Any
    period: float


class SampleSeries(NamedTuple):
    """Samples of one sensor, or of the truth.

    ticks: int64 (n,), rising, times of measurement.  values: field -> (n,) or (n, k).
    declarations: field -> unit and meaning.
    """

    ticks: Any
    values: Mapping[str, Any]
    declarations: Mapping[str, Quantity] = {}


def log_samples(
    sensors: Mapping[str, SampleSeries], truth: SampleSeries | None = None, metadata: Mapping[str, Any] | None = None
) -> Log:
    """Create a log from samples recorded elsewhere, for a replay and, with truth, for comparison.

    It has a row at each time of measurement, as if the sample had arrived at once; each row holds the newest sample of
    each sensor. Times may begin anywhere; the first row is at 0.

    Args:
        sensors: by their names in the estimator.
        truth: interpolated to the rows; exact at its own instants.
        metadata: further metadata of the log.

    Raises:
        InputError: no sensor, ticks that do not rise, or a field of another length than the ticks.
    """
    if not sensors:
        raise InputError("log_samples", "no sensor was given", fix='give some, e.g. {"ranging": SampleSeries(…)}')
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
    declared["log.dropped"] = Quantity("1", "Number of rows lost before this row; a row is a step.", kind="count")
    return Log(to_seconds(ticks), ticks, signals, declared, dict(metadata or {}))


def _check_series(name: str, series: SampleSeries) -> None:
    ticks = np.asarray(series.ticks)
    if ticks.ndim != 1 or not len(ticks) or ticks.dtype.kind not in "iu" or (np.diff(ticks) <= 0).any():
        fix = "give whole numbers of 100 ns, sorted, each once: np.round(seconds * 1e7).astype(np.int64)"
        raise InputError(f"sensor {name!r}", "its ticks do not rise, or are not whole numbers", fix=fix)
    for field, values in series.values.items():
        if len(values) != len(ticks):
            problem = f"its field {field!r} has {len(values)} values, but there are {len(ticks)} ticks"
            raise InputError(f"sensor {name!r}", problem, fix="give one value for each tick")


def samples(log: Log, path: str) -> Samples:
    """Return the samples of a signal, each once; raise InputError for missing samples or uneven times.

    Args:
        log: log of a run or of a sensor.
        path: a signal of a sample, e.g. ``sensors.imu.value.angular_rate``; for other signals each row is a sample.
    """
    values, ticks = log[path], log.ticks
    sample = sample_path(log, path)
    if sample is not None:
        valid = log[f"{sample}.valid"].astype(bool) if f"{sample}.valid" in log else np.ones(len(log), bool)
        values, ticks = values[valid], log[f"{sample}.t"][valid].astype(np.int64)
        first = np.diff(ticks, prepend=-1) != 0
        values, ticks = values[first], ticks[first]
    if len(ticks) < 3:
        raise InputError(f"signal {path!r}", f"has only {len(ticks)} samples in this log", fix="log it for longer")
    gaps = np.diff(ticks)
    settings = log.metadata.get("parameters", {})
    period = settings.get(f"world.{sample}.period") if isinstance(settings, dict) else None
    usual = float(period or np.median(gaps))  # from the run's settings, or the usual gap
    loose = 0.01 if sample else 0.5  # a sensor keeps its period; rows of other loggers vary
    uneven = np.flatnonzero(np.abs(gaps - usual) > loose * usual)
    if len(uneven):
        _refuse_gaps(log, path, ticks, uneven, usual, sampled=sample is not None)
    return Samples(values, ticks, float(to_seconds((ticks[-1] - ticks[0]) / (len(ticks) - 1))))


def sample_path(log: Log, path: str) -> str | None:
    """Return the path of the sample of a signal, e.g. ``sensors.imu``; None for other signals."""
    before, value, _ = path.partition(".value.")
    return before if value and f"{before}.t" in log else None


def _refuse_gaps(log: Log, path: str, ticks: Any, uneven: Any, usual: float, *, sampled: bool) -> None:
    at, gap = ticks[uneven[0]], np.diff(ticks)[uneven[0]]
    problem = f"its samples are not evenly spaced: usually {format_time(round(usual))}, but {format_time(int(gap))} at"
    problem += f" {at / UNITS_PER_SECOND:.4f} s, and {len(uneven) - 1} more such gaps"
    fix = "cut the log to a stretch without gaps, or log again"
    rows = float(np.median(np.diff(log.ticks)))
    if sampled and rows > min(usual, np.diff(ticks).min()):
        problem += f"; the log has a row every {format_time(round(rows))}, so it misses samples"
        fix = "log rows more often than samples come, e.g. simulate(…, log_period=ms(1))"
    raise InputError(f"signal {path!r}", problem, fix=fix)


def read_csv(path: str | os.PathLike[str], time: str | None = None) -> Log:
    """Read a CSV file; times start at 0 in the log and are rounded to 100 ns.

    Args:
        path: the file.
        time: name of the column of times, in s or its own unit; None: the first of TIMES in the file.
    """
    where = f"log file '{path}'"
    names, units, lines = _read_lines(path)
    chosen = [n for n in names if n == time or (time is None and n.lower() in TIMES)]
    if not chosen:
        problem = f"has no column {time!r}" if time else "has no column of times"
        raise InputError(
            where,
            problem,
            choices=names,
            fix=f"name it time (in seconds), or give its name: {argument('time', 'NAME')}",
        )
    paths = _signal_paths(where, names, chosen[0])
    rows = _parse_numbers(where, lines, len(names), gaps=False)
    seconds = rows[:, names.index(chosen[0])]
    time_unit = units[names.index(chosen[0])]
    since = (seconds - seconds[0]) * _time_scale(where, chosen[0], time_unit)
    ticks = np.round(since * UNITS_PER_SECOND).astype(np.int64)
    signals = {path: rows[:, names.index(n)] for n, path in paths.items()}
    declared = {paths[n]: Quantity(u or "1", f"Column {n}.") for n, u in zip(names, units, strict=True) if n in paths}
    if (np.diff(ticks) <= 0).any():
        at = int(np.argmax(np.diff(ticks) <= 0))
        problem = f"its times must rise, but after line {at + 2}: {seconds[at]}, then {seconds[at + 1]}"
        raise InputError(
            where,
            problem,
            fix=("sort the file, remove repeated rows, and write times with a resolution of at least 100 ns"),
        )
    return Log(to_seconds(ticks), ticks, signals, declared, {"file": Path(path).name})


class CsvColumns(NamedTuple):
    """Columns of a file. names: without their units.  units: from the names, or empty.  rows: (n, k)."""

    names: list[str]
    units: list[str]
    rows: Any


def read_columns(path: str | os.PathLike[str], *, gaps: bool = False) -> CsvColumns:
    """Read the numbers of a CSV file.

    Args:
        path: the file.
        gaps: True to read empty and non-finite cells as NaN; False to reject them.

    Raises:
        InputError: a file that can't be read, has no rows, or holds text instead of numbers.
    """
    names, units, lines = _read_lines(path)
    return CsvColumns(names, units, _parse_numbers(f"log file '{path}'", lines, len(names), gaps=gaps))


def _read_lines(path: str | os.PathLike[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the names, their units, and the lines of numbers."""
    where = f"log file '{path}'"
    try:
        text = read_user_text(path, "utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, f"cannot be read: {error}", fix="give a CSV file of text in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip()]
    if lines and ";" in lines[0] and "," not in lines[0]:
        fix = "write commas between the columns, and a decimal point in the numbers: 1.5,2.25"
        raise InputError(where, "line 1 has semicolons between its columns", fix=fix)
    head = [name.strip().strip('"') for name in lines[0].split(",")] if lines else []
    names = [re.split(r"\s*[\[(]", name)[0] for name in head]
    units = [match[1].strip() if (match := re.search(r"[\[(](.*)[\])]", name)) else "" for name in head]
    return names, units, lines[1:]


def _time_scale(where: str, name: str, unit: str) -> float:
    """Return the length in seconds of the unit of the column of times; default: seconds."""
    scale = find_size(unit or "s", "s")
    if scale is None:
        problem = f"its column of times {name!r} is in {unit!r}"
        fix = f"convert it to seconds and name it {name}, or {name} [s]"
        raise InputError(where, problem, choices=UNITS["s"], fix=fix)
    return scale


def _signal_paths(where: str, names: list[str], time: str) -> dict[str, str]:
    """Return the signal of each column except the times; raise InputError if two columns have the same signal."""
    paths: dict[str, str] = {}
    for i, name in enumerate(names):
        path = f"{BLOCK}.{re.sub(r'[^0-9A-Za-z]+', '_', name)}"
        same = next((n for n, p in paths.items() if p == path), None)
        if same is not None or name in names[:i]:
            problem = f"columns {same or name!r} and {name!r} have the same signal, {path}"
            raise InputError(where, problem, fix=f"give them names that differ in letters or digits, e.g. {name}_2")
        if name != time:
            paths[name] = path
    return paths


def _parse_numbers(where: str, lines: list[str], columns: int, *, gaps: bool) -> np.ndarray:
    cells = [line.split(",") for line in lines]
    for i, row in enumerate(cells):
        if len(row) != columns:
            problem = f"line {i + 2} has {len(row)} columns, but there are {columns} names"
            fix = "give one number for each name, without commas inside"
            if len(row) == 2 * columns:
                problem, fix = f"{problem}: it seems to have decimal commas", "write a decimal point: 1.5, not 1,5"
            raise InputError(where, problem, fix=fix)
    if gaps:
        cells = [[cell if cell.strip() else "nan" for cell in row] for row in cells]
    try:
        rows = np.array(cells, np.float64).reshape(len(cells), columns)
    except ValueError as error:
        raise InputError(
            where, f"holds text that is not a number: {error}", fix="write numbers with a decimal point"
        ) from None
    if not len(rows) or not (gaps or np.isfinite(rows).all()):
        line = int(np.argmin(np.isfinite(rows).all(1))) + 2 if len(rows) else 0
        if not line:
            fix = "trimtab run SCENARIO --out DIR  writes a log; a table is a line of names, then lines of numbers"
            raise InputError(where, "has no rows", fix=fix)
        fix = "leave such lines out; gaps are then reported by their time"
        raise InputError(where, f"line {line} has a value that is not finite", fix=fix)
    return rows
