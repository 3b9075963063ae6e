"""`trimtab calibrate show|compare|simulate`, and the output of all procedures: table, calibration file, picture."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from trimtab.commands.flight_summary import METRICS, summarise_run
from trimtab.commands.options import FILE, JSON, SEED
from trimtab.commands.output import (
    check_folder,
    check_out,
    check_picture,
    draw_plot,
    new_table,
    print_files,
    print_json,
    print_table,
    quote,
    write_text,
)
from trimtab.commands.progress import show_spinner
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text
from trimtab.loop.calibration import (
    Calibration,
    compare_calibrations,
    flat_entries,
    format_calibration,
    read_calibration,
    student_reach,
)
from trimtab.loop.scenario import Scenario
from trimtab.plots.calibration import FitPanel, plot_fits

SHOWN = 12
"""Maximum number of elements of an array that a table shows in full."""


class CalibrationReport(NamedTuple):
    """Report of a calibration procedure.

    file: name of the data file.  readings: number of measured readings.  left_out: descriptions of rejected readings.
    panels: plots of the fit.
    notes: remarks for the user.
    """

    file: str
    readings: int
    left_out: tuple[str, ...]
    panels: tuple[FitPanel, ...]
    notes: tuple[str, ...] = ()


def finish_calibration(
    procedure: str,
    calibration: Calibration,
    report: CalibrationReport,
    out: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Print the results of a calibration procedure, add the results to the calibration file, and draw the fit."""
    check_picture(plot, None)
    whole, files = add_to_file(out, calibration)
    files += draw_plot(plot, plot_fits, report.panels, title=f"calibrate {procedure}: {report.file}")
    if as_json:
        result = {
            "procedure": procedure,
            "file": report.file,
            "readings": report.readings,
            "entries": entries_json(calibration),
        }
        result |= {"left_out": list(report.left_out), "notes": list(report.notes), "sha256": whole.content_hash()}
        print_json(result, files)
        return
    print_entries(f"{procedure} of {report.file}, {report.readings} readings", calibration)
    for line in report.left_out:
        click.echo(show_controls(f"left out: {line}"))
    for note in report.notes:
        click.echo(show_controls(f"note: {note}"))
    print_files(files)
    if out is not None:
        click.echo(
            f"calibration {whole.content_hash()[:12]}; to use it: trimtab run SCENARIO --calibration {quote(out)}"
        )


def add_to_file(out: Path | None, calibration: Calibration) -> tuple[Calibration, list[Path]]:
    """Merge a calibration into the calibration file `out`. Return the merged calibration and the path of the file.

    If `out` is None, return the calibration unchanged, and no path.
    """
    if out is None:
        return calibration, []
    check_calibration_file(out)
    whole = read_calibration(out).merge(calibration) if out.exists() else calibration
    return whole, [write_text(out, format_calibration(whole))]


def check_calibration_file(out: Path | None) -> None:
    """Raise InputError if the file name does not end in .toml, or if writing would delete text that the user wrote."""
    if out is not None:
        if out.suffix != ".toml":
            raise InputError(
                "--out", f"{str(out)!r} is not a calibration file (.toml)", fix=f"--out {out.stem or 'boat'}.toml"
            )
        loses_nothing = out.is_file() and format_calibration(read_calibration(out)) == read_user_text(out)
        if not loses_nothing:  # the file may contain the user's comments, which would be lost
            check_out("--out", out, "boat.toml")


def print_entries(title: str, calibration: Calibration) -> None:
    """Print each parameter of a calibration: value, 95 % interval, unit and source."""
    table = new_table("parameter", ">value", ">95 % interval", "unit", "source", title=title, unwrapped=("parameter",))
    flat, more = flat_entries(calibration), dict[str, int]()
    for name, (value, error, freedom) in flat.items():
        base = name.partition("[")[0]
        entry = calibration.entries[base]
        if np.size(entry.value) > SHOWN and (more.setdefault(base, 0) or True):
            more[base] += 1
            if more[base] > 3:
                continue
        reach = student_reach(freedom) * error
        digits = _digits(reach)
        interval = f"{value - reach:.{digits}g} … {value + reach:.{digits}g}" if reach > 0 else "-"
        table.add_row(name.replace("[", r"\["), f"{value:.{digits}g}", interval, entry.unit, entry.source)
    for base, count in more.items():
        table.add_row(f"{base} …", "", "", "", f"{count - 3} more elements in the file")
    print_table(table)


@click.command(name="show")
@click.argument("file", type=FILE)
@JSON
def show(file: Path, as_json: bool) -> None:
    """Show the parameters in a calibration file.

    Each parameter comes with its 95 % interval and its source.
    """
    calibration = read_calibration(file)
    if as_json:
        print_json({"sha256": calibration.content_hash(), "entries": entries_json(calibration)})
        return
    print_entries(f"{file.name}, {calibration.content_hash()[:12]}", calibration)


