"""`trimtab tune`: tune gains, and validate them in runs that were not used for tuning."""

import math
import shlex
import sys
from pathlib import Path
from typing import Any

import click

from trimtab.analysis.campaign.search import tune as search
from trimtab.analysis.campaign.search.comparison import Comparison
from trimtab.analysis.campaign.search.scenario_file import check_file, write_scenario
from trimtab.analysis.campaign.search.tune import TuningResult
from trimtab.commands.kept_flights import keep_flights
from trimtab.commands.options import (
    FLIGHT,
    JSON,
    OUT,
    PLOT,
    RUNS,
    SCENARIO,
    SEED,
    SPREAD,
    STORE,
    THREADS,
    WITHOUT,
    FiniteRange,
)
from trimtab.commands.output import check_out, check_picture, draw_plot, print_files, print_json
from trimtab.commands.progress import show_progress
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.scenarios.build import build


def parse_gains(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse the texts PATH=LOW:HIGH of --gain into a mapping."""
    gains = {}
    for text in values:
        path, equals, span = text.partition("=")
        if not equals or not path.strip():
            raise InputError("--gain", f"{text!r} is not PATH=LOW:HIGH", fix="--gain autopilot.law.k1=0.5:3")
        gains[path.strip()] = span
    return gains


@click.command()
@SCENARIO
@click.option(
    "--gain",
    "gains",
    multiple=True,
    required=True,
    callback=parse_gains,
    metavar="PATH=LOW:HIGH",
    help="Gain to tune, with the search range. May be repeated.",
)
@click.option(
    "--cost",
    metavar="TEXT",
    help="Cost to minimise: mean of a metric.  [default: rms errors relative to the target bands]",
)
@click.option(
    "--method",
    type=click.Choice(("search", "gradient")),
    default="search",
    show_default=True,
    help="Method: search (for any cost), or gradient (for a cost that is an integral over the run).",
)
@RUNS(64, "Number of runs for tuning.", least=2)
@click.option(
    "--judge-runs",
    type=click.IntRange(2),
    default=256,
    show_default=True,
    help="Number of additional runs, in which the tuned gains are validated.",
)
@click.option(
    "--iterations",
    type=click.IntRange(1),
    default=30,
    show_default=True,
    help="Number of generations of the search, or number of gradient steps.",
)
@click.option(
    "--width",
    type=FiniteRange(),
    default=0.05,
    show_default=True,
    help="With --method gradient: width of the smoothing, as a fraction of a gain's range.",
)
@SPREAD
@FLIGHT
@WITHOUT
@SEED
@THREADS
@STORE
@OUT("FILE", "Write a scenario file with the tuned gains, e.g. tuned.py.")
@PLOT("Draw the progress of the tuning to this picture.")
@JSON
def command(
    scenario: str, cost: str | None, method: str, out: Path | None, plot: Path | None, as_json: bool, **options: Any
) -> None:
    """Tune gains over many runs, and validate them in other runs.

    If the validation does not show an improvement, nothing is written, and the exit code is 1.

    \b
    trimtab tune hovercraft/zero-velocity --gain autopilot.law.k1=0.5:3 --gain autopilot.law.k2=1:5 --out tuned.py
    trimtab run tuned.py:scenario
    trimtab tune hovercraft/zero-velocity --gain autopilot.law.k2=1:5 --method gradient
    """
    check_picture(plot, None)
    if out is not None:
        check_file("--out", out)
        check_out("--out", out)
    enable_cache()
    cost = cost or _band_errors(scenario, options)
    options["held_out"] = options.pop("judge_runs")
    each = len(options["gains"]) if method == "gradient" else 8
    total = options["runs"] * options["iterations"] * each + 2 * (options["runs"] + options["held_out"])
    with show_progress(total) as tell, keep_flights(scenario, options.pop("store")) as folder:
        tell("compiling", 0)
        tuning = search.tune(
            scenario, cost=cost, method=method, **options, store=folder, progress=lambda n: tell("tuning", n)
        )
    files = []
    fly_it = "" if out is None else shlex.join(["trimtab", "run", f"{out}:scenario"])
    if out is not None and tuning.is_improvement:
        _write_tuning(out, scenario, cost, tuning, fly_it)
        files.append(out)
    if plot is not None:
        from trimtab.plots.search import plot_tune

        files += draw_plot(plot, plot_tune, tuning, title=f"{scenario}, {cost}")
    if as_json:
        print_json({"scenario": scenario, "method": method, "cost": cost} | _tuning_json(tuning), files)
    else:
        _print_tuning(f"{scenario}, {cost}", tuning)
        print_files(files)
        if out is not None:
            click.echo(f"fly it:  {fly_it}" if tuning.is_improvement else f"not written: {out}")
    sys.exit(0 if tuning.is_improvement else 1)


def _band_errors(scenario: str, options: dict[str, Any]) -> str:
    """Return the default cost: the rms error of each target, relative to its band."""
    targets = build(scenario, options["settings"], options["without"], options["faults"]).targets
    if not targets:
        fix = "--cost 'rms:truth.SIGNAL', or another metric to minimise"
        raise InputError("--cost", f"scenario {scenario!r} has no targets for the default cost", fix=fix)
    return " + ".join(f"{1 / target.band:.4g}*error_rms:{target.path}" for target in targets)


def _write_tuning(file: Path, scenario: str, cost: str, tuning: TuningResult, fly_it: str) -> None:
    c = tuning.held_out_comparison
    gains = "\n".join(f"    {n} = {v!r}, was {tuning.before[n]!r}" for n, v in tuning.after.items())
    worth = f"{c.before:.6g} before, {c.after:.6g} after (mean of {c.runs} runs not used for tuning)"
    about = f"{scenario}, tuned.\n\nCost: {cost}: {worth}.\nGains:\n\n{gains}\n\nTo fly it:\n\n    {fly_it}"
    write_scenario(file, tuning.plan, tuning.values, about)


def _tuning_json(tuning: TuningResult) -> dict[str, Any]:
    return {
        "helps": tuning.is_improvement,
        "before": tuning.before,
        "after": tuning.after,
        "at_bounds": list(tuning.at_bounds),
        "seen": tuning.seen_comparison._asdict(),
        "held_out": tuning.held_out_comparison._asdict(),
        "flown": tuning.flown_runs,
        "wall_s": round(tuning.wall_s, 3),
    }


def _print_tuning(title: str, tuning: TuningResult) -> None:
    verdict = "improved" if tuning.is_improvement else "no significant improvement in the validation runs"
    click.echo(f"{title}, {tuning.method}: {verdict}")
    width = max(map(len, tuning.before))
    for name, value in tuning.before.items():
        at = "  at the limit of its range: try a wider range" if name in tuning.at_bounds else ""
        click.echo(f"  {name:<{width}}  {value:.6g} -> {tuning.after[name]:.6g}{at}")
    for name, c in (("training", tuning.seen_comparison), ("validation", tuning.held_out_comparison)):
        click.echo(f"{name}, {c.runs} runs: {_format_comparison(c)}")
    click.echo(f"{tuning.flown_runs} runs flown in {tuning.wall_s:.1f} s")


def _format_comparison(c: Comparison) -> str:
    counts = f"better in {c.better} runs, worse in {c.worse}"
    if not math.isfinite(c.difference):
        return f"cost infinite in some runs; {counts}"
    interval = f"{100 * c.level:.0f} %: {c.low:.4g} … {c.high:.4g}"
    return f"{c.before:.5g} -> {c.after:.5g}, change {c.difference:.4g} ({interval}); {counts}"
