"""What came of a flight: metrics, last state, flags, and their table. Needs its log alone, and no JAX."""

from collections.abc import Iterable, Mapping
from math import isfinite
from typing import Any

import click
import numpy as np

from trimtab.commands.output import console, format_number, new_table
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, full_path, metrics, mode_switches
from trimtab.loop.beliefs import describe_mismatches

METRICS = {
    "first_reach_s": ("first in band", "s"),
    "settling_s": ("settled", "s"),
    "overshoot": ("overshoot", ""),
    "tail_mean": ("tail mean", ""),
    "tail_rms": ("tail rms", ""),
}
"""Heading and unit of each metric's column; without a unit it has the signal's."""


def summarise_run(log: Log, targets: Iterable[Target]) -> dict[str, Any]:
    """Metrics, last state and mode switches of one run; signals that have a target come with their path."""
    targets = tuple(targets)
    signals = [p.removeprefix("truth.") for p in log.paths if p.startswith("truth.")]
    preferred = ["surge_velocity", "sway_velocity", "yaw_rate", "heading"]
    aimed = [full_path(t.path) for t in targets if not full_path(t.path).startswith("truth.")]
    shown = [f"truth.{s}" for s in preferred if s in signals] or [f"truth.{s}" for s in signals]
    final = {path.removeprefix("truth."): float(value) for path, value in log.final.items()}
    final |= {path: float(log[path][-1]) for path in aimed if len(log)}
    numbers = metrics(log, targets, [*aimed, *shown])
    return {
        "metrics": {path.removeprefix("truth."): n for path, n in numbers.items()},
        "final": {name: value if isfinite(value) else None for name, value in final.items()},
        "mode_switches": mode_switches(log),
        "flags": flag_times(log),
        "lost_s": divergence_time(log),
    }


def flag_times(log: Log) -> dict[str, dict[str, float]]:
    """Flags of law and actuators that were up: for how long, and when first, in s."""
    times: dict[str, dict[str, float]] = {}
    signals = [p for p in log.paths if p.startswith(("law.", "actuators.")) and p in log.declarations]
    for path in [p for p in signals if log.declarations[p].kind == "flag" and log[p].ndim == 1]:
        up = log[path].astype(bool)
        if up.any():
            share = float(up.mean()) * float(log.t[-1] - log.t[0] if len(log) > 1 else 0.0)
            times[path] = {"for_s": round(share, 4), "first_s": float(log.t[up.argmax()])}
    return times


def divergence_time(log: Log) -> float | None:
    """When the truth stopped being finite (s), or None."""
    truth = [log[p] for p in log.paths if p.startswith("truth.")]
    if not truth or not len(log):
        return None
    lost = ~np.isfinite(np.stack([x if x.ndim == 1 else x.sum(axis=1) for x in truth])).all(axis=0)
    return float(log.t[lost.argmax()]) if lost.any() else None


def metric_units(log: Log, names: Iterable[str]) -> dict[str, str]:
    """The unit of each signal that a summary has metrics of, by the summary's name for it."""
    return {name: log.unit(name if name in log else f"truth.{name}") for name in names}


def print_result(result: Mapping[str, Any], units: Mapping[str, str]) -> None:
    """Metrics of a run, ideal beside real."""
    sides = {side: result[side] for side in ("ideal", "real") if result[side] is not None}
    title = f"{result['scenario']}, {result['duration_s']:g} s, seed {result['seed']}"
    columns = [f">{heading} ({unit})" if unit else f">{heading}" for heading, unit in METRICS.values()]
    table = new_table("signal", "", ">final", *columns, title=title, unwrapped=("signal",))
    for signal in next(iter(sides.values()))["metrics"]:
        for i, (side, summary) in enumerate(sides.items()):
            name = f"{signal} ({units[signal]})" if i == 0 else ""
            numbers = [summary["final"].get(signal), *(summary["metrics"][signal][metric] for metric in METRICS)]
            table.add_row(name, side, *map(format_number, numbers), end_section=i == len(sides) - 1)
    console().print(table)
    if result.get("mismatch"):
        click.echo(describe_mismatches(result["mismatch"]))
    switches = ", ".join(f"{side} {summary['mode_switches']}" for side, summary in sides.items())
    click.echo(f"mode switches: {switches}      what the columns mean: docs, Metrics")
    for side, summary in sides.items():
        for path, flag in summary["flags"].items():
            click.echo(f"{path} ({side}): up for {flag['for_s']:.4g} s, first at {flag['first_s']:.4g} s")
        if summary["lost_s"] is not None:
            click.echo(f"LOST ({side}): the state is not finite from {summary['lost_s']:.4g} s on")
