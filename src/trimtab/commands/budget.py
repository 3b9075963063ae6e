"""`trimtab budget`: what each imperfection of a scenario costs."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

if TYPE_CHECKING:
    from trimtab.run.error_budget import Budget


class Request(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    runs: int = 20
    seed: int = 0
    plot: Path | None = None
    as_json: bool = False


def budget(request: Request) -> None:
    """Everything is checked before anything runs."""
    from trimtab.commands.cache import use_cache
    from trimtab.commands.fly_scenario import Request as Flight
    from trimtab.commands.fly_scenario import build, check_picture
    from trimtab.commands.progress import progress
    from trimtab.run.error_budget import error_budget, sets_of_flights
    from trimtab.run.program import check_seed

    check_seed(request.seed)
    scenario = build(Flight(request.scenario, request.settings, request.without))
    check_picture(request.plot, None)
    use_cache()
    seeds = range(request.seed, request.seed + request.runs)
    with progress(sets_of_flights(scenario, request.only)) as tell:
        tell("compiling", 0)
        found = error_budget(scenario, seeds=seeds, names=request.only, tell=lambda label: tell(label, 1))
    written = _draw(found, scenario.name, request.plot)
    if request.as_json:
        click.echo(json.dumps(_plain(request, found) | ({"files": written} if written else {}), allow_nan=False))
        return
    from trimtab.commands.tables import print_budget

    print_budget(f"{scenario.name}, {request.runs} runs from seed {request.seed}", found)
    for file in written:
        click.echo(f"wrote {file}")


def _plain(request: Request, found: "Budget") -> dict[str, Any]:
    from trimtab.run.error_budget import share

    def numbers(measured: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
        return {m: {"rms": _known(rms), "standard_error": error} for m, (rms, error) in measured.items()}

    costs = [
        {
            "imperfection": cost.name,
            "share": {m: _known(share(found, cost, m)) for m in found.units},
            "without": numbers(cost.without),
            "alone": numbers(cost.alone),
        }
        for cost in found.costs
    ]
    about = {"scenario": request.scenario, "seed": request.seed, "runs": request.runs, "units": dict(found.units)}
    return about | {"all": numbers(found.whole), "none": numbers(found.least), "costs": costs}


def _known(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _draw(found: "Budget", title: str, file: Path | None) -> list[str]:
    if file is None:
        return []
    from trimtab.plots.error_budget import plot_error_budget

    file.parent.mkdir(parents=True, exist_ok=True)
    plot_error_budget(found, file, title=title)
    return [str(file)]
