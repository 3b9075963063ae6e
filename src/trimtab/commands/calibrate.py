"""`trimtab calibrate noise`: from a log of a sensor at rest to its noise coefficients and a filter's Q and R."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from trimtab.commands.options import FILE, JSON
from trimtab.commands.output import check_picture, console, draw_plot, new_table, print_files, print_json, write_text
from trimtab.core.errors import InputError, closest
from trimtab.core.time import parse_time, to_seconds
from trimtab.identify.allan import (
    AllanFit,
    Coefficient,
    FilterNoise,
    filter_noise,
    fit_allan,
    octave_averages,
    refuse_motion,
)
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.samples import read_csv, sample_path, samples
from trimtab.plots.allan import plot_allan

AT_REST = 1e-6
"""A speed (m/s) or a rate (rad/s) in the truth of a simulated log above this means that it moved."""
FEWEST = 1024
"""Samples that a log must have."""


class SensorAxis(NamedTuple):
    """One axis of a sensor: what was fitted, the filter's noise, and how much log there was (samples, s)."""

    unit: str
    fit: AllanFit
    noise: FilterNoise
    samples: int
    duration: float


@click.group()
def command() -> None:
    """From measured data to parameters.

    \b
    trimtab calibrate noise still/run.mcap           noise of a sensor at rest, and a filter's Q and R
    """


@command.command(name="noise")
@click.argument("log", type=FILE)
@click.option("--signal", "signals", multiple=True, metavar="PATH", help="Only this signal; repeatable.")
@click.option(
    "--shortest", metavar="TIME", help="Leave shorter averages out, e.g. of a sensor that filters its output."
)
@click.option("--tick", metavar="TIME", help="Step of the filter.  [default: that of the sensor]")
@click.option("--time", metavar="NAME", help="Column of times (s) of a CSV file.  [default: t, time, …]")
@click.option("--plot", type=FILE, metavar="FILE", help="Picture of the Allan deviations.")
@click.option("--out", type=FILE, metavar="DIR", help="Folder for figures (JSON) and picture.")
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
    """Noise coefficients of a sensor at rest: white, flicker and walk, with intervals, and a filter's Q and R.

    LOG is an MCAP file of `trimtab run … --out`, or a CSV file with a column of times.

    \b
    trimtab run navigation/still --out still
    trimtab calibrate noise still/run.mcap --plot allan.png
    trimtab calibrate noise bench.csv --signal gyro_z --shortest '20 ms' --json
    """
    picture = plot or (out / "noise.png" if out else None)
    check_picture(picture, out)
    least, step = _parse_times(shortest, tick)
    still = read_csv(log, time) if log.suffix.lower() == ".csv" else read_mcap(log)
    _refuse_moving(still)
    axes = {n: _fit_axis(n, still.unit(p), y, dt, least, step) for n, p, y, dt in _iterate_axes(still, signals)}
    result = {"log": str(log), "signals": {name: _axis_json(axis) for name, axis in axes.items()}}
    files = [] if out is None else [write_text(out / "noise.json", json.dumps(result, indent=1))]
    fits, units = {n: a.fit for n, a in axes.items()}, {n: a.unit for n, a in axes.items()}
    files += draw_plot(picture, plot_allan, fits, units, title=f"Allan deviation, {log.name}")
    if as_json:
        print_json(result, files)
        return
    _print_noise(log.name, axes)
    print_files(files)


def _parse_times(shortest: str | None, tick: str | None) -> tuple[float, float | None]:
    """Shortest average and the filter's step, in s; refuses what is no stretch of time."""
    least = 0 if shortest is None else parse_time(shortest)
    step = None if tick is None else parse_time(tick)
    if least < 0:
        problem = f"{shortest!r} is below 0"
        raise InputError("--shortest", problem, fix="--shortest '20 ms', or leave it out for every average")
    if step is not None and step <= 0:
        problem = f"{tick!r} is not longer than 0"
        raise InputError("--tick", problem, fix="--tick '5 ms', or leave it out for the sensor's own")
    return float(to_seconds(least)), None if step is None else float(to_seconds(step))


