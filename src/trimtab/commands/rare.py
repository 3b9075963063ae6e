"""`trimtab rare`: estimate the probability of a rare failure, and write a scenario file for each of two failures: the
worst failure found, and the likeliest."""

import shlex
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.analysis.campaign.search import rare
from trimtab.analysis.campaign.search.rare import Failure, PilotReport, RareResult
from trimtab.analysis.campaign.search.scenario_file import write_scenario
from trimtab.commands.options import (
    FAULT_RANGE,
    FLIGHT,
    JSON,
    OUT,
    RUNS,
    SCENARIO,
    SEED,
    SPREAD,
    SUCCESS,
    THREADS,
    VARY,
    WITHOUT,
)
from trimtab.commands.output import check_folder, new_table, print_files, print_json, print_table
from trimtab.commands.progress import show_progress
from trimtab.commands.written_files import check_new_in
from trimtab.core.cache_folder import enable_cache

FEW = 20
"""Minimum number of roots (independent initial runs) that led to failures. With fewer, a warning is printed."""


@click.command()
@SCENARIO
@SPREAD
@FAULT_RANGE
@VARY
@SUCCESS
@RUNS(100_000, "Number of runs, approximately.")
@FLIGHT
@WITHOUT
@SEED
@THREADS
@OUT(
    "DIR",
    "Write finished runs, and scenario files of the worst and the likeliest failure, to this folder. The same command "
    "resumes from there.",
)
@JSON
def command(scenario: str, runs: int, out: Path | None, as_json: bool, **options: Any) -> None:
    """Estimate the probability of a rare failure.

    Use this command if a campaign of a few thousand runs finds no failure. The method is multilevel splitting: from
    level to level the margin to failure decreases, while parameters and noise are changed a little. The interval is
    a 95 % confidence interval. With --out the state is stored after each round. The same command resumes from
    there, and a larger --runs adds runs.

    \b
    trimtab rare hovercraft/spin --set duration=3 --spread 'world.vehicle.mass=normal(100%, 5%)' \\
        --success 'peak:yaw_rate <= 3.8' --out rare
    trimtab run rare/worst.py:scenario --seed 0
    """
    if out is not None:
        check_folder("--out", out)
        check_new_in("--out", out, "*.py")
    enable_cache()
    with show_progress(runs) as tell:
        found = rare.estimate_rare(
            scenario,
            runs=runs,
            **options,
            folder=out,
            progress=lambda n: tell("flying", n),
            report=lambda pilot: click.echo(_pilot_line(pilot), err=True),
        )
    again = {} if out is None else _write_failures(scenario, out, options, found)
    files = [] if out is None else [out / rare.STATE, *(out / f"{name}.py" for name in again)]
    if as_json:
        print_json(_rare_json(scenario, options["seed"], found) | ({"replay": again} if again else {}), files)
        return
    _print_result(scenario, found)
    print_files(files)
    for name, line in again.items():
        click.echo(f"repeat the {name} failure:  {line}")


def _pilot_line(pilot: PilotReport) -> str:
    """Describe the estimates from the pilot: the runs that are flown first to choose the levels."""
    of = pilot.ladder
    return (
        f"pilot, {of.flown} runs: {len(of.levels)} levels, probability about {of.estimate:.1e}; {pilot.runs} more runs,"
        f" about {pilot.wall_s:.0f} s, give an interval of about ±{100 * pilot.width:.0f} %;"
        f" a plain campaign would take {plain_runs(of.estimate, pilot.width):.0e} runs"
    )


def plain_runs(probability: float, width: float) -> float:
    """Return the number of runs with which a plain campaign gets an interval of ± `width` times the probability."""
    return 4 / (probability * width**2)


def _write_failures(scenario: str, out: Path, options: dict[str, Any], found: RareResult) -> dict[str, str]:
    """Write a scenario file for the worst failure and one for the likeliest. Return the commands that repeat these."""
    conditions = "; ".join(options["success"]) or "each target is reached and kept"
    commands = {}
    for name, failure in (("worst", found.worst), ("likeliest", found.likeliest)):
        if failure is not None:
            file = out / f"{name}.py"
            again = shlex.join(["trimtab", "run", f"{file}:scenario", "--seed", str(options["seed"])])
            about = (
                f"The {name} failure of {scenario} among {found.flown_runs} runs, with margin {failure.margin:.6g}.\n\n"
                f"Required: {conditions}. To repeat this run:\n\n    {again}"
            )
            write_scenario(file, found.plan, failure.values, about, failure.words)
            commands[name] = again
    return commands


def _failure_json(failure: Failure | None) -> dict[str, Any] | None:
    if failure is None:
        return None
    metrics = {n: bool(v) if isinstance(v, np.bool_) else float(v) for n, v in failure.columns.items()}
    return {
        "margin": failure.margin,
        "values": {path: np.asarray(v).tolist() for path, v in failure.values.items()},
        "z": failure.z.tolist(),
        "words": list(failure.words),
        "metrics": metrics,
    }


def _rare_json(scenario: str, seed: int, found: RareResult) -> dict[str, Any]:
    of = found.probability
    return {
        "scenario": scenario,
        "seed": seed,
        "probability": of.value,
        "low": of.low,
        "high": of.high,
        "level": of.level,
        "flown": found.flown_runs,
        "pilot": {"runs": found.ladder.flown, "probability": found.ladder.estimate},
        "levels": found.ladder.levels.tolist(),
        "survivors": found.survivors.tolist(),
        "taken": found.taken.tolist(),
        "roots": found.roots,
        "failing_roots": found.failing_roots,
        "noise": found.has_noise,
        "worst": _failure_json(found.worst),
        "likeliest": _failure_json(found.likeliest),
        "wall_s": round(found.wall_s, 3),
    }


def _print_result(scenario: str, found: RareResult) -> None:
    of = found.probability
    if not found.failing_roots:
        click.echo(f"{scenario}: no failure was reached from {found.roots} initial runs; use more --runs")
    else:
        interval = f"{of.low:.3g} to {of.high:.3g}, {100 * of.level:.0f} %"
        click.echo(f"{scenario}: fails with probability {of.value:.3g} ({interval})")
    drawn = f"parameters: {len(found.plan.spread)}" + (", and the noise" if found.has_noise else "; no noise")
    click.echo(f"{found.flown_runs} runs flown, {found.new_runs} of them new, in {found.wall_s:.1f} s; varied: {drawn}")
    if 0 < found.failing_roots < FEW:
        click.echo(
            f"initial runs that led to failures: only {found.failing_roots}; the interval may be too narrow; "
            "use more --runs"
        )
    table = new_table(">margin below", ">points", ">share", ">steps accepted")
    before = found.roots
    for k, level in enumerate(found.ladder.levels):
        share = found.survivors[k] / before if before else float("nan")
        taken = f"{100 * found.taken[k]:.0f} %" if k < len(found.taken) else "-"
        table.add_row(f"{level:.4g}", str(found.survivors[k]), f"{share:.3f}", taken)
        before = found.survivors[k] * rare.splitting.SPLIT
    print_table(table)
    if found.likeliest is not None:
        click.echo(f"the likeliest failure, margin {found.likeliest.margin:.4g}{':' if found.likeliest.values else ''}")
        width = max(map(len, found.likeliest.values), default=0)
        for (path, value), z in zip(found.likeliest.values.items(), found.likeliest.z, strict=False):
            click.echo(f"  {path:<{width}}  {np.array2string(np.asarray(value), precision=6)}  ({z:+.1f} sigma)")
