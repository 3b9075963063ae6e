"""`trimtab identify`: identify parameters of vehicle and actuators from flight logs."""

import math
from pathlib import Path
from typing import Any

import click

from trimtab.analysis.identify.flight_data import FlightData, read_flight
from trimtab.analysis.identify.identification import HORIZON, Identified, identify
from trimtab.commands.calibrate_files import add_to_file, check_calibration_file
from trimtab.commands.foreign_logs import read_mapped_log, read_own_log
from trimtab.commands.options import FILE, JSON, MAP, NAVIGATION, OUT, SCENARIO, SET
from trimtab.commands.output import new_table, print_files, print_json, print_table, quote
from trimtab.commands.progress import show_spinner
from trimtab.core.errors import InputError
from trimtab.core.quantity import records
from trimtab.logs.foreign.read import detect_format, is_own_log
from trimtab.loop.calibration import Calibration, Covariance, Entry, flat_entries, read_calibration
from trimtab.loop.scenario import Scenario
from trimtab.run.fit_parameters import DELAY
from trimtab.scenarios.build import build

CHANGED = 3.0
"""Difference from the calibration, in standard errors, above which a parameter counts as changed."""


@click.command()
@SCENARIO
@click.argument("logs", nargs=-1, required=True, type=FILE, metavar="LOG…")
@click.option(
    "--fit",
    "paths",
    multiple=True,
    required=True,
    metavar="PATH",
    help="Parameter to fit: path of a setting, or delay (of the commands). May be repeated.",
)
@click.option(
    "--held-out",
    "held",
    multiple=True,
    type=FILE,
    metavar="LOG",
    help="Log that is used only for validation. May be repeated.",
)
@click.option(
    "--sensor", metavar="NAME", help="Logged sensor that measured the vehicle's state.  [default: the only such sensor]"
)
@MAP
@OUT("FILE.toml", "Write the parameters to this calibration file. Other parameters in the file are kept.")
@SET
@NAVIGATION
@JSON
def command(
    scenario: str,
    logs: tuple[Path, ...],
    paths: tuple[str, ...],
    held: tuple[Path, ...],
    sensor: str | None,
    mapping: Path | None,
    out: Path | None,
    settings: dict[str, str],
    as_json: bool,
) -> None:
    """Identify parameters of a vehicle from flights.

    The estimates are maximum-likelihood estimates with 95 % intervals.

    The logs must contain commands and measured states of the vehicle, e.g. north, east and heading from motion
    capture, at any rate. Gaps are allowed. Parameters that the data cannot separate are reported. Logs of other systems
    need --map, as in trimtab replay. In the mapping, [sensor.command] maps the commands.

    \b
    trimtab identify hovercraft/spin flight.mcap --fit world.vehicle.mass --fit world.vehicle.inertia --fit delay
    trimtab identify hovercraft/spin a.mcap b.mcap --held-out c.mcap --fit world.vehicle.friction.torque_viscous
    trimtab identify hovercraft/spin capture.csv --map capture.toml --fit world.vehicle.mass --fit delay
    trimtab identify hovercraft/spin flight.mcap --calibration boat.toml --fit world.vehicle.mass --out boat.toml
    """
    check_calibration_file(out)
    built = build(scenario, settings)
    names = [file.name for file in (*logs, *held)]
    flights, others = (
        [_read(f, f.name if names.count(f.name) == 1 else str(f), built, sensor, mapping) for f in files]
        for files in (logs, held)
    )
    with show_spinner(f"fitting {len(paths)} parameters to {len(flights)} flights"):
        found = identify(built, flights, paths, held_out=others)
    calibration = _as_calibration(built, found, [f.name for f in flights])
    if found.unexplained and out is not None:
        problem = f"the fitted model does not explain {', '.join(found.unexplained)}, so nothing is written"
        fix = "run without --out; check units, signs and axes of the mapping, and that the log is of this vehicle"
        raise InputError("--out", problem, fix=fix)
    if found.disagreeing and out is not None:
        problem = f"the logs {' and '.join(found.disagreeing)} disagree with the others, so nothing is written"
        raise InputError("--out", problem, fix="identify each log alone; all logs must be of one vehicle")
    changes = _changes(calibration, settings.get("calibration"))
    _, files = add_to_file(out, calibration)
    if as_json:
        print_json(_as_json(scenario, found, changes), files)
    else:
        _print_found(scenario, found, changes)
        print_files(files)
    if not found.estimate.converged:
        raise click.exceptions.Exit(1)


def _read(file: Path, name: str, scenario: Scenario, sensor: str | None, mapping: Path | None) -> FlightData:
    """Read a log. name: name of the log in messages."""
    if mapping is not None:
        detect_format(file)  # raises InputError for an unknown format
    own = is_own_log(file)
    if not own and mapping is None:
        fix = f"--map MAP.toml, to map the log's columns to signals; list the columns: trimtab replay {quote(file)}"
        raise InputError(f"log '{file}'", "is a log of another system", fix=fix)
    log = read_own_log(file) if own or mapping is None else read_mapped_log(file, mapping)
    return read_flight(log, scenario, sensor, name)


def _as_calibration(scenario: Scenario, found: Identified, logs: list[str]) -> Calibration:
    """Return the identified parameters as a calibration."""
    unidentifiable = found.unidentifiable()
    kept = [k for k, p in enumerate(found.parameters) if p.path not in unidentifiable and "[" not in p.path]
    about: dict[str, Any] = {"source": f"identified from {', '.join(logs)}", "procedure": "identify"}
    names = [_entry_name(scenario, found.parameters[k].path) for k in kept]
    entries = {
        name: Entry(float(found.values[k]), found.parameters[k].unit, float(found.standard_errors[k]), **about)
        for name, k in zip(names, kept, strict=True)
    }
    matrix = [[float(found.covariance[a, b]) for b in kept] for a in kept]
    return Calibration(entries, (Covariance(tuple(names), matrix, "identify"),) if names else ())


