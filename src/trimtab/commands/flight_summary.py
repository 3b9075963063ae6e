"""Summary of a flight, computed from the log without JAX: metrics, last state and flags, and a table of these."""

from collections.abc import Iterable, Mapping
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.output import format_number, new_table, print_table
from trimtab.core.errors import InputError
from trimtab.core.quantity import component_paths
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.log_limit import list_files
from trimtab.logs.metrics import Target, full_path, metrics, mode_switches, nearest_target_value
from trimtab.logs.robustness import PENDING, VERDICTS, VIOLATED
from trimtab.logs.spatial import FLIGHT, display_unit, flight_sources, with_flight
from trimtab.loop.model_mismatch import describe_mismatches

ERROR = "world.integration_error"
MOTIONS = ("velocity", "rate", "speed", "velocity[0]", "velocity[1]", "velocity[2]")
"""Last parts of the paths of signals that are zero when the vehicle is at rest."""
FEW = 6
"""Maximum number of elements of a signal in the summary. Larger signals, e.g. of a large swarm, are left out."""
MOST_SUMMARISED = 200_000_000
"""Maximum size (bytes) of a log whose metrics are computed: about 15 minutes of flight."""
METRICS = {
    "first_reach_s": ("first in band", "s"),
    "settling_s": ("settled", "s"),
    "overshoot": ("overshoot", ""),
    "tail_mean": ("tail mean", ""),
    "tail_rms": ("tail rms", ""),
}
"""Metric -> heading and unit of the table column. An empty unit means that the metric has the unit of the signal."""


def summarise_truth(
    file: Path | None, release: int | None, targets: Iterable[Target], end: int | None = None
) -> dict[str, Any]:
    """Return the summary of a vehicle's log under the key "real". The summary is None without a log or for a large log.

    release, end: start and end of the summarised interval, in units of 100 ns.
    """
    whole = None if release is None else _read_flight_log(file)
    if whole is None or release is None:
        return {"real": None}
    goes_on = np.zeros(len(whole), bool) if end is None else whole.ticks > end
    flown = (whole.ticks >= release) & ~goes_on
    if not flown.any():
        return {"real": None}
    ticks = whole.ticks[flown] - release
    signals = {p: v[flown] for p, v in whole.signals.items()}
    final = {p: signals[p][-1] for p in whole.final if p in signals} if goes_on.any() else whole.final
    log = Log(to_seconds(ticks), ticks, signals, whole.declarations, whole.metadata, final)
    real = summarise_run(log, targets)
    return {"real": real, "units": metric_units(log, real["metrics"])}


def _read_flight_log(file: Path | None) -> Log | None:
    """Read the log of a live flight. Return None without a log, or if the log is too large."""
    if file is None or list_files(file) != [file] or file.stat().st_size > MOST_SUMMARISED:
        return None
    from trimtab.commands.foreign_logs import read_own_log  # imports JAX, which `run` may not need

    return read_own_log(file)


def assess_estimate(file: Path | None, release: int | None, targets: Iterable[Target]) -> dict[str, Any] | str:
    """Compare a live flight with its targets, by the autopilot's estimates. `assess_targets` does so by the true state.

    Return the verdict, or a text that says why the flight cannot be assessed.

    Args:
        file: log of the autopilot.
        release: time of arming, in units of 100 ns.
        targets: the scenario's targets.
    """
    targets = tuple(targets)
    if release is None:
        return "the autopilot did not arm"
    if not targets:
        return "the scenario has no targets"
    if file is None:
        return "no log was written; to write one: --out DIR"
    try:
        whole = _read_flight_log(file)
    except InputError:  # a full disk may leave a log without rows
        return "the log has no rows"
    if whole is None:
        return "the log is too large or consists of several files"
    flown = whole.ticks >= release
    signals, declared = {}, {}
    for path in (full_path(t.path) for t in targets):
        own = path if path in whole else f"estimate.state.{path.removeprefix('truth.')}"
        if own not in whole:
            return f"the autopilot does not estimate {path.removeprefix('truth.')}"
        signals[path], declared[path] = whole[own][flown], whole.declaration(own)
    ticks = whole.ticks[flown] - release
    declarations = {path: found for path, found in declared.items() if found is not None}
    verdict = assess_targets(Log(to_seconds(ticks), ticks, signals, declarations, whole.metadata), targets)
    return verdict or "the log ends before the autopilot armed"


def print_truth(result: dict[str, Any], out: Path | None, never: str) -> None:
    """Print the result of `summarise_truth`. never: text to print if the vehicle was never released for flight."""
    if result["real"] is None and result.get("released_s", 0) is None:
        click.echo(never)
    elif result["real"] is None:
        why = "the log consists of several files, is too large, or has no row of the flight"
        click.echo(f"no metrics: {'no log was written' if out is None else why}")
    else:
        print_result(result, result["units"])


