"""`trimtab live-faults`: a vehicle and an autopilot as two processes, and all that can go wrong between them."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from trimtab.commands.fly_scenario import check_folder
from trimtab.core.errors import InputError
from trimtab.study import find_study, import_study

if TYPE_CHECKING:
    from studies.live_faults.case import CaseOutcome


class LiveFaultsRequest(NamedTuple):
    """What was asked for on the command line."""

    only: tuple[str, ...] = ()
    out: Path | None = None
    page: Path | None = None
    jobs: int = 2
    as_json: bool = False


def live_faults(request: LiveFaultsRequest) -> bool:
    """Fly the cases; whether all of them hold."""
    campaign = _import_module("campaign")
    wanted = campaign.select_cases(request.only)
    if request.out is not None:
        check_folder("--out", request.out)
        for name in wanted:
            if (request.out / name).exists():
                problem = f"there is a case already: {request.out / name}"
                raise InputError("--out", problem, fix="--out with a new folder")
    if request.page is not None:
        check_folder("--page", request.page.parent)
    began = monotonic()

    def tell(outcome: "CaseOutcome") -> None:
        if not request.as_json:
            click.echo(f"{outcome.verdict:8s}{outcome.name:26s} {outcome.happened or outcome.skipped}")
        for problem in outcome.problems:
            click.echo(f"        {outcome.name}: {problem}", err=True)

    outcomes = campaign.fly_cases(wanted, out=request.out, jobs=request.jobs, tell=tell)
    wall = monotonic() - began
    _show_outcomes(request, outcomes, wall)
    return all(one.verdict != "fails" for one in outcomes)


def _show_outcomes(request: LiveFaultsRequest, outcomes: "Sequence[CaseOutcome]", wall: float) -> None:
    if request.page is not None:
        _write_page(request.page, outcomes, wall, apart=bool(request.only))
    if request.as_json:
        found = [one._asdict() | {"verdict": one.verdict} for one in outcomes]
        click.echo(json.dumps({"wall_s": round(wall, 1), "cases": found}))
        return
    count = {v: sum(one.verdict == v for one in outcomes) for v in ("holds", "fails", "skipped")}
    click.echo(f"{len(outcomes)} cases in {wall:.0f} s: " + ", ".join(f"{n} {v}" for v, n in count.items() if n))
    if request.page is not None:
        click.echo(f"wrote {request.page}")


def _write_page(file: Path, outcomes: "Sequence[CaseOutcome]", wall: float, *, apart: bool) -> None:
    """A new page of all cases; or the rows of some in the page that is there."""
    page = _import_module("page")
    before = file.read_text("utf-8") if apart and file.exists() else ""
    run = page.describe_flights([one.name for one in outcomes], wall, os.cpu_count() or 1, apart=apart)
    file.write_text(
        page.format_page(outcomes, run, before, [case.name for case in _import_module("cases").all_cases()]), "utf-8"
    )


def _import_module(name: str) -> Any:
    """A module of the study that makes these flights, which a clone of trimtab has."""
    return import_study(find_study("live_faults") / f"{name}.py")
