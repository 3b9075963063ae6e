"""`trimtab reproduce`: recompute a publication's figures, and compare printed with computed values."""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from trimtab.commands.options import FILE, JSON, OUT
from trimtab.commands.output import check_folder, console, new_table, print_files, print_json, print_table, write_text
from trimtab.commands.progress import show_progress
from trimtab.commands.written_files import check_new_in
from trimtab.core.cache_folder import enable_cache
from trimtab.study import (
    BASES,
    PUBLISHED,
    WHERE,
    Row,
    StudyGroup,
    find_studies,
    find_study,
    format_value,
    list_groups,
    read_study_title,
)

GroupRows = list[tuple[StudyGroup, list[Row]]]


@click.command()
@click.argument("study", metavar="[STUDY]", required=False)
@click.option("--only", multiple=True, metavar="GROUP", help="Restrict the study to this group. May be repeated.")
@OUT("DIR", "Write the study's pictures to this folder.")
@click.option(
    "--report",
    type=FILE,
    metavar="DIR",
    help="Write a one-page report to this folder: values, pictures, errata, environment.",
)
@JSON
def command(study: str | None, only: tuple[str, ...], out: Path | None, report: Path | None, as_json: bool) -> None:
    """Compare a publication's printed values with computed values.

    Exit code 1 if a value that should be reproduced is not. Without STUDY, the studies and their groups of figures are
    listed.

    \b
    trimtab reproduce
    trimtab reproduce hovercraft2006
    trimtab reproduce hovercraft2006 --only inertia --json
    trimtab reproduce hovercraft2006 --out figures/
    trimtab reproduce hovercraft2006 --report page/
    """
    if study is None:
        _list_studies(as_json)
        return
    groups = list_groups(study, only)
    for option, folder in (("--out", out), ("--report", report)):
        if folder is not None:
            check_folder(option, folder)
            check_new_in(option, folder, "*.png", "index.html")
    enable_cache()
    begin, since = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()), time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        results, pictures = _compute_groups(groups, out or (Path(scratch) if report else None))
        files = [file for drawn in pictures.values() for file in drawn] if out else []
        if report is not None:
            files.append(_write_page(report, study, results, pictures, (begin, time.monotonic() - since)))
    if as_json:
        print_json(_results_json(study, results), files)
    else:
        _print_groups(study, results)
        print_files(files)
    sys.exit(1 if any(row.fails for _, rows in results for row in rows) else 0)


def _list_studies(as_json: bool) -> None:
    """Print every study and the study's groups of figures."""
    studies = {name: (read_study_title(folder), list_groups(name)) for name, folder in find_studies().items()}
    if as_json:
        content = {n: {"title": doc, "groups": {g.name: g.title for g in gs}} for n, (doc, gs) in studies.items()}
        print_json({"studies": content})
        return
    width, indent = console().width, 4 * " "
    for name, (doc, groups) in studies.items():
        click.echo(click.wrap_text(f"{name}   {doc}", width, subsequent_indent=indent))
        column = max((len(group.name) for group in groups), default=0) + len("  --only   ")
        for group in groups:
            begin = f"  --only {group.name}".ljust(column)
            text = f"{group.title}, {group.place}"
            click.echo(click.wrap_text(text, width, begin, indent if width < 80 else " " * column))
    click.echo(f"recompute one: trimtab reproduce {next(iter(studies))}" if studies else WHERE)


def _compute_groups(groups: list[StudyGroup], out: Path | None) -> tuple[GroupRows, dict[str, list[Path]]]:
    """Return each group of figures with its rows, and group name -> pictures if a folder for pictures is given."""
    import jax  # imported here: a list of the studies needs no JAX

    results: GroupRows = []
    pictures: dict[str, list[Path]] = {}
    with show_progress(len(groups)) as tell:
        for group in groups:
            tell(group.title, 0)
            rows = []
            for row in group.rows():
                rows.append(row)
                tell(f"{group.title}: {row.id}", 0)
            results.append((group, rows))
            if out is not None:
                pictures[group.name] = list(group.figures(out))
            jax.clear_caches()  # releases the memory of compiled programs, about 20 MB per group
            tell(group.title, 1)
    return results, pictures


