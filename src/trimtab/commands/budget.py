"""`trimtab budget`: what each imperfection of a scenario costs."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from trimtab.core.errors import InputError

if TYPE_CHECKING:
    from trimtab.loop.scenario import Scenario
    from trimtab.run.error_budget import ErrorBudget


class BudgetRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    runs: int = 20
    seed: int = 0
    plot: Path | None = None
    as_json: bool = False


def budget(request: BudgetRequest) -> None:
    """Everything is checked before anything runs."""
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import RunRequest as Flight
    from trimtab.commands.fly_scenario import build_from_request, check_picture
    from trimtab.commands.progress import show_progress
    from trimtab.run.error_budget import error_budget, flight_set_count
    from trimtab.run.program import check_seed

    check_seed(request.seed)
    scenario = build_from_request(Flight(request.scenario, request.settings, request.without))
    _check_only(scenario, request.only)
    check_picture(request.plot, None)
    enable_cache()
    seeds = range(request.seed, request.seed + request.runs)
    with show_progress(flight_set_count(scenario, request.only)) as tell:
        tell("compiling", 0)
        found = error_budget(scenario, seeds=seeds, names=request.only, tell=lambda label: tell(label, 1))
    written = _draw_budget(found, scenario.name, request.plot)
    if request.as_json:
        click.echo(json.dumps(_result_json(request, found) | ({"files": written} if written else {}), allow_nan=False))
        return
    from trimtab.commands.tables import print_budget

    print_budget(f"{scenario.name}, {request.runs} runs from seed {request.seed}", found)
    for file in written:
        click.echo(f"wrote {file}")


def _check_only(scenario: "Scenario", only: tuple[str, ...]) -> None:
    """Refuse names of imperfections that the scenario does not have, or has no more."""
    known = scenario.imperfections()
    for name in only:
        if name not in known:
            problem = f"scenario {scenario.name!r} has no imperfection {name!r}"
            fix = f"--only {next(iter(known))}, or leave --only out for all" if known else "leave --only out"
            raise InputError("--only", problem, choices=known, fix=fix)


def _result_json(request: BudgetRequest, found: "ErrorBudget") -> dict[str, Any]:
    from trimtab.run.error_budget import cost_share

    def numbers(measured: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
        return {m: {"rms": _finite_or_none(rms), "standard_error": error} for m, (rms, error) in measured.items()}

    costs = [
        {
            "imperfection": cost.name,
            "share": {m: _finite_or_none(cost_share(found, cost, m)) for m in found.units},
            "without": numbers(cost.without),
            "alone": numbers(cost.alone),
        }
        for cost in found.costs
    ]
    about = {"scenario": request.scenario, "seed": request.seed, "runs": request.runs, "units": dict(found.units)}
    return about | {"all": numbers(found.whole), "none": numbers(found.least), "costs": costs}


def _finite_or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _draw_budget(found: "ErrorBudget", title: str, file: Path | None) -> list[str]:
    if file is None:
        return []
    from trimtab.plots.error_budget import plot_error_budget

    file.parent.mkdir(parents=True, exist_ok=True)
    plot_error_budget(found, file, title=title)
    return [str(file)]
