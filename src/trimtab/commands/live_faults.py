"""`trimtab live-faults`: fly a vehicle and an autopilot with faults in link, processes and computer."""

import sys
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import click

from trimtab.commands.options import FILE, JSON, OUT
from trimtab.commands.output import check_folder, new_table, print_json, print_table
from trimtab.commands.written_files import check_new, note_written
from trimtab.core.errors import InputError
from trimtab.study import find_study, import_study

if TYPE_CHECKING:
    from studies.live_faults.case import CaseOutcome


@click.command()
@click.option(
    "--only",
    multiple=True,
    metavar="CASE",
    help="Restrict the flights to this case. May be repeated.  [default: all cases]",
)
@click.option("--draw", type=click.IntRange(1), metavar="N", help="Fly N randomly drawn flights instead of the cases.")
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Seed of the random flights and of virtual time.",
)
@click.option(
    "--real-time",
    "is_real",
    is_flag=True,
    help="Ask for flights with real processes in real time, instead of in one process in virtual time.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 16),
    default=2,
    show_default=True,
    help="Number of flights that run at the same time.",
)
@OUT("DIR", "Write logs and printed output to this folder, in one subfolder for each case.")
@click.option(
    "--page",
    type=FILE,
    metavar="FILE",
    help="Write a docs page with the results to this file. With --only, add the results to an existing page.",
)
@JSON
def command(
    only: tuple[str, ...],
    draw: int | None,
    seed: int,
    is_real: bool,
    jobs: int,
    out: Path | None,
    page: Path | None,
    as_json: bool,
) -> None:
    """Inject over a hundred faults into simulated live flights.

    The faults hit the link, the processes and the computer of a vehicle and an autopilot.

    Each case is a short flight in virtual time. Vehicle, outputs, autopilots and attackers run in one process on one
    clock, so a flight is repeatable from its seed, bit for bit. Exit code 1: a vehicle was not safe, a program crashed,
    or a log does not show what happened. One flight in twenty is repeated and must be identical. All cases take a few
    minutes.

    With --real-time each case is a flight of real processes over real sockets. All cases then take some twenty minutes.
    A flight that failed while the operating system delayed one of its processes is repeated once.

    \b
    trimtab live-faults --only cut-1 --only autopilot-killed
    trimtab live-faults --draw 1000 --seed 1
    trimtab live-faults --only drawn-1-17
    trimtab live-faults --real-time --out campaign --json
    """
    campaign = _import_module("campaign")
    cases = campaign.select_cases(_choose_names(only, draw, seed, page))
    if out is not None:
        check_folder("--out", out)
        for name in cases:
            if (out / name).exists():
                raise InputError(
                    "--out", f"the folder already contains a case: {out / name}", fix="--out with a new folder"
                )
    if page is not None:
        check_folder("--page", page.parent)
        if not only:  # with --only, results are added to an existing page
            check_new("--page", page)
    began = monotonic()

    def tell(outcome: "CaseOutcome") -> None:
        if not as_json:
            click.echo(f"{outcome.verdict:13s}{outcome.name:26s} {outcome.happened or outcome.skipped}")
        if outcome.problems and draw is not None:
            click.echo(f"        {outcome.name}: {outcome.does}", err=True)
        if outcome.waited:
            click.echo(f"        {outcome.name}: waited: {outcome.waited}", err=True)
        for problem in outcome.problems:
            click.echo(f"        {outcome.name}: {problem}", err=True)

    outcomes = campaign.fly_cases(cases, out=out, jobs=jobs, is_real=is_real, seed=seed, tell=tell)
    wall = monotonic() - began
    if page is not None:
        names = [case.name for case in _import_module("cases").all_cases()]
        _import_module("page").write_page(page, outcomes, names, wall, apart=bool(only), is_real=is_real)
        note_written([page])
    if as_json:
        kinds = {} if draw is None else _count_kinds(outcomes)
        verdicts = [one._asdict() | {"verdict": one.verdict} for one in outcomes]
        found = {"wall_s": round(wall, 1), "acted_s": _longest_times(outcomes), "cases": verdicts}
        print_json(found | ({"kinds": kinds} if kinds else {}))
    else:
        if draw is not None:
            _print_kinds(_count_kinds(outcomes))
        flights = sum(not one.skipped for one in outcomes)
        count = {v: sum(one.verdict == v for one in outcomes) for v in ("holds", "fails", "kept waiting", "skipped")}
        click.echo(
            f"{len(outcomes)} cases in {wall:.0f} s: "
            + ", ".join(f"{n} {v}" for v, n in count.items() if n)
            + f"; {60 * flights / wall:.0f} flights per minute"
        )
        for what, seconds in _longest_times(outcomes).items():
            click.echo(f"outputs still acted for at most {seconds * 1e3:.0f} ms after {what}")
        if page is not None:
            click.echo(f"wrote {page}")
    sys.exit(0 if all(one.verdict in ("holds", "skipped") for one in outcomes) else 1)


def _choose_names(only: tuple[str, ...], draw: int | None, seed: int, page: Path | None) -> tuple[str, ...]:
    """Return the names of the cases that the options select. An empty tuple means all cases."""
    if draw is not None:
        if only or page is not None:
            raise InputError("--draw", "cannot be combined with --only or --page", fix=f"--draw {draw} alone")
        only = tuple(f"{_import_module('draw').DRAWN}{seed}-{k}" for k in range(draw))
    return only


def _count_kinds(outcomes: "Sequence[CaseOutcome]") -> dict[str, dict[str, int]]:
    """Return for each kind of random flight the counts by name. The last kind, "all", has the totals."""
    counts = _import_module("draw").count_kinds({one.name: one for one in outcomes})
    kinds = {kind: count._asdict() for kind, count in counts.items()}
    return kinds | {"all": {name: sum(k[name] for k in kinds.values()) for name in next(iter(kinds.values()))}}


def _longest_times(outcomes: "Sequence[CaseOutcome]") -> dict[str, float]:
    """Return for each reason to switch the outputs to safe values: longest time (s) for which they still acted."""
    return {
        what: max(one.acted_s.get(what, 0.0) for one in outcomes)
        for what in dict.fromkeys(what for one in outcomes for what in one.acted_s)
    }


def _print_kinds(kinds: dict[str, dict[str, int]]) -> None:
    """Print the table of random flights."""
    names = [name.replace("_", " ") for name in kinds["all"]]
    table = new_table("kind", *(f">{name}" for name in names), unwrapped=("kind",))
    for kind, counts in kinds.items():
        table.add_row(kind, *(str(n) for n in counts.values()))
    print_table(table)


def _import_module(name: str) -> Any:
    """Import a module of the study `live_faults`, which is in trimtab's source repository."""
    return import_study(find_study("live_faults") / f"{name}.py")