def _write_page(
    report: Path, study: str, results: GroupRows, pictures: dict[str, list[Path]], took: tuple[str, float]
) -> Path:
    """Write the page of `--report`. took: start time (UTC) and duration (s) of the computation."""
    from trimtab.commands.reproduce_page import build_page, describe_environment, read_errata

    folder = find_study(study)
    summary = _results_json(study, results)
    summary["sentence"] = confirmation_sentence(row for _, rows in results for row in rows)
    words = ["reproduce", folder.name, *(w for g, _ in results for w in ("--only", g.name))]
    if len(results) == len(list_groups(study)):
        words = words[:2]
    environment = describe_environment([*words, "--report", report.name or "."], *took)
    title = read_study_title(folder)
    page = build_page(title, results, summary, pictures, read_errata(folder), environment)
    return write_text(report / "index.html", page)


def verdict_counts(rows: Iterable[Row]) -> dict[str, int]:
    """Return for each verdict the number of rows (compared values) with this verdict."""
    counts = Counter(row.verdict for row in rows)
    return {verdict: counts[verdict] for verdict in ("holds", "differs", "not reproduced")}


def basis_counts(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """Return basis of comparison -> number of rows that hold, number of all rows. A basis without rows is left out."""
    holds, all_rows = Counter[str](), Counter[str]()
    for row in rows:
        all_rows[row.basis] += 1
        holds[row.basis] += row.holds
    return {basis: (holds[basis], all_rows[basis]) for basis in BASES if all_rows[basis]}


def confirmation_sentence(rows: Iterable[Row]) -> str:
    """Return a sentence that states how many rows confirm a value or statement of the publication."""
    every = list(rows)
    confirms = sum(row.confirms for row in every)
    own = sum(row.basis not in PUBLISHED for row in every)
    return (
        f"{confirms} of {len(every)} rows confirm a value or statement of the publication; "
        f"{own} of them compare with other values, and confirm nothing in the publication."
    )


def _results_json(study: str, results: GroupRows) -> dict[str, Any]:
    return {
        "study": study,
        "good": not any(row.fails for _, rows in results for row in rows),
        "verdicts": verdict_counts(row for _, rows in results for row in rows),
        "bases": {
            basis: {"holds": holds, "rows": n}
            for basis, (holds, n) in basis_counts(row for _, rows in results for row in rows).items()
        },
        "rows": [{"group": group.name} | row.as_json() for group, rows in results for row in rows],
    }


def _print_groups(study: str, results: GroupRows) -> None:
    for group, rows in results:
        _print_rows(f"{group.title}, [1] {group.place}", rows)
    total = verdict_counts(row for _, rows in results for row in rows)
    click.echo(f"[1] {read_study_title(find_study(study))}")
    click.echo("* compared with another source than the publication. Number of rows for each source:")
    every = [row for _, rows in results for row in rows]
    for basis, (holds, n) in basis_counts(every).items():
        click.echo(f"  {basis:10s}{holds:4d} of {n:4d} hold   {BASES[basis]}")
    click.echo(", ".join(f"{n} {verdict}" for verdict, n in total.items() if n or verdict != "differs"))
    click.echo(confirmation_sentence(every))


def _print_rows(title: str, rows: list[Row]) -> None:
    """Print rows of a study: publication's value, computed value, and a reason for each row that does not hold."""
    headings = ("figure", ">printed", ">computed", "accepted", "unit", "verdict", "where")
    table = new_table(*headings, title=title, unwrapped=("verdict",))
    styles = {"differs": "bold red", "not reproduced": "yellow"}
    for row in rows:
        printed = format_value(row.printed) + ("" if row.basis in ("printed", "text") else " *")
        unit = "" if row.unit == "1" else row.unit
        cells = (row.what, printed, format_value(row.computed), row.tolerance, unit, row.verdict, row.citation)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style=styles.get(row.verdict))
    print_table(table)
    for row in rows:
        if row.verdict != "holds":
            console().print(f"  {row.verdict}: {row.what}. {row.note}".rstrip().replace("[", r"\["))