def _entry_name(scenario: Scenario, path: str) -> str:
    """Return the name of a parameter in a calibration, e.g. ``Hovercraft.mass`` for world.vehicle.mass."""
    if path == DELAY:
        return "uplink.delay"
    owner, _, field = path.rpartition(".")
    owners = dict(records(scenario))
    kind = type(owners[owner]).__name__ if owner in owners else owner.rpartition(".")[2].capitalize()
    return f"{kind}.{field}"


def _changes(calibration: Calibration, file: str | None) -> dict[str, float]:
    """Return for each parameter the difference between fit and calibration, in standard errors of the difference."""
    if file is None:
        return {}
    new, old = flat_entries(calibration), flat_entries(read_calibration(file))
    both = [n for n in new if n in old]
    return {n: abs(new[n][0] - old[n][0]) / max(math.hypot(new[n][1], old[n][1]), 1e-300) for n in both}


def _as_json(scenario: str, found: Identified, changes: dict[str, float]) -> dict[str, Any]:
    rows = zip(found.parameters, found.values, found.standard_errors, found.intervals, strict=True)
    return {
        "scenario": scenario,
        "converged": found.estimate.converged,
        "parameters": {
            p.path: {
                "nominal": p.start,
                "value": float(v),
                "standard_error": float(e),
                "low": float(i[0]),
                "high": float(i[1]),
                "unit": p.unit,
                "told": p.path not in found.unidentifiable(),
            }
            for p, v, e, i in rows
        },
        "not_told_apart": [list(group) for group in found.groups],
        "noise": dict(found.noise),
        "process_noise": dict(found.process),
        "unexplained": {field: {"rms": a, "change": b} for field, (a, b) in found.unexplained.items()},
        "correlated": dict(found.correlated),
        "disagreeing_logs": dict(found.disagreeing),
        "held_out_rms": {field: {"nominal": a, "fitted": b} for field, (a, b) in found.held_out.items()},
        "changed_since_calibration": changes,
        "log_likelihood": {"nominal": found.nominal_log_likelihood, "fitted": found.estimate.log_likelihood},
    }


def _print_unexplained(found: Identified) -> None:
    """Print the measured fields and the flights that the fitted model does not explain, and likely reasons."""
    for field, (rms, change) in found.unexplained.items():
        text = f"not explained: {field}: error {rms:.3g} over {HORIZON:g} s, while the field changes by {change:.3g};"
        click.echo(
            f"{text} check unit, sign and axis of this field and of the commands, and that the log is of this vehicle"
        )
    for name, chance in found.disagreeing.items():
        text = f"not consistent: {name} disagrees with the other logs on the parameters (p-value {chance:.1e});"
        click.echo(f"{text} the intervals are not valid. Identify each log alone; all logs must be of one vehicle")
    if found.correlated:
        fields = ", ".join(f"{field} (correlation {value:.2f})" for field, value in found.correlated.items())
        click.echo(f"not white: errors of {fields} are correlated in time, as in a navigation system")
        click.echo(
            "between its corrections. The law responds to these errors, and the fit mistakes errors and response for"
        )
        click.echo(
            "motion of the vehicle. So parameters and intervals are not valid. Log a sensor with independent errors,"
        )
        click.echo("such as motion capture, and select this sensor with --sensor NAME")


def _print_found(scenario: str, found: Identified, changes: dict[str, float]) -> None:
    headings = ("parameter", ">nominal", ">fitted", ">95 % interval", "unit")
    table = new_table(*headings, title=f"{scenario}, by maximum likelihood", unwrapped=("parameter",))
    unidentifiable = found.unidentifiable()
    intervals: list[list[float]] = found.intervals.tolist()
    for p, value, interval in zip(found.parameters, found.values, intervals, strict=True):
        ends = " … ".join(f"{end:.6g}" for end in interval)
        shown = "not identifiable" if p.path in unidentifiable else ends
        table.add_row(
            p.path.replace("[", r"\["), f"{p.start:.6g}", f"{value:.6g}", shown, "" if p.unit == "1" else p.unit
        )
    print_table(table)
    for group in found.groups:
        if len(group) > 1:
            click.echo(f"not separable: {', '.join(group)}; fit only one of them, and measure the others on a bench")
        else:
            click.echo(f"no effect in this data: {', '.join(group)}; fly a manoeuvre that excites it, or do not fit it")
    for path in sorted(unidentifiable.difference(*found.groups)):
        click.echo(
            f"not determined: {path}; give its start a value near the true one with --set, or fly other manoeuvres"
        )
    if found.held_out:
        table = new_table(
            "field", ">nominal", ">fitted", title=f"rms prediction error over {HORIZON:g} s, validation logs"
        )
        for field, (a, b) in found.held_out.items():
            table.add_row(field, f"{a:.4g}", f"{b:.4g}")
        print_table(table)
    _print_unexplained(found)
    for name, sigmas in changes.items():
        if sigmas > CHANGED:
            click.echo(f"differs from the calibration: {name}, by {sigmas:.1f} standard errors; calibrate it again")
    if not found.estimate.converged:
        click.echo(
            "not converged: the likelihood is not at its maximum; change the start with --set, or fit fewer parameters"
        )