def summarise_run(log: Log, targets: Iterable[Target]) -> dict[str, Any]:
    """Return metrics, last state, number of mode switches and warnings of one run.

    Targets whose signal the log lacks are left out: the log of a vehicle has no signals of the autopilot, and the ideal
    twin has no sensors.
    """
    log = with_flight(log)
    targets = [t for t in targets if full_path(t.path) in log]
    shown = _choose_signals(log)
    final = {
        one.removeprefix("truth."): float(number)
        for path, value in log.final.items()
        if path.startswith(("truth.", FLIGHT)) and np.size(value) <= FEW
        for one, number in zip(component_paths(path, np.shape(value)), np.ravel(value), strict=True)
    }
    aimed = [path for t in targets if (path := full_path(t.path)) not in shown]
    final |= {path: float(log[path][-1]) for path in aimed if len(log) and path.removeprefix("truth.") not in final}
    numbers = metrics(log, targets, [*aimed, *shown])
    closest = closest_approach(log)
    return {
        "metrics": {path.removeprefix("truth."): n for path, n in numbers.items()},
        "final": {name: value if isfinite(value) else None for name, value in final.items()},
        "mode_switches": mode_switches(log),
        "flags": flag_times(log),
        "integration": worst_step(log),
        "lost_s": divergence_time(log),
        **({"not_finite": broken} if (broken := non_finite_times(log)) else {}),
        **({"verdict": verdict} if (verdict := assess_targets(log, targets)) else {}),
        **({"monitor": monitored} if (monitored := summarise_monitor(log)) else {}),
        **({"closest": closest} if closest else {}),
        **({"flight": flight} if (flight := summarise_flight(log, targets)) else {}),
    }


def assess_targets(log: Log, targets: Iterable[Target]) -> dict[str, Any] | None:
    """Return a dict with "on_target" (True if the flight ended on all targets) and "says" (the verdict in words).

    Return None for a scenario without targets. A diverged flight is never on target.
    """
    targets, lost = tuple(targets), divergence_time(log)
    if lost is not None:
        return {"on_target": False, "says": f"LOST: the state is not finite from {lost:.4g} s on"}
    if not targets or not len(log):
        return None
    times = [m["settling_s"] for m in metrics(log, targets, [full_path(t.path) for t in targets]).values()]
    at_rest = all(t.value == 0 and full_path(t.path).endswith(MOTIONS) for t in targets)
    what = "at rest" if at_rest else "on target"
    reached = [time for time in times if time is not None]
    if len(reached) == len(times):
        return {"on_target": True, "says": f"{what} after {max(reached):.3g} s"}
    missed = [_describe_miss(log, t) for t, time in zip(targets, times, strict=True) if time is None]
    return {"on_target": False, "says": f"not {what}: {'; '.join(missed)}"}


def _describe_miss(log: Log, target: Target) -> str:
    """Describe the final value of a signal that misses its target, and the target band."""
    path = full_path(target.path)
    unit, factor = display_unit(path, log.unit(path))
    value, wanted = float(log[path][-1]) * factor, nearest_target_value(log, target) * factor
    unit = "" if unit in ("", "1") else f" {unit}"
    is_inside = abs(value - wanted) <= target.band * factor
    ends = f"{path.removeprefix('truth.')} ended at {value:.3g}{unit}" + (
        " but did not stay in the band" if is_inside else ""
    )
    return f"{ends}, target {wanted:.3g} ± {target.band * factor:.3g}"


def _choose_signals(log: Log) -> list[str]:
    """Return the signals to show in addition to those with targets. Angles are shown in place of a quaternion."""
    signals = [p.removeprefix("truth.") for p in log.paths if p.startswith("truth.") and np.size(log[p][:1]) <= FEW]
    flight, said = [p for p in log.paths if p.startswith(FLIGHT)], flight_sources(log)
    preferred = ["surge_velocity", "sway_velocity", "yaw_rate", "heading"]
    if not flight and (shown := [n for s in preferred if s in signals for n in log.numbers(f"truth.{s}")]):
        return shown
    rest = [n for s in signals if f"truth.{s}" not in said for n in log.numbers(f"truth.{s}")]
    return flight + rest


