"""`trimtab calibrate measure`: guide the user through a procedure, check each entry, and save it."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from trimtab.analysis.identify import rudder, spin_up, thrust
from trimtab.commands.options import FILE
from trimtab.commands.output import check_folder
from trimtab.core.errors import InputError
from trimtab.core.units import UNITS
from trimtab.logs.measurements import TRIAL as TRIAL_COLUMN
from trimtab.logs.measurements import MeasuredColumn, read_measurements

FAR = 0.25
"""Deviation of an entry, as a fraction of the largest entry, above which the user must confirm the entry."""


class GuidedProcedure(NamedTuple):
    """Procedure of a guided measurement.

    columns: columns of the file, in the order in which the user is asked.  given: number of leading columns whose
    values the plan sets.  plan: these values and the trial number, for each measurement.
    before: preparations, one step on each line.  rises: two columns, of which the second increases with the first.
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
        ("Fan off, servo on. Lay the protractor's zero on the hull's x axis; clockwise from above is positive.",),
        ("pulse", "angle"),
    ),
    "hull": GuidedProcedure(
        rudder.HULL_COLUMNS,
        1,
        [(theta, trial) for trial in (1, 2) for theta in range(-30, 31, 5)],
        (
            "Tie a string to the pivot at the tail and to a fixed object; fan on, at moderate speed.",
            "When the hull is at rest, read the angle from its x axis to the string's line; clockwise is positive.",
            "In the first round push the hull a little to starboard first (way 1), in the second to port (way -1).",
        ),
    ),
    "thrust": GuidedProcedure(
        thrust.THRUST_COLUMNS,
        1,
        [(theta, trial) for trial in range(1, 7) for theta in range(-30, 31, 10)],
        (
            "Gauge between string and hull, lift on, battery full. Six rounds: about 6, 7.5, 9, 10, 11 and 12 krpm.",
            "Set the rudder, wait until the hull is at rest, then read speed and force at the same time.",
        ),
        ("speed", "force"),
    ),
    "reverse": GuidedProcedure(
        thrust.REVERSE_COLUMNS,
        1,
        [(n, trial) for trial in (1, 2) for n in range(6000, 12001, 1000)],
        ("Rudder straight. At each speed read the force forward, then in reverse, both as positive numbers.",),
        ("speed", "reverse"),
    ),
    "inertia": GuidedProcedure(
        spin_up.TRIAL_COLUMNS,
        1,
        [(-20 if trial % 2 else 25, trial) for trial in range(1, 7)],
        (
            "Lift on, fan at more than 1 N, rudder deflected; hold the hull, start the log, release the hull.",
            "The slope is the rise of the yaw rate per second just after the release; clockwise is positive.",
        ),
    ),
}


@click.command(name="measure")
@click.argument("procedure", type=click.Choice(tuple(PROCEDURES)))
@click.argument("file", type=FILE)
def measure(procedure: str, file: Path) -> None:
    """Guide a series of measurements: each is saved in FILE, and the next call continues where the last one stopped.

    Type a number, u to undo the last measurement, or q to stop.

    \b
    trimtab calibrate measure thrust thrust.csv
    trimtab calibrate thrust thrust.csv --out boat.toml
    """
    guide = PROCEDURES[procedure]
    check_folder("FILE", file.parent)
    heading = ",".join([*(c.heading() for c in guide.columns), TRIAL_COLUMN])
    lines = _read_lines(file, heading, guide.columns)
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
                f"saved {len(lines)} of {len(guide.plan)}; continue with: trimtab calibrate measure {procedure} {file}"
            )
            return
        else:
            lines = [*lines, values]
        file.write_text("\n".join([heading, *lines]) + "\n", encoding="utf-8")
    click.echo(f"all {len(lines)} measured; now: trimtab calibrate {procedure} {file} --out boat.toml")


def _read_lines(file: Path, heading: str, columns: Sequence[MeasuredColumn]) -> list[str]:
    """Read and check the measurements that an earlier call saved, one on each line."""
    if not file.exists():
        return []
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    if lines[:1] != [heading]:
        problem = f"{str(file)!r} exists, but its first line is not {heading}"
        raise InputError("FILE", problem, fix="name a new file, or a file that this procedure wrote")
    if len(lines) > 1:
        read_measurements(file, [c._replace(most=0.0) for c in columns])
    return lines[1:]


def _ask_row(guide: GuidedProcedure, setting: tuple[float, ...], number: int, lines: Sequence[str]) -> str:
    """Ask for the next measurement; return its line for the file, or "u" (undo) or "q" (quit)."""
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
        "  far from the entries at neighbouring settings; is this entry correct?", default=False
    ):
        return _ask_row(guide, setting, number, lines)
    return row


def _ask_number(column: MeasuredColumn) -> str:
    """Ask for a number within the column's range, in the usual unit; return its text, or "u" (undo) or "q" (quit)."""
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
    """Return True if the last entry and another entry of the same round are far from the order required by `rises`."""
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
