"""Reader of hand-written measurements: CSV files with a unit in each heading.

    speed [rpm],force [gf]
    6000,41
    8000,72

Columns may be in any order, and unknown columns are ignored. Repeated measurements are numbered in the column
``trial``. The following errors are reported with line and column: text instead of a number, a wrong unit, a value
outside the column's range (e.g. because of a wrong unit or swapped columns), and duplicate lines.
"""

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.units import UNITS, find_size
from trimtab.core.user_file import read_user_text

TRIAL = "trial"
"""Name of the column with the numbers of repeated measurements. With this column, lines that are otherwise equal are
accepted."""


NEIGHBOURS = 2
"""Number of readings before, and number of readings after a reading, with which the reading is compared to find
spikes."""
STEP_MIN, STEP_MAX = 1e-4, 2.0
"""Smallest and largest plausible time between two readings of a logger (s)."""
SPIKE = 12.0
"""Threshold for spikes: deviation of a reading from the surrounding readings, as a multiple of the usual deviation."""


class MeasuredColumn(NamedTuple):
    """Column in the measurement file of a calibration procedure.

    low, high: limits of valid values, in the column's unit.  most: smallest plausible value of the largest number in
    the column.  needed: True if the file must have this column.  usual: unit in which the quantity is usually written.
    """

    name: str
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    most: float = 0.0
    needed: bool = True
    usual: str = ""

    def heading(self) -> str:
        """Return the heading of the column in a file, e.g. ``angle [deg]``."""
        return f"{self.name} [{self.usual or self.unit}]"


@dataclass(frozen=True)
class Measurements:
    """Content of a measurement file.

    file: name of the file.  lines: line number of each row (n,).  values: name of a column -> values (n,) in the unit
    of the `MeasuredColumn`.
    """

    file: str
    lines: Any
    values: Mapping[str, Any]

    def __getitem__(self, name: str) -> Any:
        """Return the values of a column (n,)."""
        return self.values[name]

    def __contains__(self, name: object) -> bool:
        """Return True if the file has a column with this name."""
        return name in self.values

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    def select(self, chosen: Any) -> "Measurements":
        """Return the measurements in some of the rows. rows: mask or indices of these rows."""
        return Measurements(self.file, self.lines[chosen], {n: v[chosen] for n, v in self.values.items()})

    def name_lines(self, chosen: Any) -> str:
        """Return the line numbers of some of the rows as text, e.g. "lines 4, 7 and 12"."""
        return name_lines([int(n) for n in self.lines[chosen]])


def name_lines(lines: Sequence[int], most: int = 6) -> str:
    """Return line numbers as text, e.g. "lines 4, 7 and 12"."""
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > most:
        return f"lines {', '.join(map(str, lines[:most]))} and {len(lines) - most} more"
    return f"lines {', '.join(map(str, lines[:-1]))} and {lines[-1]}"


def read_measurements(path: str | Path, columns: Iterable[MeasuredColumn], *, series: bool = False) -> Measurements:
    """Read a CSV file of measurements.

    Args:
        path: path of the file, a text in UTF-8.
        columns: columns of the procedure. Columns without `needed=False` are required.
        series: True if the first column is the time, which must increase. False: duplicate lines are rejected.

    Raises: InputError for invalid content. The message names file, line and column, and says what to write.
    """
    columns, where = tuple(columns), f"file '{path}'"
    rows = _read_rows(where, Path(path), columns)
    (first, head), body = rows[0], rows[1:]
    at, factors = _match_headings(where, first, head, columns)
    lines = np.array([line for line, _ in body])
    values: dict[str, Any] = {}
    for column in columns:
        if column.name in at:
            cells = [(line, cells[at[column.name]]) for line, cells in body]
            values[column.name] = _read_column(where, column, cells) * factors[column.name]
    if TRIAL in at:
        values[TRIAL] = np.array([cells[at[TRIAL]].strip() for _, cells in body])
    result = Measurements(Path(path).name, lines, values)
    for refuse in (_refuse_values, _refuse_small):
        for column in [c for c in columns if c.name in values]:
            refuse(where, column, result)
    if series:
        _refuse_order(where, columns[0].name, result)
    else:
        _refuse_repeats(where, result)
    return result