def summarise_flight(log: Log, targets: Iterable[Target]) -> dict[str, Any] | None:
    """Return minimum and maximum height (m), maximum ground speed (m/s) and maximum tilt (rad) of a flight.

    Tilt is the angle between the vehicle's vertical axis and the vertical. settled_s is the settling time of each
    target. Return None for a vehicle without roll and pitch. Unknown values are left out.
    """
    if f"{FLIGHT}roll" not in log or not len(log):
        return None
    tilt = np.arccos(np.clip(np.cos(log[f"{FLIGHT}roll"]) * np.cos(log[f"{FLIGHT}pitch"]), -1, 1))
    found = {"greatest_tilt_rad": _greatest(tilt)}
    if f"{FLIGHT}altitude" in log:
        height = log[f"{FLIGHT}altitude"]
        found |= {"lowest_m": -_greatest(-height), "highest_m": _greatest(height)}
    if f"{FLIGHT}ground_speed" in log:
        found["fastest_m_s"] = _greatest(log[f"{FLIGHT}ground_speed"])
    aimed = [full_path(t.path) for t in targets]
    settled = {p.removeprefix("truth."): m["settling_s"] for p, m in metrics(log, targets, aimed).items()}
    return {name: value for name, value in found.items() if isfinite(value)} | {"settled_s": settled}


def _greatest(x: Any) -> float:
    return float(np.max(x[np.isfinite(x)], initial=-np.inf))


def closest_approach(log: Log) -> dict[str, float] | None:
    """Return the smallest distance (m) between two craft of a swarm and its time (s); None without a spacing sensor."""
    path = next((p for p in log.paths if p.startswith("sensors.") and p.endswith(".spacing")), None)
    if path is None or not len(log):
        return None
    nearest = int(np.argmin(log[path]))
    return {"distance_m": float(log[path][nearest]), "at_s": float(log.t[nearest])}


def flag_times(log: Log) -> dict[str, dict[str, float]]:
    """Return for each flag of law, actuators or integration: total time (s) of being True, and first such time (s)."""
    times: dict[str, dict[str, float]] = {}
    signals = [p for p in log.paths if p.startswith(("law.", "actuators.", "world.")) and p in log.declarations]
    for path in [p for p in signals if log.declarations[p].kind == "flag" and log[p].ndim == 1]:
        up = log[path].astype(bool)
        if up.any():
            share = float(up.mean()) * float(log.t[-1] - log.t[0] if len(log) > 1 else 0.0)
            times[path] = {"for_s": round(share, 4), "first_s": float(log.t[up.argmax()])}
    return times


def worst_step(log: Log) -> dict[str, float | None] | None:
    """Return the largest ratio of an integration step's error to the tolerance, and the first time (s) above 1.

    Return None if the integration method does not estimate the error.
    """
    if ERROR not in log:
        return None
    errors = np.append(log[ERROR], log.final.get(ERROR, 0.0))  # a row contains the error of the step that led to it
    too_large = ~(errors <= 1)
    first = float(np.append(log.t, log.metadata.get("duration_s", np.nan))[too_large.argmax()])
    return {"worst": float(errors.max()), "first_s": first if too_large.any() else None}


def summarise_monitor(log: Log) -> dict[str, dict[str, Any]]:
    """Return for each monitored formula: final verdict, minimum robustness, and time of the first violation (s)."""
    found: dict[str, dict[str, Any]] = {}
    for path in [p for p in log.paths if p.startswith("monitor.") and p.endswith(".verdict") and len(log)]:
        name, verdict = path.split(".")[1], log[path]
        known, broken = log[f"monitor.{name}.robustness"][verdict != PENDING], verdict == VIOLATED
        found[name] = {
            "verdict": VERDICTS[int(verdict[-1])],
            "least_robustness": float(known.min()) if len(known) else None,
            "violated_s": float(log.t[broken.argmax()]) if broken.any() else None,
        }
    return found


def non_finite_times(log: Log) -> dict[str, float]:
    """Return the demands and commands that are not finite although the estimate is valid, with first times (s)."""
    shown = log["estimate.valid"].astype(bool) if "estimate.valid" in log else np.ones(len(log), bool)
    times: dict[str, float] = {}
    for path in [p for p in log.paths if p.startswith(("law.demand", "command.value"))]:
        value = log[path]
        broken = shown & ~np.isfinite(value.reshape(len(value), -1).astype(float)).all(axis=1)
        if broken.any():
            times[path] = float(log.t[broken.argmax()])
    return times


def divergence_time(log: Log) -> float | None:
    """Return the time (s) at which the truth stopped being finite, or None if it stayed finite."""
    truth = [log[p] for p in log.paths if p.startswith("truth.")]
    if not truth or not len(log):
        return None
    lost = ~np.isfinite(np.stack([x if x.ndim == 1 else x.sum(axis=1) for x in truth])).all(axis=0)
    return float(log.t[lost.argmax()]) if lost.any() else None


