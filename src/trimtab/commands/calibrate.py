"""`trimtab calibrate noise`: from a log of a sensor at rest to its noise coefficients and a filter's Q and R."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

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
from trimtab.logs.samples import sample_path, samples

AT_REST = 1e-6
"""A speed (m/s) or a rate (rad/s) in the truth of a simulated log above this means that it moved."""
FEWEST = 1024


class CalibrateRequest(NamedTuple):
    """What was asked for on the command line."""

    log: Path
    signals: tuple[str, ...] = ()
    shortest: str | None = None
    tick: str | None = None
    time: str | None = None
    plot: Path | None = None
    out: Path | None = None
    as_json: bool = False


class SensorAxis(NamedTuple):
    """One axis of a sensor: what was fitted, the filter's noise, and how much log there was (samples, s)."""

    unit: str
    fit: AllanFit
    noise: FilterNoise
    samples: int
    duration: float


def calibrate_noise(request: CalibrateRequest) -> None:
    """Read, fit, show; files appear whole or not at all."""
    from trimtab.commands.fly_scenario import check_picture

    picture = request.plot or (request.out / "noise.png" if request.out else None)
    check_picture(picture, request.out)
    shortest, tick = _parse_times(request)
    log = _read_log(request)
    _refuse_moving(log)
    axes = {n: _fit_axis(n, log.unit(p), y, dt, shortest, tick) for n, p, y, dt in _iterate_axes(log, request.signals)}
    result = {"log": str(request.log), "signals": {name: _axis_json(axis) for name, axis in axes.items()}}
    written = _write_files(request, result, axes, picture)
    if request.as_json:
        click.echo(json.dumps(result | ({"files": [str(f) for f in written]} if written else {})))
        return
    from trimtab.commands.tables import print_noise

    print_noise(request.log.name, axes)
    for file in written:
        click.echo(f"wrote {file}")


def _parse_times(request: CalibrateRequest) -> tuple[float, float | None]:
    """Shortest average and the filter's step, in s; refuses what is no stretch of time."""
    shortest = 0 if request.shortest is None else parse_time(request.shortest)
    tick = None if request.tick is None else parse_time(request.tick)
    if shortest < 0:
        problem = f"{request.shortest!r} is below 0"
        raise InputError("--shortest", problem, fix="--shortest '20 ms', or leave it out for every average")
    if tick is not None and tick <= 0:
        problem = f"{request.tick!r} is not longer than 0"
        raise InputError("--tick", problem, fix="--tick '5 ms', or leave it out for the sensor's own")
    return float(to_seconds(shortest)), None if tick is None else float(to_seconds(tick))


def _read_log(request: CalibrateRequest) -> Log:
    if request.log.suffix.lower() == ".csv":
        from trimtab.logs.comma_separated import read_csv

        return read_csv(request.log, request.time)
    from trimtab.logs.mcap import read_mcap

    return read_mcap(request.log)


def _refuse_moving(log: Log) -> None:
    """A simulated log says itself whether the vehicle moved."""
    for path in log.paths:
        if path.startswith("truth.") and log.unit(path) in ("m/s", "rad/s") and len(log):
            most = float(np.max(np.abs(log[path])))
            if most > AT_REST:
                problem = f"the vehicle moves in this log: {path} reaches {most:.3g} {log.unit(path)}"
                fix = "trimtab run navigation/still --out still  writes a log at rest"
                raise InputError("calibrate noise", problem, fix=fix)


def _iterate_axes(log: Log, wanted: tuple[str, ...]) -> Iterator[tuple[str, str, Any, float]]:
    """Name, path, samples (n,) and period (s) of each axis."""
    paths = [p for w in wanted for p in _matching_signals(log, w)] if wanted else _candidate_signals(log)
    for path in paths:
        found = samples(log, path)
        if len(found.ticks) < FEWEST:
            problem = f"{len(found.ticks)} samples, {len(found.ticks) * found.period:.3g} s, are too short a log"
            fix = f"log at least {FEWEST} samples, for the walk K minutes: trimtab run navigation/still --out still"
            raise InputError(f"signal {path!r}", problem, fix=fix)
        values = found.values if found.values.ndim > 1 else found.values[:, None]
        for i, y in enumerate(values.T):
            yield (f"{path}[{i}]" if found.values.ndim > 1 else path), path, y, found.period


def _matching_signals(log: Log, wanted: str) -> list[str]:
    wanted = f"csv.{wanted}" if f"csv.{wanted}" in log else wanted
    found = [p for p in log.paths if p == wanted or p.startswith(f"{wanted}.")]
    if not found:
        measured = _candidate_signals(log)
        near = closest(wanted, measured) or measured
        problem = "there is no such signal in this log"
        raise InputError(f"--signal {wanted}", problem, choices=near, fix=f"--signal {near[0]}")
    found = [p for p in found if _is_noisy(log, p)]
    if not found:
        raise InputError(
            f"--signal {wanted}",
            "holds no numbers that change",
            choices=_candidate_signals(log),
            fix="name one of the choices",
        )
    return found


def _candidate_signals(log: Log) -> list[str]:
    """What sensors measured: the values of samples, or in a log that has none every column; only what changes."""
    sampled = [p for p in log.paths if p.startswith("sensors.") and sample_path(log, p)]
    found = [p for p in sampled or log.paths if _is_noisy(log, p)]
    if not found:
        raise InputError(
            "calibrate noise", "no signal in this log changes", fix="log a sensor with noise, at full resolution"
        )
    return found


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
    found: dict[str, Any] = {"unit": axis.unit, "samples": axis.samples, "duration_s": axis.duration}
    found |= {"period_s": fit.sampling_period, "misfit": fit.misfit}
    for name in ("white", "flicker", "walk"):
        c: Coefficient = getattr(fit, name)
        found[name] = {n: float(getattr(c, n)) for n in ("value", "standard_error", "low", "high")}
    found["noise"] = {n: float(getattr(noise, n)) for n in ("sample_variance", "integral_variance", "bias_variance")}
    curve = {"tau_s": fit.tau, "deviation": fit.deviation, "model": fit.model}
    return found | {name: [float(v) for v in values] for name, values in curve.items()}


def _write_files(
    request: CalibrateRequest, result: dict[str, Any], axes: dict[str, SensorAxis], picture: Path | None
) -> list[Path]:
    written = []
    if request.out is not None:
        from trimtab.logs.mcap import replace_file

        request.out.mkdir(parents=True, exist_ok=True)
        file = request.out / "noise.json"
        with replace_file(file) as stream:
            stream.write(json.dumps(result, indent=1).encode())
        written.append(file)
    if picture is not None:
        from trimtab.plots.allan import plot_allan

        picture.parent.mkdir(parents=True, exist_ok=True)
        fits, units = {n: a.fit for n, a in axes.items()}, {n: a.unit for n, a in axes.items()}
        plot_allan(fits, units, picture, title=f"Allan deviation, {request.log.name}")
        written.append(picture)
    return written
