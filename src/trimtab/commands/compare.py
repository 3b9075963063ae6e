"""`trimtab compare`: compare two logs, or a log with a rerun of the logged flight."""

import sys
from pathlib import Path
from typing import Any

import click

from trimtab.commands.flight_summary import summarise_run
from trimtab.commands.foreign_logs import read_any_log
from trimtab.commands.options import FILE, JSON, PLOT
from trimtab.commands.output import (
    check_picture,
    draw_plot,
    format_number,
    new_table,
    print_files,
    print_json,
    print_table,
)
from trimtab.commands.progress import show_spinner
from trimtab.core.cache_folder import enable_cache
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.logs.difference import LogDifference, find_difference
from trimtab.logs.log import Log

SHOWN = 8
"""Maximum number of differing signals that the table and the picture show."""
MERITS = ("tail_mean", "tail_rms")
AGAIN = "flown again"


@click.command()
@click.argument("one", type=FILE, metavar="LOG")
@click.argument("other", type=FILE, metavar="[LOG]", required=False)
@click.option("--scenario", metavar="SCENARIO", help="Scenario to rerun, if it is not in the catalogue.")
@PLOT("Draw the earliest differing signals to this picture.")
@JSON
def command(one: Path, other: Path | None, scenario: str | None, plot: Path | None, as_json: bool) -> None:
    """Find the first difference between two logs.

    With one log, the second log is a rerun of the logged flight. All signals that both logs have are compared, at the
    instants that both logs have, without tolerance. Exit code 1 if they differ.

    \b
    trimtab compare before/run.mcap after/run.mcap --plot both.png
    trimtab compare flight/run.mcap                  rerun with the scenario, seed and settings of the log
    trimtab compare here/run.mcap --scenario my_boat.py:scenario
    """
    check_picture(plot, None)
    if other is not None and scenario is not None:
        raise InputError("--scenario", "applies only to one log, whose flight is rerun", fix="leave --scenario out")
    first = read_any_log(one, None, quiet=as_json)
    second = _fly_again(first, scenario) if other is None else read_any_log(other, None, quiet=as_json)
    names = (str(one), AGAIN if other is None else str(other))
    difference = find_difference(first, second)
    files: list[Path] = []
    if plot is not None and not difference.equal:
        from trimtab.plots.signals import plot_signals

        paths = [signal.path for signal in difference.signals[:SHOWN]]
        title = f"signal that differs first: {paths[0]}"
        logs = dict(zip(names, (first, second), strict=True))
        files = draw_plot(plot, lambda path: plot_signals(logs, paths, path, title=title))
    summaries = [summarise_run(log, ()) for log in (first, second)]
    if as_json:
        print_json(_difference_json(names, difference, summaries), files)
    else:
        _print_difference(names, difference, summaries)
        print_files(files)
    sys.exit(0 if difference.equal else 1)


def _fly_again(log: Log, name: str | None) -> Log:
    """Repeat a logged run with the log's scenario, settings, seed and run number. name: as in `rebuild_scenario`."""
    from trimtab.core.record import replace
    from trimtab.core.time import ms, seconds
    from trimtab.run.simulate import simulate
    from trimtab.scenarios.recorded import rebuild_scenario

    scenario = rebuild_scenario(log, name)
    enable_cache()
    about = log.metadata
    if "duration_s" in about:
        scenario = replace(scenario, duration=seconds(round(about["duration_s"], 7)))
    period = int(log.ticks[1] - log.ticks[0]) if len(log) > 1 else None
    with show_spinner(f"flying {scenario.name} again"):
        return simulate(scenario, seed=about.get("seed", 0), run=about.get("run", 0), log_period=period or ms(1))


def _difference_json(
    names: tuple[str, str], difference: LogDifference, summaries: list[dict[str, Any]]
) -> dict[str, Any]:
    return {
        "logs": list(names),
        "equal": difference.equal,
        "instants": difference.instants,
        "compared": difference.compared,
        "differs": [signal._asdict() for signal in difference.signals],
        "only_in": [list(difference.only_one), list(difference.only_other)],
        "metrics": [{"metrics": s["metrics"], "final": s["final"]} for s in summaries],
    }


def _print_difference(names: tuple[str, str], difference: LogDifference, summaries: list[dict[str, Any]]) -> None:
    of = f"{difference.compared} signals at {difference.instants} instants"
    if difference.equal:
        click.echo(f"identical, bit for bit: {of}")
    else:
        first = difference.signals[0]
        path = show_controls(first.path)
        values = f"{first.one!r} in {names[0]}, {first.other!r} in {names[1]}"
        click.echo(f"DIFFERENT from {first.first_s:.4f} s on: {path} is {values}")
        click.echo(f"numbers that differ: {len(difference.signals)}; compared: {of}")
        table = new_table("signal", ">differs from (s)", ">largest difference", unwrapped=("signal",))
        for signal in difference.signals[:SHOWN]:
            table.add_row(signal.path.replace("[", r"\["), f"{signal.first_s:.4f}", f"{signal.largest:.6g}")
        print_table(table)
        _print_metrics(names, summaries)
    for name, paths in zip(names, (difference.only_one, difference.only_other), strict=True):
        if paths:
            shown = show_controls(", ".join(paths[:SHOWN]))
            click.echo(f"only in {name}: {shown}{', …' if len(paths) > SHOWN else ''}")


def _print_metrics(names: tuple[str, str], summaries: list[dict[str, Any]]) -> None:
    """Print final value, tail mean and tail rms of each signal that both logs have."""
    table = new_table("signal", "log", ">final", ">tail mean", ">tail rms", unwrapped=("signal",))
    for signal in [name for name in summaries[0]["metrics"] if name in summaries[1]["metrics"]]:
        for i, (name, summary) in enumerate(zip(names, summaries, strict=True)):
            merits = [summary["metrics"][signal][merit] for merit in MERITS]
            cells = map(format_number, (summary["final"].get(signal), *merits))
            table.add_row("" if i else signal.replace("[", r"\["), name, *cells, end_section=i == 1)
    print_table(table)