def metric_units(log: Log, names: Iterable[str]) -> dict[str, str]:
    """Return signal -> unit. Signals are named as in a summary, without the prefix "truth."."""
    log = with_flight(log)
    return {name: log.unit(name if name in log else f"truth.{name}") for name in names}


def _scale(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _describe_flight(summary: Mapping[str, Any]) -> str:
    """Describe height, speed, tilt and settling of a flight in one line."""
    flight, said = summary["flight"], list[str]()
    if "lowest_m" in flight:
        low, high = flight["lowest_m"], flight["highest_m"]
        said.append(f"{low:.4g} to {high:.4g} m high" if high >= 0 else f"{-high:.4g} to {-low:.4g} m deep")
    if "fastest_m_s" in flight:
        said.append(f"up to {flight['fastest_m_s']:.3g} m/s over the ground")
    if "greatest_tilt_rad" in flight:
        said.append(f"tilted by up to {degrees(flight['greatest_tilt_rad']):.3g} deg")
    times = flight["settled_s"]
    missed = [name for name, at in times.items() if at is None]
    if missed:
        said.append(f"NOT settled: {', '.join(missed)}")
    elif times:
        of = "its target" if len(times) == 1 else f"all {len(times)} targets"
        said.append(f"settled on {of} from {max(times.values()):.4g} s onwards")
    return ", ".join(said)


def print_result(result: Mapping[str, Any], units: Mapping[str, str]) -> None:
    """Print the metrics of the ideal and of the real run."""
    sides = {side: result[side] for side in ("ideal", "real") if result[side] is not None}
    for side in [one for one in ("real", "ideal") if "verdict" in sides.get(one, {})]:
        click.echo(f"{f'{side}:':<7}{sides[side]['verdict']['says']}")
    title = f"{result['scenario']}, {result['duration_s']:g} s, seed {result['seed']}"
    columns = [f">{heading} ({unit})" if unit else f">{heading}" for heading, unit in METRICS.values()]
    table = new_table("signal", "", ">final", *columns, title=title, unwrapped=("signal",))
    for signal in dict.fromkeys(signal for summary in sides.values() for signal in summary["metrics"]):
        having = {side: summary for side, summary in sides.items() if signal in summary["metrics"]}
        for i, (side, summary) in enumerate(having.items()):
            unit, factor = display_unit(signal, units[signal])
            name = f"{signal} ({unit})" if i == 0 else ""
            merits = summary["metrics"][signal]
            numbers = [_scale(summary["final"].get(signal), factor)]
            numbers += [_scale(merits[metric], 1.0 if METRICS[metric][1] else factor) for metric in METRICS]
            table.add_row(name, side, *map(format_number, numbers), end_section=i == len(having) - 1)
    print_table(table)
    if result.get("mismatch"):
        click.echo(describe_mismatches(result["mismatch"]))
    switches = ", ".join(f"{side} {summary['mode_switches']}" for side, summary in sides.items())
    click.echo(f"mode switches of the law: {switches}      columns: see docs, Metrics")
    for side, summary in sides.items():
        for path, flag in summary["flags"].items():
            click.echo(f"{path} ({side}): true for {flag['for_s']:.4g} s, first at {flag['first_s']:.4g} s")
        step = summary.get("integration")
        if step is not None and step["first_s"] is not None:
            size, first = f"up to {step['worst']:.3g} times the tolerance", f"first at {step['first_s']:.4g} s"
            click.echo(
                f"INTEGRATION ({side}): the estimated error of a step is {size}, {first}. Do not trust the results."
            )
            click.echo("  Fix: a shorter --set world.max_step=…, or --set world.integration.method=rosenbrock or =rk45")
        for name, said in summary.get("monitor", {}).items():
            least, first = said["least_robustness"], said["violated_s"]
            number = "" if least is None else f", least robustness {format_number(least)}"
            begin = "" if first is None else f", first violated at {first:.4g} s"
            click.echo(f"monitor {name} ({side}): {said['verdict']} at the end{number}{begin}")
        for path, first in summary.get("not_finite", {}).items():
            click.echo(f"NOT FINITE ({side}): {path}, first at {first:.4g} s; the command is invalid at that time")
        if "flight" in summary:
            click.echo(f"flight ({side}): {_describe_flight(summary)}")
        if "closest" in summary:
            distance, at = summary["closest"].values()
            click.echo(f"closest ({side}): two craft are only {distance:.3g} m apart at {at:.4g} s")
        if summary["lost_s"] is not None:
            click.echo(f"LOST ({side}): the state is not finite from {summary['lost_s']:.4g} s on")
