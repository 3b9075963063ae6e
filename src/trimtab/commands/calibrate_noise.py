"""`trimtab calibrate noise`: noise coefficients of a sensor, and a filter's Q and R, from a log at rest."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from trimtab.analysis.identify.allan import (
    AllanFit,
    Coefficient,
    FilterNoise,
    filter_noise,
    fit_allan,
    octave_averages,
    refuse_motion,
    refuse_stuck,
)
from trimtab.analysis.identify.inertial_noise import AXES, TRIADS, noise_calibration
from trimtab.commands.calibrate_files import add_to_file, check_calibration_file, entries_json, print_entries
from trimtab.commands.foreign_logs import read_own_log
from trimtab.commands.options import FILE, JSON, OUT, PLOT
from trimtab.commands.output import check_picture, draw_plot, new_table, print_files, print_json, print_table, quote
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.time import parse_time, to_seconds
from trimtab.core.units import find_unit
from trimtab.logs.log import Log
from trimtab.logs.samples import BLOCK, PERIOD_MAX, Samples, read_csv, sample_path, samples
from trimtab.loop.calibration import Calibration
from trimtab.plots.allan import plot_allan

AT_REST = 1e-6
"""True speed (m/s) or angular rate (rad/s) in a simulated log above which the vehicle counts as moving."""
WORDS = {"gyro": "gyr|rate(?!d)|omega", "accelerometer": "acc|force"}
"""Parts of the name of a signal from which its triad is known, as regular expressions. The end of
"calibrated" is not one of them."""
SAMPLES_MIN = 1024
"""Minimum number of samples from which the Allan deviation of an axis is computed."""


class SensorAxis(NamedTuple):
    """Noise of one axis of a sensor.

    unit: SI unit.  fit: fit of the Allan deviation.  noise: noise parameters of a filter.
    samples, duration: length of the log in samples and in s.
    place: "gyro" or "accelerometer", and axis 0, 1 or 2 (x, y, z). None for another sensor, or if the name does not
    tell the axis.
    """

    unit: str
    fit: AllanFit
    noise: FilterNoise
    samples: int
    duration: float
    place: tuple[str, int] | None


@click.command(name="noise")
@click.argument("log", metavar="DATA", type=FILE)
@click.option(
    "--signal", "signals", multiple=True, metavar="PATH", help="Use only this signal of the log. May be repeated."
)
@click.option(
    "--shortest",
    metavar="TIME",
    help="Shortest averaging time to use. Choose one above the time constant of the sensor's output filter.",
)
@click.option("--tick", metavar="TIME", help="Time step of the filter.  [default: period of the sensor]")
@click.option("--time", metavar="NAME", help="Time column of a CSV file, e.g. 'stamp [us]'.  [default: t, time, …]")
@PLOT("Draw the Allan deviations to this picture.")
@OUT("FILE.toml", "Write the parameters to this calibration file. Other parameters in the file are kept.")
@JSON
def calibrate_noise(
    log: Path,
    signals: tuple[str, ...],
    shortest: str | None,
    tick: str | None,
    time: str | None,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Estimate a resting sensor's noise, and Q and R for a filter.

    The noise is split into white noise, flicker and random walk.

    DATA is a log of `trimtab run … --out`, or a CSV file with a time column and units in its headings. Axes of an
    inertial unit are recognised by unit and name (gyro_z [deg/s], accel_x [g]), and are written as parameters of the
    sensor and of the navigation filter. --tick is the time step of this filter (the filter's setting noise.tick).

    \b
    trimtab run navigation/still --out still
    trimtab calibrate noise still/run.mcap --out boat.toml --plot allan.png
    trimtab calibrate noise bench.csv --signal gyro_z --shortest '20 ms' --json
    """
    check_picture(plot, None)
    check_calibration_file(out)
    least, step = _parse_times(shortest, tick)
    still = read_csv(log, time) if log.suffix.lower() == ".csv" else read_own_log(log)
    _refuse_moving(still)
    measured = {path: _read_samples(still, path) for path in _chosen_signals(still, signals)}
    measured_axes = list(_iterate_axes(measured))
    _refuse_copies(measured_axes)
    axes = {n: _fit_axis(n, still.unit(p), y, dt, least, step) for n, p, y, dt in measured_axes}
    calibration, notes = _calibrate_units(log.name, axes, step)
    notes += tuple(f"signal {path} has {one.left_out}" for path, one in measured.items() if one.left_out)
    if not signals:
        notes += tuple(f"left out: {problem}" for problem in _left_out(still).values())
        constant = [p for p in still.paths if p.startswith(f"{BLOCK}.") and p not in measured]
        notes += (f"left out, because the values never change: {', '.join(constant)}",) if constant else ()
    if out is not None and not calibration.entries:
        problem = f"none of {', '.join(axes)} is an axis of an inertial unit, so there is nothing to write"
        fix = "write unit and axis in the column headings, e.g. gyro_z [rad/s] and accel_x [m/s^2]; or leave --out out"
        raise InputError("--out", problem, fix=fix)
    whole, files = add_to_file(out, calibration)
    fits, units = {n: a.fit for n, a in axes.items()}, {n: a.unit for n, a in axes.items()}
    files += draw_plot(plot, plot_allan, fits, units, title=f"Allan deviation, {log.name}")
    if as_json:
        result = {"log": str(log), "signals": {name: _axis_json(axis) for name, axis in axes.items()}}
        result |= {"entries": entries_json(calibration), "notes": list(notes), "sha256": whole.content_hash()}
        print_json(result, files)
        return
    _print_noise(log.name, axes)
    if calibration.entries:
        print_entries(f"noise of {log.name}, for a calibration", calibration)
    for note in notes:
        click.echo(show_controls(f"note: {note}"))
    print_files(files)
    if out is not None:
        click.echo(
            f"calibration {whole.content_hash()[:12]}; to use it: trimtab run SCENARIO --calibration {quote(out)}"
        )


