"""`trimtab falsify`: search for the worst run within given bounds, and write a scenario file that repeats this run."""

import shlex
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.analysis.campaign.search import falsify as search
from trimtab.analysis.campaign.search.falsify import FalsificationResult
from trimtab.analysis.campaign.search.scenario_file import check_file, write_scenario
from trimtab.commands.kept_flights import keep_flights
from trimtab.commands.options import (
    FAULT_RANGE,
    FLIGHT,
    JSON,
    OUT,
    PLOT,
    RUNS,
    SCENARIO,
    SEED,
    SPREAD,
    STORE,
    SUCCESS,
    THREADS,
    VARY,
    WITHOUT,
)
from trimtab.commands.output import check_out, check_picture, draw_plot, print_files, print_json
from trimtab.commands.progress import show_progress
from trimtab.core.cache_folder import enable_cache


@click.command()
@SCENARIO
@SPREAD
@FAULT_RANGE
@VARY
@SUCCESS
@RUNS(5000, "Number of runs, at most.")
@click.option(
    "--words",
    type=click.IntRange(1),
    default=4,
    show_default=True,
    help="Number of runs per candidate, each with different random numbers.",
)
@click.option(
    "--over",
    type=click.Choice(("worst", "mean")),
    default="worst",
    show_default=True,
    help="Judge a candidate by the worst or by the mean margin of its runs.",
)
@click.option("--until-first", is_flag=True, help="Stop at the first failure.")
@FLIGHT
@WITHOUT
@SEED
@THREADS
@STORE
@OUT("FILE", "Write a scenario file that repeats the worst run, e.g. worst.py.")
@PLOT("Draw the search to this picture.")
@JSON
def command(
    scenario: str, runs: int, store: Path | None, out: Path | None, plot: Path | None, as_json: bool, **options: Any
) -> None:
    """Find the parameters with which a scenario performs worst.

    The search stays within the limits of the given distributions. Exit code 1 if a failure was found, 0 if none was
    found. A search without a failure does not prove that the scenario never fails.

    \b
    trimtab falsify hovercraft/zero-velocity --spread 'world.vehicle.mass=uniform(80%, 120%)' \\
        --spread 'autopilot.law.k2=uniform(50%, 200%)' --success 'error_rms:yaw_rate <= 0.5' --out worst.py
    trimtab run worst.py:scenario --seed 0 --run 133
    """
    check_picture(plot, None)
    if out is not None:
        check_file("--out", out)
        check_out("--out", out)
    enable_cache()
    with show_progress(runs) as tell, keep_flights(scenario, store) as folder:
        tell("compiling", 0)
        worst = search.falsify(scenario, runs=runs, **options, store=folder, progress=lambda n: tell("searching", n))
    files = [file for file in (out, plot) if file is not None]
    again = "" if out is None else _replay_command(out, options["seed"], worst)
    if out is not None:
        conditions = "; ".join(options["success"]) or "each target is reached and kept"
        about = (
            f"The worst run of {scenario} that a search found, with margin {worst.margin:.6g}.\n\n"
            f"Required: {conditions}.\n{worst.flown_runs} runs were flown. To repeat this run:\n\n    {again}"
        )
        write_scenario(out, worst.plan, worst.values, about)
    if plot is not None:
        from trimtab.plots.search import plot_falsify

        draw_plot(plot, plot_falsify, worst, title=scenario)
    if as_json:
        settings = {name: options[name] for name in ("seed", "over", "words")}
        print_json(_worst_json(scenario, settings, worst) | ({"replay": again} if again else {}), files)
    else:
        _print_worst(scenario, worst)
        print_files(files)
        if again:
            click.echo(f"repeat it:  {again}")
    sys.exit(1 if worst.fails else 0)


def _replay_command(file: Path, seed: int, worst: FalsificationResult) -> str:
    """Return the command that repeats the worst run."""
    return shlex.join(["trimtab", "run", f"{file}:scenario", "--seed", str(seed), "--run", str(worst.word)])


def _worst_json(scenario: str, settings: dict[str, Any], worst: FalsificationResult) -> dict[str, Any]:
    metrics = {n: bool(v) if isinstance(v, bool | np.bool_) else float(v) for n, v in worst.columns.items()}
    return {
        "scenario": scenario,
        "failed": worst.fails,
        "margin": worst.margin,
        "values": {path: np.asarray(v).tolist() for path, v in worst.values.items()},
        "seed": settings["seed"],
        "run": worst.word,
        "metrics": metrics,
        "flown": worst.flown_runs,
        "first_failure_after": worst.first,
        "over": settings["over"],
        "words": settings["words"],
        "wall_s": round(worst.wall_s, 3),
    }


def _print_worst(scenario: str, worst: FalsificationResult) -> None:
    after = f"{worst.first} run{'s' * (worst.first != 1)}"
    verdict = (
        f"FAILS, first failure after {after}" if worst.fails else "no failure found, which is not a proof of safety"
    )
    click.echo(f"{scenario}: {verdict}")
    click.echo(f"margin of the worst run: {worst.margin:.6g}; {worst.flown_runs} runs flown in {worst.wall_s:.1f} s")
    width = max(map(len, worst.values))
    for path, value in worst.values.items():
        click.echo(f"  {path:<{width}}  {np.array2string(np.asarray(value), precision=8)}")
    for name, value in worst.columns.items():
        if name not in ("margin", "success", "lost"):
            click.echo(f"  {name:<{width}}  {float(value):.6g}")