def _refuse_moving(log: Log) -> None:
    """A simulated log says itself whether the vehicle moved."""
    for path in log.paths:
        if path.startswith("truth.") and log.unit(path) in ("m/s", "rad/s") and len(log):
            most = float(np.max(np.abs(log[path])))
            if most > AT_REST:
                problem = f"the vehicle moves in this log: {path} reaches {most:.3g} {log.unit(path)}"
                fix = "trimtab run navigation/still --out still  writes a log at rest"
                raise InputError("calibrate noise", problem, fix=fix)


def _iterate_axes(log: Log, names: tuple[str, ...]) -> Iterator[tuple[str, str, Any, float]]:
    """Name, path, samples (n,) and period (s) of each axis."""
    paths = [p for n in names for p in _matching_signals(log, n)] if names else _candidate_signals(log)
    for path in paths:
        measured = samples(log, path)
        if len(measured.ticks) < FEWEST:
            problem = (
                f"{len(measured.ticks)} samples, {len(measured.ticks) * measured.period:.3g} s, are too short a log"
            )
            fix = f"log at least {FEWEST} samples, for the walk K minutes: trimtab run navigation/still --out still"
            raise InputError(f"signal {path!r}", problem, fix=fix)
        values = measured.values if measured.values.ndim > 1 else measured.values[:, None]
        for i, y in enumerate(values.T):
            yield (f"{path}[{i}]" if measured.values.ndim > 1 else path), path, y, measured.period


def _matching_signals(log: Log, name: str) -> list[str]:
    name = f"csv.{name}" if f"csv.{name}" in log else name
    paths = [p for p in log.paths if p == name or p.startswith(f"{name}.")]
    if not paths:
        measured = _candidate_signals(log)
        near = closest(name, measured) or measured
        problem = "there is no such signal in this log"
        raise InputError(f"--signal {name}", problem, choices=near, fix=f"--signal {near[0]}")
    noisy = [p for p in paths if _is_noisy(log, p)]
    if not noisy:
        problem, fix = "holds no numbers that change", "name one of the choices"
        raise InputError(f"--signal {name}", problem, choices=_candidate_signals(log), fix=fix)
    return noisy


def _candidate_signals(log: Log) -> list[str]:
    """What sensors measured: the values of samples, or in a log that has none every column; only what changes."""
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
        problem = f"{shortest:g} s leaves {len(averages)} averaging times of a log of {len(y) * dt:.3g} s"
        raise InputError("--shortest", problem, fix="take a shorter time, or a longer log")
    fit = fit_allan(y, dt, averages)
    refuse_motion(name, y, fit)
    return SensorAxis("U" if unit in ("", "1") else unit, fit, filter_noise(fit, tick), len(y), len(y) * dt)


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
    """Noise coefficients of each axis with their intervals, and what a filter takes."""
    any_axis = next(iter(axes.values()))
    shown, dt = console(), any_axis.fit.sampling_period
    headings = ("axis", "U", ">white N (U/√Hz)", ">flicker B (U)", ">walk K (U/√s)", ">misfit")
    table = new_table(*headings, title=f"{name}: {any_axis.duration:.4g} s, a sample each {1e3 * dt:.6g} ms")
    for axis, a in axes.items():
        cells = (_format_coefficient(c) for c in (a.fit.white, a.fit.flicker, a.fit.walk))
        table.add_row(axis.replace("[", r"\["), a.unit, *cells, f"{a.fit.misfit:.2f}")
    shown.print(table)
    headings = ("axis", ">R of a sample (U²)", ">Q of the integral (U² s²)", ">Q of the bias (U²)")
    table = new_table(*headings, title="For a filter that steps with the sensor, or with --tick")
    for axis, a in axes.items():
        n = a.noise
        cells = (f"{v:.4g}" for v in (n.sample_variance, n.integral_variance, n.bias_variance))
        table.add_row(axis.replace("[", r"\["), *cells)
    shown.print(table)
    click.echo("intervals: 95 %; '<': the log shows none, up to that (docs, Noise from a still log)")


def _format_coefficient(c: Coefficient) -> str:
    return f"{c.value:.4g}  ({c.low:.4g} … {c.high:.4g})" if c.low > 0 else f"< {c.high:.4g}"