def read_names(path: str | Path, columns: Iterable[MeasuredColumn]) -> list[str]:
    """Return the names of all columns of a measurement file, without units, as `read_measurements` compares them.

    columns: columns to name in the error message for an invalid file.
    """
    return _plain_names(_read_rows(f"file '{path}'", Path(path), tuple(columns))[0][1])


def refuse_spikes(data: Measurements, name: str) -> None:
    """Raise InputError if a time series contains spikes, i.e. single readings far from the surrounding readings."""
    values = np.asarray(data[name], np.float64)
    if len(values) < 2 * NEIGHBOURS + 1:
        return
    padded = np.pad(values, NEIGHBOURS, mode="edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1), axis=1)
    off = np.abs(values - usual)
    wild = off > np.maximum(SPIKE * 1.4826 * np.median(off), 0.05 * np.ptp(usual))
    if wild.any():
        k = int(np.argmax(np.where(wild, off, 0.0)))
        more = f"; other such readings: {data.name_lines(wild)}" if wild.sum() > 1 else ""
        problem = (
            f"line {data.lines[k]}, column {name!r}: {values[k]:.6g} is {off[k]:.3g} off the surrounding readings{more}"
        )
        raise InputError(f"file {data.file!r}", problem, fix="correct the value, or leave the line out")


def refuse_wrong_step(file: str, times: Any, trial: str = "") -> None:
    """Raise InputError if the time between two readings is not plausible, e.g. because of a wrong unit of the times.

    Args:
        file: name of the file.
        times: times of the readings (n,), s.
        trial: beginning of the message, which names the trial.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else STEP_MAX
    if not STEP_MIN <= step <= STEP_MAX:
        problem = f"{trial}column 'time': the readings are {step:.6g} s apart, must be {STEP_MIN:g} to {STEP_MAX:g} s"
        fix = "check the unit in the heading (are the times in [s]?), or log at 20 Hz or more"
        raise InputError(f"file {file!r}", problem, fix=fix)


def describe_columns(columns: Iterable[MeasuredColumn]) -> str:
    """Return the headings that a file needs, as one line of CSV."""
    return ",".join(c.heading() for c in columns if c.needed)


def _read_rows(where: str, path: Path, columns: Sequence[MeasuredColumn]) -> list[tuple[int, list[str]]]:
    """Return line number and cells of each row, without comments (#) and empty lines. The first row has the
    headings."""
    wanted = f"first line {describe_columns(columns)}, then a line of numbers for each measurement"
    try:
        text = read_user_text(path)
    except FileNotFoundError:
        raise InputError(where, "the file does not exist", fix=f"write one: {wanted}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, f"cannot be read as text: {error}", fix=f"give CSV in UTF-8: {wanted}") from None
    numbered = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise InputError(where, "is empty", fix=f"write {wanted}")
    first = numbered[0][1]
    if ";" in first or ("\t" in first and "," not in first):
        problem = f"line {numbered[0][0]} uses {'semicolons' if ';' in first else 'tabs'} between columns"
        raise InputError(where, problem, fix="separate columns by commas, and write 1.5, not 1,5")
    rows = [(n, next(csv.reader([line]))) for n, line in numbered]
    if len(rows) == 1:
        raise InputError(where, "has headings but no measurements", fix=f"write {wanted}")
    for line, cells in rows[1:]:
        if len(cells) != len(rows[0][1]):
            problem = f"line {line} has {len(cells)} cells, but there are {len(rows[0][1])} headings"
            raise InputError(
                where, problem, fix="write decimals with a point (1.5, not 1,5), one cell for each heading"
            )
    return rows


def _match_headings(
    where: str, line: int, head: Sequence[str], columns: Sequence[MeasuredColumn]
) -> tuple[dict[str, int], dict[str, float]]:
    """Return the name of a column -> index in a row, and the name of a column -> conversion factor of its unit."""
    at: dict[str, int] = {}
    factors: dict[str, float] = {}
    names = _plain_names(head)
    for i, (name, cell) in enumerate(zip(names, head, strict=True)):
        if name in at:
            raise InputError(where, f"line {line} has column {name!r} twice", fix="remove one of the two columns")
        column = next((c for c in columns if c.name == name), None)
        if column is not None:
            match = re.search(r"[\[(](.*?)[\])]", cell)
            factors[name] = _unit_factor(where, line, column, match[1].strip() if match else None)
        if column is not None or name == TRIAL:
            at[name] = i
    for column in columns:
        if column.needed and column.name not in at:
            near = closest(column.name, [n for n in names if n not in at], 1)
            problem = f"has no column {column.name!r} ({column.meaning})"
            fix = f"write {column.heading()}" + (f" where it says {near[0]!r}" if near else " and its values")
            raise InputError(where, problem, choices=[c.strip() for c in head], fix=fix)
    return at, factors


def _plain_names(head: Sequence[str]) -> list[str]:
    return [re.split(r"\s*[\[(]", cell)[0].strip().lower().replace(" ", "_") for cell in head]


def _unit_factor(where: str, line: int, column: MeasuredColumn, unit: str | None) -> float:
    known = [known for known in UNITS[column.unit] if known != "1"]
    if unit is None and column.unit != "1":
        problem = f"line {line}: column {column.name!r} has no unit"
        raise InputError(where, problem, choices=known, fix=f"write {column.heading()}, or another of the choices")
    size = find_size(unit or "", column.unit)
    if size is None:
        problem = f"line {line}: column {column.name!r} is in {unit!r}, not a unit of this quantity ({column.meaning})"
        raise InputError(where, problem, choices=known, fix=f"write {column.heading()}")
    return size


def _read_column(where: str, column: MeasuredColumn, cells: Sequence[tuple[int, str]]) -> Any:
    values = np.empty(len(cells))
    for i, (line, cell) in enumerate(cells):
        text = cell.strip()
        try:
            values[i] = float(text)
        except ValueError:
            problem = f"line {line}, column {column.name!r}: {text!r} is not a number"
            fix = f"write {text.replace(',', '.')}" if re.fullmatch(r"-?\d+,\d+", text) else "leave the line out"
            raise InputError(where, problem, fix=fix) from None
        if not math.isfinite(values[i]):
            problem = f"line {line}, column {column.name!r}: {text!r} is not finite"
            raise InputError(where, problem, fix="leave the line out")
    return values


def _refuse_values(where: str, column: MeasuredColumn, data: Measurements) -> None:
    """Raise InputError for values outside a column's range, e.g. because of a wrong unit or swapped columns."""
    values = data[column.name]
    outside = (values < column.low) | (values > column.high)
    unit, size = _usual_unit(column)
    fits = f"{column.low / size:.6g} to {column.high / size:.6g} {unit}"
    about = f"column {column.name!r} ({column.meaning})"
    if outside.any():
        k = int(np.argmax(outside))
        problem = f"line {data.lines[k]}, {about}: {values[k] / size:.6g} {unit} is outside {fits}"
        raise InputError(where, problem, fix="correct the unit in the heading, the order of the headings, or the value")


def _usual_unit(column: MeasuredColumn) -> tuple[str, float]:
    """Return the unit in which the quantity of a column is usually written, and its size in the column's unit."""
    unit = column.usual or column.unit
    return unit, UNITS[column.unit][unit]


def _refuse_small(where: str, column: MeasuredColumn, data: Measurements) -> None:
    """Raise InputError if all values of a column are implausibly small, e.g. because of a wrong unit in the heading."""
    values, about = data[column.name], f"column {column.name!r} ({column.meaning})"
    if float(np.max(np.abs(values))) < column.most:
        unit, size = _usual_unit(column)
        problem = f"{about}: no value is above {np.max(np.abs(values)) / size:.3g} {unit}"
        fix = "check the unit in the heading, or measure larger values"
        raise InputError(where, problem, fix=fix)


def _refuse_order(where: str, time: str, data: Measurements) -> None:
    falls = np.flatnonzero(np.diff(data[time]) <= 0)
    if len(falls):
        k = int(falls[0])
        problem = f"line {data.lines[k + 1]}, column {time!r}: {data[time][k + 1]:.9g} s must be after"
        problem += f" {data[time][k]:.9g} s of line {data.lines[k]}"
        raise InputError(where, problem, fix="sort the lines by time, and remove repeated ones")


def _refuse_repeats(where: str, data: Measurements) -> None:
    seen: dict[tuple[Any, ...], int] = {}
    for i, line in enumerate(data.lines):
        row = tuple(v[i] for v in data.values.values())
        if row in seen:
            problem = f"lines {seen[row]} and {line} are the same"
            fix = f"leave one line out, or number repeated measurements in a column {TRIAL}"
            raise InputError(where, problem, fix=fix)
        seen[row] = int(line)
