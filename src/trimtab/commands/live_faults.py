"""`trimtab live-faults`: a vehicle and an autopilot as two processes, and all that can go wrong between them."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import click

from trimtab.commands.options import FILE, JSON
from trimtab.commands.output import check_folder, print_json
from trimtab.core.errors import InputError
from trimtab.study import find_study, import_study

if TYPE_CHECKING:
    from studies.live_faults.case import CaseOutcome


@click.command()
@click.option("--only", multiple=True, metavar="CASE", help="Only this case; repeatable.  [default: all]")
@click.option("--jobs", type=click.IntRange(1, 16), default=2, show_default=True, help="How many at a time.")
@click.option("--out", type=FILE, metavar="DIR", help="Keep logs, and all that was said, in a folder a case.")
@click.option("--page", type=FILE, metavar="FILE", help="Write the docs page with the table; with --only, into it.")
@JSON
def command(only: tuple[str, ...], jobs: int, out: Path | None, page: Path | None, as_json: bool) -> None:
    """Spoil the line, the processes and the machine of a vehicle and an autopilot that fly, in over sixty ways.

    Each case is a short flight of two processes. Exit code 1 where a vehicle was not safe, a process crashed, or a log
    doesn't say what happened. All of it takes some ten minutes; disks and clocks are spoilt for the processes alone.

    \b
    trimtab live-faults --only cut-1 --only autopilot-killed
    trimtab live-faults --jobs 3 --out campaign --json
    """
    campaign = _import_module("campaign")
    cases = campaign.select_cases(only)
    if out is not None:
        check_folder("--out", out)
        for name in cases:
            if (out / name).exists():
                raise InputError("--out", f"there is a case already: {out / name}", fix="--out with a new folder")
    if page is not None:
        check_folder("--page", page.parent)
    began = monotonic()

    def tell(outcome: "CaseOutcome") -> None:
        if not as_json:
            click.echo(f"{outcome.verdict:8s}{outcome.name:26s} {outcome.happened or outcome.skipped}")
        for problem in outcome.problems:
            click.echo(f"        {outcome.name}: {problem}", err=True)

    outcomes = campaign.fly_cases(cases, out=out, jobs=jobs, tell=tell)
    wall = monotonic() - began
    if page is not None:
        _write_page(page, outcomes, wall, apart=bool(only))
    if as_json:
        verdicts = [one._asdict() | {"verdict": one.verdict} for one in outcomes]
        print_json({"wall_s": round(wall, 1), "cases": verdicts})
    else:
        count = {v: sum(one.verdict == v for one in outcomes) for v in ("holds", "fails", "skipped")}
        click.echo(f"{len(outcomes)} cases in {wall:.0f} s: " + ", ".join(f"{n} {v}" for v, n in count.items() if n))
        if page is not None:
            click.echo(f"wrote {page}")
    sys.exit(0 if all(one.verdict != "fails" for one in outcomes) else 1)


def _write_page(file: Path, outcomes: "Sequence[CaseOutcome]", wall: float, *, apart: bool) -> None:
    """A new page of all cases; or the rows of some in the page that is there."""
    page, names = _import_module("page"), [case.name for case in _import_module("cases").all_cases()]
    before = file.read_text("utf-8") if apart and file.exists() else ""
    run = page.describe_flights([one.name for one in outcomes], wall, os.cpu_count() or 1, apart=apart)
    file.write_text(page.format_page(outcomes, run, before, names), "utf-8")


def _import_module(name: str) -> Any:
    """A module of the study that makes these flights, which a clone of trimtab has."""
    return import_study(find_study("live_faults") / f"{name}.py")