def _calibrate_units(
    file: str, axes: Mapping[str, SensorAxis], step: float | None
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration of the gyro and accelerometer axes, and notes on the other axes."""
    whole, notes = Calibration({}), list[str]()
    for triad in TRIADS:
        mine: dict[int, str] = {}
        for name, axis in axes.items():
            if axis.place is not None and axis.place[0] == triad:
                same = mine.setdefault(axis.place[1], name)
                if same != name:
                    problem = f"{same} and {name} both claim to be the {triad}'s {AXES[axis.place[1]]} axis"
                    raise InputError("calibrate noise", problem, fix=f"choose one: --signal {same}")
        if mine:
            fits = {i: axes[name].fit for i, name in sorted(mine.items())}
            seconds = axes[mine[min(mine)]].duration
            source = f"{file}: {seconds:.4g} s of {', '.join(AXES[i] for i in fits)} at rest"
            found = noise_calibration(triad, fits, source, step)
            whole, notes = whole.merge(found.calibration), [*notes, *found.notes]
    others = [name for name, a in axes.items() if a.place is None]
    if others:
        notes.append(f"not an axis of an inertial unit, so not part of the calibration: {', '.join(others)}")
    return whole, tuple(notes)


def _find_place(path: str, unit: str) -> tuple[str, int] | None:
    """Return sensor triad and axis of a signal, from its unit and the end of its name: [0] to [2], or x, y, z."""
    triad = next((n for n, t in TRIADS.items() if t.unit == unit), None)
    match = re.search(r"\[([012])\]$|([xyzXYZ])$", path)
    if triad is None or match is None:
        return None
    other = next((n for n, words in WORDS.items() if n != triad and re.search(words, path, re.IGNORECASE)), None)
    if other is not None and not re.search(WORDS[triad], path, re.IGNORECASE):
        problem = f"is in {unit}, the unit of the {triad}, but has the name of the {other}"
        fix = f"correct the unit in the heading, e.g. [{TRIADS[other].unit}], or the name"
        raise InputError(f"signal {path!r}", problem, fix=fix)
    return triad, int(match[1]) if match[1] else AXES.index(match[2].lower())


def _parse_times(shortest: str | None, tick: str | None) -> tuple[float, float | None]:
    """Parse the shortest averaging time and the filter's time step. Return both in s; raise InputError if invalid."""
    least = 0 if shortest is None else _parse_option("--shortest", shortest)
    step = None if tick is None else _parse_option("--tick", tick)
    if least < 0:
        problem = f"must be at least 0, got {shortest!r}"
        raise InputError("--shortest", problem, fix="--shortest '20 ms', or leave it out to use all averages")
    if step is not None and not 0 < to_seconds(step) <= PERIOD_MAX:
        problem = f"must be above 0 and at most {PERIOD_MAX:g} s, got {tick!r}"
        raise InputError("--tick", problem, fix="--tick '5 ms', or leave it out for the sensor's period")
    return float(to_seconds(least)), None if step is None else float(to_seconds(step))


def _parse_option(name: str, text: str) -> int:
    """Parse the time in an option. Raise InputError with the option's name if the text is not a time."""
    try:
        return parse_time(text)
    except InputError as error:
        raise InputError(name, error.problem, choices=error.choices, fix=f"{name} '20 ms'") from None


def _refuse_moving(log: Log) -> None:
    """Raise InputError if the true state in a simulated log shows that the vehicle moves."""
    for path in log.paths:
        if path.startswith("truth.") and log.unit(path) in ("m/s", "rad/s") and len(log):
            most = float(np.max(np.abs(log[path])))
            if most > AT_REST:
                problem = f"the vehicle moves in this log: {path} reaches {most:.3g} {log.unit(path)}"
                fix = "trimtab run navigation/still --out still  writes a log at rest"
                raise InputError("calibrate noise", problem, fix=fix)


def _chosen_signals(log: Log, names: tuple[str, ...]) -> list[str]:
    """Return the paths of the named signals, or of all signals that change if no name is given."""
    return [p for n in names for p in _matching_signals(log, n)] if names else _candidate_signals(log)


def _read_samples(log: Log, path: str) -> Samples:
    """Return the samples of a signal's longest stretch without gaps. Raise InputError if the samples are too few."""
    measured = samples(log, path, longest=True)
    if len(measured.ticks) < SAMPLES_MIN:
        seconds = len(measured.ticks) * measured.period
        problem = f"the log is too short: {len(measured.ticks)} samples, {seconds:.3g} s"
        problem += f"; the signal has {measured.left_out}" if measured.left_out else ""
        fix = f"log at least {SAMPLES_MIN} samples (minutes for random walk): trimtab run navigation/still --out still"
        raise InputError(f"signal {path!r}", problem, fix=fix)
    return measured


def _refuse_copies(axes: Sequence[tuple[str, str, Any, float]]) -> None:
    """Raise InputError if two axes, as `_iterate_axes` yields them, have the same samples."""
    for (one, _, first, _), (other, _, second, _) in itertools.combinations(axes, 2):
        if np.array_equal(first, second):
            problem = f"{one} and {other} have the same samples"
            raise InputError("calibrate noise", problem, fix=f"correct the file, or choose one: --signal {one}")


def _iterate_axes(measured: Mapping[str, Samples]) -> Iterator[tuple[str, str, Any, float]]:
    """Yield name, path, samples (n,) and sampling period (s) of each axis of the measured signals."""
    for path, one in measured.items():
        values = one.values if one.values.ndim > 1 else one.values[:, None]
        for i, y in enumerate(values.T):
            yield (f"{path}[{i}]" if one.values.ndim > 1 else path), path, y, one.period


def _left_out(log: Log) -> dict[str, str]:
    """Return the columns of a CSV file that were not read, as name -> reason."""
    left = log.metadata.get("left_out", {})
    return dict(left) if isinstance(left, dict) else {}


def _matching_signals(log: Log, name: str) -> list[str]:
    if name.removeprefix(f"{BLOCK}.") in _left_out(log):
        problem = _left_out(log)[name.removeprefix(f"{BLOCK}.")]
        raise InputError(f"--signal {name}", problem, fix="write a number there, or remove the line from the file")
    name = f"{BLOCK}.{name}" if f"{BLOCK}.{name}" in log else name
    paths = [p for p in log.paths if p == name or p.startswith(f"{name}.")]
    if not paths:
        measured = _candidate_signals(log)
        near = closest(name, measured) or measured
        problem = "not found in this log"
        raise InputError(f"--signal {name}", problem, choices=near, fix=f"--signal {near[0]}")
    noisy = [p for p in paths if _is_noisy(log, p)]
    if not noisy:
        problem, fix = "contains no changing numbers", "name one of the choices"
        raise InputError(f"--signal {name}", problem, choices=_candidate_signals(log), fix=fix)
    return noisy


def _candidate_signals(log: Log) -> list[str]:
    """Return the paths of all sensor samples that change, or of all changing columns if the log has no samples."""
    sampled = [p for p in log.paths if p.startswith("sensors.") and sample_path(log, p)]
    noisy = [p for p in sampled or log.paths if _is_noisy(log, p)]
    if not noisy:
        raise InputError(
            "calibrate noise", "no signal in this log changes", fix="log a sensor with noise, at full resolution"
        )
    return noisy


def _is_noisy(log: Log, path: str) -> bool:
    values = log[path]
    real = path not in log.declarations or log.declarations[path].kind in ("real", "angle")
    return bool(values.dtype.kind == "f" and real and len(values) and np.ptp(values, axis=0).max() > 0)


def _fit_axis(name: str, unit: str, y: Any, dt: float, shortest: float, tick: float | None) -> SensorAxis:
    averages = tuple(m for m in octave_averages(len(y)) if m * dt >= shortest)
    if len(averages) < 4:
        problem = f"{shortest:g} s leaves only {len(averages)} averaging times in a log of {len(y) * dt:.3g} s"
        raise InputError("--shortest", problem, fix="use a shorter averaging time, or a longer log")
    unit, scale = _si_unit(unit)
    refuse_stuck(name, y, dt)
    place = _find_place(name, unit)
    if place is not None and dt > PERIOD_MAX:
        problem = f"has a sample every {dt:.6g} s; an inertial unit has one at least every {PERIOD_MAX:g} s"
        raise InputError(f"signal {name!r}", problem, fix="correct the unit of the times, e.g. t [ms]")
    y = y * scale
    fit = fit_allan(y, dt, averages)
    refuse_motion(name, y, fit)
    return SensorAxis("U" if unit == "1" else unit, fit, filter_noise(fit, tick), len(y), len(y) * dt, place)


def _si_unit(text: str) -> tuple[str, float]:
    """Return the SI unit for a unit in a heading, and the conversion factor. An unknown unit is returned unchanged."""
    try:
        unit = find_unit("heading", text)
    except InputError:
        return text, 1.0
    return unit.name, unit.scale


def _axis_json(axis: SensorAxis) -> dict[str, Any]:
    fit, noise = axis.fit, axis.noise
    result: dict[str, Any] = {"unit": axis.unit, "samples": axis.samples, "duration_s": axis.duration}
    result |= {"period_s": fit.sampling_period, "misfit": fit.misfit}
    for name in ("white", "flicker", "walk"):
        c: Coefficient = getattr(fit, name)
        result[name] = {n: float(getattr(c, n)) for n in ("value", "standard_error", "low", "high")}
    result["noise"] = {n: float(getattr(noise, n)) for n in ("sample_variance", "integral_variance", "bias_variance")}
    curve = {"tau_s": fit.tau, "deviation": fit.deviation, "model": fit.model}
    return result | {name: [float(v) for v in values] for name, values in curve.items()}


def _print_noise(name: str, axes: Mapping[str, SensorAxis]) -> None:
    """Print the noise coefficients of each axis with 95 % intervals, and Q and R for a filter."""
    any_axis = next(iter(axes.values()))
    dt = any_axis.fit.sampling_period
    headings = ("axis", "U", ">white N (U/√Hz)", ">flicker B (U)", ">walk K (U/√s)", ">misfit")
    table = new_table(*headings, title=f"{name}: {any_axis.duration:.4g} s, one sample every {1e3 * dt:.6g} ms")
    for axis, a in axes.items():
        cells = (_format_coefficient(c) for c in (a.fit.white, a.fit.flicker, a.fit.walk))
        table.add_row(axis.replace("[", r"\["), a.unit, *cells, f"{a.fit.misfit:.2f}")
    print_table(table)
    headings = ("axis", ">R of a sample (U²)", ">Q of the integral (U² s²)", ">Q of the bias (U²)")
    table = new_table(*headings, title="Noise variances for a filter whose time step is the sensor's period, or --tick")
    for axis, a in axes.items():
        n = a.noise
        cells = (f"{v:.4g}" for v in (n.sample_variance, n.integral_variance, n.bias_variance))
        table.add_row(axis.replace("[", r"\["), *cells)
    print_table(table)
    click.echo("intervals: 95 %. '<': noise not detected; the number is an upper bound (docs, Noise from a still log)")


def _format_coefficient(c: Coefficient) -> str:
    return f"{c.value:.4g}  ({c.low:.4g} … {c.high:.4g})" if c.low > 0 else f"< {c.high:.4g}"
