"""Reader of CSV files written by other programs: columns of numbers, with units in the headings.

    # a comment
    timestamp [us],gyro[0] [rad/s],gyro[1] [rad/s],mode
    1000000,0.011,-0.003,AUTO

The first line that is not a comment contains the names of the columns. If this line contains numbers, the last comment
before it contains the names. A number in brackets is an index, which is part of the name. Other text in brackets is a
unit.
"""

import csv
import os
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text

_UNITS = {
    "s": "s",
    "sec": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "millis": "ms",
    "us": "us",
    "usec": "us",
    "micros": "us",
    "ns": "ns",
    "nsec": "ns",
    "nanos": "ns",
}
"""Ending of the name of a time column, e.g. "usec" -> time unit."""
_SUFFIXES = "|".join(_UNITS)
_TIME = re.compile(
    rf"(?i:t|time|timestamp|stamp)(?i:_boot|_sample|_unix|_utc)?(?:_(?i:({_SUFFIXES}))|(S|MS|US|NS))?"
    rf"|(?i:(seconds|millis|micros|nanos))"
)
ROS_TIME = "%time"
"""Name of the time column (ns) in the output of `rostopic echo -p`."""
SHOWN = 24
"""Maximum number of characters of a cell that an error message shows."""


class CsvColumn(NamedTuple):
    """Column of a CSV file.

    name: name without the unit.  unit: unit in the heading, or "".  values: numbers (n,), or texts if a cell is not a
    number.  problem: description of the first cell that is not a number, or "".
    """

    name: str
    unit: str
    values: Any
    problem: str


class CsvTable(NamedTuple):
    """Content of a CSV file. columns: columns in the file's order.  lines: line number of each row (n,)."""

    columns: Sequence[CsvColumn]
    lines: Sequence[int]

    def column(self, name: str) -> CsvColumn:
        """Return the first column with this name."""
        return next(column for column in self.columns if column.name == name)


def time_unit(name: str) -> str | None:
    """Return the time unit in the name of a time column, or "" for a time column whose name has no unit.

    Return None for a column that is not a time column.
    """
    if name.lower() == ROS_TIME:
        return "ns"
    match = _TIME.fullmatch(name)
    if match is None:
        return None
    return _UNITS[next((part for part in match.groups() if part), "").lower()] if any(match.groups()) else ""


def split_heading(heading: str) -> tuple[str, str]:
    """Split a heading into name and unit, e.g. "gyro[0] [rad/s]" into "gyro[0]" and "rad/s"."""
    match = re.search(r"\s*[\[(](?!\s*\d+\s*[\])])(.*)[\])]", heading)
    return (heading[: match.start()], match[1].strip()) if match else (heading, "")


def read_table(path: str | os.PathLike[str], *, gaps: bool = False) -> CsvTable:
    """Read a CSV file. In a column with a cell that is not a number, `problem` describes this cell.

    Args:
        path: path of the file.
        gaps: True to read empty and non-finite cells as NaN; False to report them as a problem of the column.

    Raises:
        InputError: the file can't be read, has no rows, or has rows of different lengths.
    """
    where = f"log file '{path}'"
    head, rows, lines = _read_cells(where, path)
    if not rows:
        writes = "trimtab run SCENARIO --out DIR  writes a log (MCAP) instead"
        fix = f"a table is a line of names, then lines of numbers; {writes}"
        raise InputError(where, "has no rows", fix=fix)
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(head):
            problem = f"line {line} has {len(row)} columns, but there are {len(head)} names"
            fix = "write one cell for each name, a decimal point (1.5, not 1,5), and quotes around text with commas"
            if len(row) == 2 * len(head):
                problem, fix = (
                    f"{problem}: the file seems to have decimal commas",
                    "write a decimal point: 1.5, not 1,5",
                )
            raise InputError(where, problem, fix=fix)
    columns = [
        _parse_column(name, cells, lines, gaps) for name, cells in zip(head, zip(*rows, strict=True), strict=True)
    ]
    return CsvTable(columns, lines)


def _read_cells(where: str, path: str | os.PathLike[str]) -> tuple[list[str], list[list[str]], list[int]]:
    """Return the names of the columns, the cells of each row, and the line number of each row."""
    try:
        text = read_user_text(path)
    except OSError as error:
        raise InputError(where, f"cannot be read: {error.strerror or error}", fix="check the path") from None
    except UnicodeDecodeError as error:
        raise InputError(where, f"cannot be read: {error}", fix="use a CSV file in UTF-8") from None
    numbered = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [pair for pair in numbered if pair[1].lstrip().startswith("#")]
    numbered = [pair for pair in numbered if not pair[1].lstrip().startswith("#")]
    if numbered and ";" in numbered[0][1] and "," not in numbered[0][1]:
        fix = "write commas between the columns, and a decimal point in the numbers: 1.5,2.25"
        raise InputError(where, f"line {numbered[0][0]} has semicolons between its columns", fix=fix)
    if numbered and "\t" in numbered[0][1] and "," not in numbered[0][1]:
        fix = "write commas between the columns: 1.5,2.25"
        raise InputError(where, f"line {numbered[0][0]} has tabs between its columns", fix=fix)
    rows, lines = list[list[str]](), list[int]()
    reader, begin = csv.reader((line for _, line in numbered), skipinitialspace=True), 0
    for row in reader:
        rows.append([cell.strip() for cell in row])
        lines.append(numbered[begin][0])
        begin = reader.line_num
    if not rows:
        return [], [], []
    before = [comment for i, comment in comments if i < lines[0]]
    named = next(csv.reader([before[-1].lstrip(" #")])) if before else []
    if len(named) == len(rows[0]) and all(_is_number(cell) for cell in rows[0]):
        return [name.strip() for name in named], rows, lines
    return rows[0], rows[1:], lines[1:]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _parse_column(heading: str, cells: Sequence[str], lines: Sequence[int], gaps: bool) -> CsvColumn:
    name, unit = split_heading(heading)
    filled = [cell or "nan" for cell in cells] if gaps else cells
    if time_unit(name) is not None:
        try:
            return CsvColumn(name, unit, np.array([int(cell) for cell in filled], np.int64), "")
        except (ValueError, OverflowError):
            pass
    try:
        values = np.array(filled).astype(np.float64)
    except ValueError:
        bad = next(i for i, cell in enumerate(filled) if not _is_number(cell))
        what = f"{cells[bad][:SHOWN]!r} is not a number" if cells[bad] else "the cell is empty"
        what += "; write a decimal point" if re.fullmatch(r"-?\d+,\d+", cells[bad]) else ""
        return CsvColumn(name, unit, np.array(cells), f"line {lines[bad]}, column {name!r}: {what}")
    if not gaps and not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values)))
        return CsvColumn(
            name, unit, np.array(cells), f"line {lines[bad]}, column {name!r}: {cells[bad]!r} is not finite"
        )
    return CsvColumn(name, unit, values, "")
