"""`trimtab calibrate measure`: guide the user through a measurement. Each reading is checked and saved."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from trimtab.analysis.identify import rudder, spin_up, thrust
from trimtab.commands.options import FILE
from trimtab.commands.output import check_folder, quote
from trimtab.core.errors import InputError
from trimtab.core.units import UNITS
from trimtab.core.user_file import read_user_text
from trimtab.logs.measurements import TRIAL as TRIAL_COLUMN
from trimtab.logs.measurements import MeasuredColumn, read_measurements

FAR = 0.25
"""Deviation of a reading, as a fraction of the largest reading, above which the user must confirm the reading."""


class GuidedProcedure(NamedTuple):
    """Procedure of a guided measurement.

    columns: columns of the file, in the order in which the user is asked.  given: number of leading columns whose
    values the plan sets.  plan: for each measurement, the values of these columns and the trial number.
    before: instructions to show before the first measurement.  rises: names of two columns. The second must increase
    with the first.
    """

    columns: tuple[MeasuredColumn, ...]
    given: int
    plan: Sequence[tuple[float, ...]]
    before: tuple[str, ...]
    rises: tuple[str, str] | None = None


def _servo_plan() -> list[tuple[float, ...]]:
    up = [1000 + 50 * k for k in range(21)]
    return [(p, way, trial) for trial, way in ((1, 1), (2, -1)) for p in up[::way]]


PROCEDURES: Mapping[str, GuidedProcedure] = {
    "rudder": GuidedProcedure(
        (*rudder.SERVO_COLUMNS[:1], rudder.WAY, rudder.SERVO_COLUMNS[1]),
        2,
        _servo_plan(),
        ("Fan off, servo on. Align the protractor's zero with the hull's x axis; clockwise from above is positive.",),
        ("pulse", "angle"),
    ),
    "hull": GuidedProcedure(
        rudder.HULL_COLUMNS,
        1,
        [(theta, trial) for trial in (1, 2) for theta in range(-30, 31, 5)],
        (
            "Tie the rudder pivot at the tail to a fixed object with a string. Turn the fan on, at moderate speed.",
            "When the hull is at rest, read the angle from the hull's x axis to the string; clockwise is positive.",
            "Before each reading push the hull a little: in round 1 to starboard (way 1), in round 2 to port (way -1).",
        ),
    ),
    "thrust": GuidedProcedure(
        thrust.THRUST_COLUMNS,
        1,
        [(theta, trial) for trial in range(1, 7) for theta in range(-30, 31, 10)],
        (
            "Force gauge between string and hull, lift on, battery full. "
            "Six rounds at about 6, 7.5, 9, 10, 11 and 12 krpm.",
            "Set the rudder, wait until the hull is at rest, then read speed and force at the same time.",
        ),
        ("speed", "force"),
    ),
    "reverse": GuidedProcedure(
        thrust.REVERSE_COLUMNS,
        1,
        [(n, trial) for trial in (1, 2) for n in range(6000, 12001, 1000)],
        ("Rudder straight. At each speed read the forward force, then the reverse force, both positive.",),
        ("speed", "reverse"),
    ),
    "inertia": GuidedProcedure(
        spin_up.TRIAL_COLUMNS,
        1,
        [(-20 if trial % 2 else 25, trial) for trial in range(1, 7)],
        (
            "Lift fan on, thrust above 1 N, rudder deflected. Hold the hull, start the log, then release the hull.",
            "The slope is the rise of the yaw rate per second just after the release; clockwise is positive.",
        ),
    ),
}


@click.command(name="measure")
@click.argument("procedure", type=click.Choice(tuple(PROCEDURES)))
@click.argument("file", type=FILE)
def measure(procedure: str, file: Path) -> None:
    """Guide a series of measurements. Each is saved in FILE, so that the next call continues where this call stopped.

    Type a number, u to undo the last measurement, or q to stop.

    \b
    trimtab calibrate measure thrust thrust.csv
    trimtab calibrate thrust thrust.csv --out boat.toml
    """
    guide = PROCEDURES[procedure]
    check_folder("FILE", file.parent)
    heading = ",".join([*(c.heading() for c in guide.columns), TRIAL_COLUMN])
    lines = _read_lines(file, heading, guide.columns)
    _check_plan(file, guide, lines)
    if not lines:
        for step in guide.before:
            click.echo(f"- {step}")
    elif len(lines) < len(guide.plan):
        click.echo(f"{file.name} has {len(lines)} of {len(guide.plan)} measurements; continuing")
    while len(lines) < len(guide.plan):
        setting = guide.plan[len(lines)]
        values = _ask_row(guide, setting, len(lines), lines)
        if values == "u":
            lines = lines[:-1]
        elif values == "q":
            click.echo(
                f"saved {len(lines)} of {len(guide.plan)}; continue with: "
                f"trimtab calibrate measure {procedure} {quote(file)}"
            )
            return
        else:
            lines = [*lines, values]
        file.write_text("\n".join([heading, *lines]) + "\n", encoding="utf-8")
    click.echo(f"all {len(lines)} measured; now: trimtab calibrate {procedure} {quote(file)} --out boat.toml")


def _read_lines(file: Path, heading: str, columns: Sequence[MeasuredColumn]) -> list[str]:
    """Read and check the measurements that an earlier call saved, one on each line."""
    if not file.exists():
        return []
    try:
        lines = [line for line in read_user_text(file).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        problem = f"{str(file)!r} cannot be read as text: {error}"
        raise InputError("FILE", problem, fix="name a new file, or a file that this procedure has written") from None
    if lines[:1] != [heading]:
        problem = f"{str(file)!r} exists, but its first line is not {heading}"
        raise InputError("FILE", problem, fix="name a new file, or a file that this procedure has written")
    comment = next((line for line in lines if line.startswith("#")), None)
    if comment is not None:
        problem = f"{str(file)!r} contains the comment {comment!r}, which would be lost"
        raise InputError("FILE", problem, fix="remove the comment from the file")
    if len(lines) > 1:
        read_measurements(file, [c._replace(most=0.0) for c in columns])
    return lines[1:]


def _check_plan(file: Path, guide: GuidedProcedure, lines: Sequence[str]) -> None:
    """Raise InputError if the settings of the saved measurements are not those of the plan, in this order."""
    names = [*(c.name for c in guide.columns[: guide.given]), TRIAL_COLUMN]
    for number, (line, setting) in enumerate(zip(lines, guide.plan, strict=False), 1):
        cells = line.split(",")
        for name, cell, planned in zip(names, [*cells[: guide.given], cells[-1]], setting, strict=True):
            if not math.isclose(float(cell), planned, rel_tol=1e-9):
                problem = f"measurement {number} ({line}) of {str(file)!r} must have {name} {planned:g}, as planned,"
                raise InputError("FILE", f"{problem} got {cell.strip()}", fix="restore this line, or name a new file")
    if len(lines) > len(guide.plan):
        problem = f"{str(file)!r} must have at most {len(guide.plan)} measurements, got {len(lines)}"
        raise InputError("FILE", problem, fix="remove the last lines, or name a new file")


def _ask_row(guide: GuidedProcedure, setting: tuple[float, ...], number: int, lines: Sequence[str]) -> str:
    """Ask for the next measurement. Return the text line to write to the file, or "u" (undo) or "q" (quit)."""
    given, trial = setting[:-1], setting[-1]
    names = [
        f"{c.name} {v:g} {c.usual or c.unit}".removesuffix(" 1") for c, v in zip(guide.columns, given, strict=False)
    ]
    click.echo(f"{number + 1}/{len(guide.plan)}: {', '.join(names)}")
    cells = [f"{v:g}" for v in given]
    for column in guide.columns[len(given) :]:
        if column is rudder.WAY:
            cells.append("1" if trial % 2 else "-1")
            continue
        cell = _ask_number(column)
        if cell in ("u", "q"):
            return cell
        cells.append(cell)
    row = ",".join([*cells, f"{trial:g}"])
    if _stands_out(guide, [*lines, row]) and not click.confirm(
        "  this reading is far from the readings at neighbouring settings; is it correct?", default=False
    ):
        return _ask_row(guide, setting, number, lines)
    return row


def _ask_number(column: MeasuredColumn) -> str:
    """Ask for a number in the column's usual unit and range. Return the number's text, or "u" (undo) or "q" (quit)."""
    unit = column.usual or column.unit
    factor = UNITS[column.unit][unit]
    while True:
        text = str(click.prompt(f"  {column.meaning} [{unit}]", type=str)).strip()
        if text in ("u", "q"):
            return text
        try:
            value = float(text)
        except ValueError:
            fix = f"write {text.replace(',', '.')}" if "," in text else "type a number, u (undo the last) or q (stop)"
            click.echo(f"  {text!r} is not a number: {fix}")
            continue
        if column.low <= value * factor <= column.high:
            return f"{value:.10g}"
        click.echo(
            f"  {value:g} {unit} is outside {column.low / factor:.6g} to {column.high / factor:.6g} {unit}; try again"
        )


def _stands_out(guide: GuidedProcedure, lines: Sequence[str]) -> bool:
    """Return True if the last reading and another one of the same round strongly violate the order set by `rises`."""
    if guide.rises is None:
        return False
    names = [c.name for c in guide.columns]
    x, y = (names.index(n) for n in guide.rises)
    rows = [[float(cell) for cell in line.split(",")] for line in lines]
    last, others = rows[-1], rows[:-1]
    same = [
        r for r in others if all(r[k] == last[k] for k in range(guide.given) if k not in (x, y) and names[k] != "way")
    ]
    size = max((abs(r[y]) for r in rows), default=0.0)
    pairs = itertools.product([last], same)
    return any((a[x] - b[x]) * (a[y] - b[y]) < 0 and abs(a[y] - b[y]) > FAR * size for a, b in pairs)