@click.command(name="compare")
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@click.option(
    "--scenario", metavar="SCENARIO", help="Scenario to fly with calibration A and with B, to compare the flights."
)
@SEED
@JSON
def compare(a: Path, b: Path, scenario: str | None, seed: int, as_json: bool) -> None:
    """Show the differences between two calibration files.

    With a scenario, also show how the differences change its flight.
    """
    one, two = read_calibration(a), read_calibration(b)
    changes = compare_calibrations(one, two)
    flown = {} if scenario is None else _fly_both(scenario, a, b, seed)
    if as_json:
        rows = {n: {"a": x, "b": y, "sigmas": s} for n, (x, y, s) in changes.items()}
        print_json({"changes": rows, "metrics": flown})
        return
    units = {n: e.unit for c in (one, two) for n, e in c.entries.items()}
    if not changes:
        same = one.content_hash() == two.content_hash()
        click.echo("the parameters are identical" if same else "the values are identical; the standard errors differ")
    else:
        if not flat_entries(one).keys() & flat_entries(two).keys():
            click.echo(f"{a.name} and {b.name} have no parameter in common")
        table = new_table(
            "parameter", f">{a.name}", f">{b.name}", ">difference (sigma)", "unit", unwrapped=("parameter",)
        )
        for name, (x, y, apart) in changes.items():
            cells = ("-" if v is None else f"{v:.6g}" for v in (x, y))
            far = "-" if apart is None else f"{apart:.1f}"
            table.add_row(name.replace("[", r"\["), *cells, far, units[name.partition("[")[0]])
        print_table(table)
    if flown:
        table = new_table("signal", "metric", f">{a.name}", f">{b.name}", title=f"{scenario}, seed {seed}")
        for signal, metrics in flown.items():
            for metric, (x, y) in metrics.items():
                if not _same(x, y):
                    table.add_row(signal, METRICS[metric][0], *(f"{v:.4g}" if v is not None else "-" for v in (x, y)))
        print_table(table)


@click.command(name="simulate")
@click.argument("folder", type=FILE)
@SEED
@JSON
def simulate_bench(folder: Path, seed: int, as_json: bool) -> None:
    """Simulate bench measurements. Write the data of every procedure, and the true values (truth.toml), to FOLDER.

    \b
    trimtab calibrate simulate bench --seed 3
    trimtab calibrate thrust bench/thrust.csv --out boat.toml
    trimtab calibrate compare bench/truth.toml boat.toml
    """
    from trimtab.analysis.identify.virtual_bench import draw_craft, run_bench, write_bench

    check_folder("FOLDER", folder)
    existing = [f for f in sorted(folder.glob("*")) if f.suffix in (".csv", ".toml")]
    if existing:
        raise InputError(
            "FOLDER", f"the folder already contains data: {existing[0]}", fix=f"trimtab calibrate simulate {folder}-2"
        )
    craft = draw_craft(seed)
    files = write_bench(folder, run_bench(craft, seed))
    files.append(write_text(folder / "truth.toml", format_calibration(craft.true_calibration())))
    if as_json:
        print_json({"seed": seed}, files)
        return
    print_files(files)


def _same(x: float | None, y: float | None) -> bool:
    return x == y or (x is not None and y is not None and math.isclose(x, y, rel_tol=1e-9))


def _fly_both(name: str, a: Path, b: Path, seed: int) -> dict[str, dict[str, list[float | None]]]:
    """Fly a scenario with calibration a and with b. Return signal -> metric -> values in the two flights."""
    from trimtab.run.simulate import simulate

    scenarios = [_build_calibrated(name, file) for file in (a, b)]
    with show_spinner(f"flying {name} with both calibrations"):
        metrics = [summarise_run(simulate(s, seed=seed), s.targets)["metrics"] for s in scenarios]
    return {signal: {metric: [m[signal][metric] for m in metrics] for metric in METRICS} for signal in metrics[0]}


def _build_calibrated(name: str, file: Path) -> Scenario:
    """Return a scenario with the calibration in a file. An error message names the file."""
    from trimtab.scenarios.build import build

    try:
        return build(name, {"calibration": str(file)})
    except InputError as error:
        part = error.part.replace("--calibration", f"calibration '{file}'")
        raise InputError(part, error.problem, choices=error.choices, fix=error.fix) from None


def _digits(reach: float) -> int:
    return 6 if reach > 0 else 7


def entries_json(calibration: Calibration) -> dict[str, Any]:
    """Return the entries of a calibration as JSON data."""
    return {
        name: {"value": e.value, "unit": e.unit, "standard_error": e.standard_error, "source": e.source}
        | ({"freedom": e.freedom} if math.isfinite(e.freedom) else {})
        for name, e in calibration.entries.items()
    }
