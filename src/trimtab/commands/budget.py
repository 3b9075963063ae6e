"""`trimtab budget`: error budget, the part of the flight's errors that each imperfection of a scenario causes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from trimtab.commands.options import FLIGHT, JSON, PLOT, RUNS, SCENARIO, SEED
from trimtab.commands.output import check_picture, draw_plot, new_table, print_files, print_json, print_table
from trimtab.commands.progress import show_progress
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.loop.scenario import Scenario
from trimtab.plots.error_budget import plot_error_budget
from trimtab.run.error_budget import ErrorBudget, cost_share, error_budget, flight_set_count
from trimtab.run.program import check_seed
from trimtab.scenarios.build import build


@click.command()
@SCENARIO
@FLIGHT
@click.option(
    "--without",
    multiple=True,
    metavar="IMPERFECTION",
    help="Switch one imperfection off in all runs. May be repeated.",
)
@click.option(
    "--only",
    multiple=True,
    metavar="IMPERFECTION",
    help="Restrict the budget to this imperfection. May be repeated.  [default: all]",
)
@RUNS(20, "Number of flights for each combination of imperfections.")
@SEED
@PLOT("Draw the errors caused by each imperfection to this picture file.")
@JSON
def command(
    scenario: str,
    settings: dict[str, str],
    without: tuple[str, ...],
    faults: tuple[str, ...],
    only: tuple[str, ...],
    runs: int,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Compute the errors that each imperfection causes.

    Flies the same flights with all imperfections, with all except one, with only one, and with none. Reports the
    deviation from the targets and the navigation error in the second half of the flight. With --navigation ins there
    are two dozen imperfections, and the first run takes some minutes. Use --only to select a few imperfections.

    \b
    trimtab budget hovercraft/forward
    trimtab budget hovercraft/zero-velocity --navigation ins --runs 40 --plot budget.png
    trimtab budget hovercraft/spin --only navigation-error --only uplink-delay --json
    """
    check_seed(seed)
    built = build(scenario, settings, without, faults)
    _check_only(built, only)
    check_picture(plot, None)
    enable_cache()
    with show_progress(flight_set_count(built, only)) as tell:
        tell("compiling", 0)
        budget = error_budget(built, seeds=range(seed, seed + runs), names=only, tell=lambda label: tell(label, 1))
    files = draw_plot(plot, plot_error_budget, budget, title=built.name)
    if as_json:
        print_json({"scenario": scenario, "seed": seed, "runs": runs} | _budget_json(budget), files)
        return
    _print_budget(f"{scenario}, {runs} runs from seed {seed}", budget)
    print_files(files)


def _check_only(scenario: Scenario, only: tuple[str, ...]) -> None:
    """Raise InputError for an imperfection that the scenario does not have or that is switched off."""
    known = scenario.imperfections()
    for name in only:
        if name not in known:
            problem = f"scenario {scenario.name!r} has no imperfection {name!r}"
            fix = f"--only {next(iter(known))}, or leave --only out for all" if known else "leave --only out"
            raise InputError("--only", problem, choices=known, fix=fix)


def _budget_json(budget: ErrorBudget) -> dict[str, Any]:
    def numbers(measured: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
        return {m: {"rms": rms, "standard_error": error} for m, (rms, error) in measured.items()}

    costs = [
        {
            "imperfection": cost.name,
            "share": {m: cost_share(budget, cost, m) for m in budget.units},
            "without": numbers(cost.without),
            "alone": numbers(cost.alone),
        }
        for cost in budget.costs
    ]
    ends = {"all": numbers(budget.whole), "none": numbers(budget.least)}
    return {"units": dict(budget.units)} | ends | {"costs": costs}


def _print_budget(title: str, budget: ErrorBudget) -> None:
    """Print the rms errors caused by each imperfection alone, and its share in the mean square errors."""
    measures = list(budget.units)
    first, names = "imperfection", {m: m.replace("_", " ") for m in measures}
    headings = [f">{name} ({budget.units[m]})" for m, name in names.items()]
    table = new_table(first, *headings, title=f"{title}: rms over the second half of each flight", unwrapped=(first,))
    for name, row in (("all", budget.whole), ("none", budget.least)):
        table.add_row(name, *(_format_rms(*row[m]) for m in measures), end_section=name == "none")
    for cost in budget.costs:
        table.add_row(f"{cost.name} alone", *(_format_rms(*cost.alone[m]) for m in measures))
    print_table(table)
    about = "Reduction of the mean square error when the imperfection is switched off"
    table = new_table(first, *(f">{name}" for name in names.values()), title=about, unwrapped=(first,))
    for cost in budget.costs:
        table.add_row(cost.name, *(f"{100 * cost_share(budget, cost, m):.1f} %" for m in measures))
    print_table(table)
    click.echo("±: one standard error. The shares need not add up to 100 % (docs, Error budget)")


def _format_rms(value: float, error: float) -> str:
    return f"{value:.3g} ± {error:.1g}" if 0 < value < 1e-3 else f"{value:.4f} ± {error:.4f}"
