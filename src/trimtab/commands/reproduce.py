"""`trimtab reproduce`: a publication's figures computed again, printed beside computed, with the verdict."""

import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from trimtab.commands.kept_programs import enable_cache
from trimtab.commands.options import FILE, JSON
from trimtab.commands.output import check_folder, console, new_table, print_files, print_json, show_progress
from trimtab.study import WHERE, Row, StudyGroup, find_studies, find_study, format_value, list_groups, read_study_title

GroupRows = list[tuple[StudyGroup, list[Row]]]


@click.command()
@click.argument("study", metavar="[STUDY]", required=False)
@click.option("--only", multiple=True, metavar="GROUP", help="Only this group of figures; repeatable.")
@click.option("--out", type=FILE, metavar="DIR", help="Folder for the study's pictures.")
@JSON
def command(study: str | None, only: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """Compute a publication's figures again: printed beside computed, with the verdict.

    Exit code 1 when a figure that should be reproduced is not. Without STUDY the studies and their groups are listed.

    \b
    trimtab reproduce
    trimtab reproduce hovercraft2006
    trimtab reproduce hovercraft2006 --only inertia --json
    trimtab reproduce hovercraft2006 --out figures/
    """
    if study is None:
        _list_studies(as_json)
        return
    groups = list_groups(study, only)
    if out is not None:
        check_folder("--out", out)
    enable_cache()
    results, files = _compute_groups(groups, out)
    if as_json:
        print_json(_results_json(study, results), files)
    else:
        _print_groups(study, results)
        print_files(files)
    sys.exit(1 if any(row.fails for _, rows in results for row in rows) else 0)


def _list_studies(as_json: bool) -> None:
    """Every study with its groups."""
    studies = {name: (read_study_title(folder), list_groups(name)) for name, folder in find_studies().items()}
    if as_json:
        content = {n: {"title": doc, "groups": {g.name: g.title for g in gs}} for n, (doc, gs) in studies.items()}
        print_json({"studies": content})
        return
    for name, (doc, groups) in studies.items():
        click.echo(f"{name}   {doc}")
        for group in groups:
            click.echo(f"  --only {group.name:22s} {group.title}, {group.place}")
    click.echo(f"compute one: trimtab reproduce {next(iter(studies))}" if studies else WHERE)


def _compute_groups(groups: list[StudyGroup], out: Path | None) -> tuple[GroupRows, list[Path]]:
    results: GroupRows = []
    files: list[Path] = []
    with show_progress(len(groups)) as tell:
        for group in groups:
            tell(group.title, 0)
            rows = []
            for row in group.rows():
                rows.append(row)
                tell(f"{group.title}: {row.id}", 0)
            results.append((group, rows))
            if out is not None:
                files += group.figures(out)
            tell(group.title, 1)
    return results, files


def verdict_counts(rows: Iterable[Row]) -> dict[str, int]:
    """Verdict -> number of rows."""
    counts = Counter(row.verdict for row in rows)
    return {verdict: counts[verdict] for verdict in ("holds", "differs", "not reproduced")}


def _results_json(study: str, results: GroupRows) -> dict[str, Any]:
    return {
        "study": study,
        "good": not any(row.fails for _, rows in results for row in rows),
        "verdicts": verdict_counts(row for _, rows in results for row in rows),
        "rows": [{"group": group.name} | row.as_json() for group, rows in results for row in rows],
    }


def _print_groups(study: str, results: GroupRows) -> None:
    for group, rows in results:
        _print_rows(f"{group.title}, [1] {group.place}", rows)
    total = verdict_counts(row for _, rows in results for row in rows)
    click.echo("* not a number of the publication: read off an axis, or calculated independently from what it prints")
    click.echo(f"[1] {read_study_title(find_study(study))}")
    click.echo(", ".join(f"{n} {verdict}" for verdict, n in total.items() if n or verdict != "differs"))


def _print_rows(title: str, rows: list[Row]) -> None:
    """Rows of a study: printed beside computed, and of each that does not hold the reason."""
    headings = ("figure", ">printed", ">computed", "accepted", "unit", "verdict", "where")
    table = new_table(*headings, title=title.replace("[", r"\["), unwrapped=("verdict",))
    styles = {"differs": "bold red", "not reproduced": "yellow"}
    for row in rows:
        printed = format_value(row.printed) + ("" if row.basis in ("printed", "text") else " *")
        unit = "" if row.unit == "1" else row.unit
        cells = (row.what, printed, format_value(row.computed), row.tolerance, unit, row.verdict, row.citation)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style=styles.get(row.verdict))
    console().print(table)
    for row in rows:
        if row.verdict != "holds":
            console().print(f"  {row.verdict}: {row.what}. {row.note}".rstrip().replace("[", r"\["))
