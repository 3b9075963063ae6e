"""`trimtab reproduce`: a publication's figures computed again, printed beside computed, with the verdict."""

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from trimtab.commands.progress import show_progress
from trimtab.study import WHERE, StudyGroup, find_studies, find_study, list_groups, read_study_title

if TYPE_CHECKING:  # rich is imported when something is shown
    from trimtab.study import Row

GroupRows = list[tuple[StudyGroup, "list[Row]"]]


class ReproduceRequest(NamedTuple):
    """What was asked for on the command line."""

    study: str | None
    only: tuple[str, ...] = ()
    out: Path | None = None
    as_json: bool = False


def reproduce(request: ReproduceRequest) -> bool:
    """List the studies, or compute one; whether every row that must hold does."""
    if request.study is None:
        _list_studies(request.as_json)
        return True
    chosen = list_groups(request.study, request.only)
    if request.out is not None:
        from trimtab.commands.fly_scenario import check_folder

        check_folder("--out", request.out)
    from trimtab.commands.cache import enable_cache

    enable_cache()
    found, files = _compute_groups(chosen, request.out)
    failing = [row for _, rows in found for row in rows if row.fails]
    if request.as_json:
        _print_json(request.study, found, files)
    else:
        _print_groups(request.study, found, files)
    return not failing


def _list_studies(as_json: bool) -> None:
    """Every study with its groups."""
    found = {name: (read_study_title(folder), list_groups(name)) for name, folder in find_studies().items()}
    if as_json:
        content = {n: {"title": doc, "groups": {g.name: g.title for g in gs}} for n, (doc, gs) in found.items()}
        click.echo(json.dumps({"studies": content}))
        return
    for name, (doc, groups) in found.items():
        click.echo(f"{name}   {doc}")
        for group in groups:
            click.echo(f"  --only {group.name:22s} {group.title}, {group.place}")
    click.echo(f"compute one: trimtab reproduce {next(iter(found))}" if found else WHERE)


def _compute_groups(chosen: list[StudyGroup], out: Path | None) -> tuple[GroupRows, list[Path]]:
    found: GroupRows = []
    files: list[Path] = []
    with show_progress(len(chosen)) as tell:
        for group in chosen:
            tell(group.title, 0)
            rows = []
            for row in group.rows():
                rows.append(row)
                tell(f"{group.title}: {row.id}", 0)
            found.append((group, rows))
            if out is not None:
                files += group.figures(out)
            tell(group.title, 1)
    return found, files


def verdict_counts(rows: Iterable["Row"]) -> dict[str, int]:
    """Verdict -> number of rows."""
    found = Counter(row.verdict for row in rows)
    return {verdict: found[verdict] for verdict in ("holds", "differs", "not reproduced")}


def _print_json(study: str, found: GroupRows, files: list[Path]) -> None:
    rows = [{"group": group.name} | row.as_json() for group, rows in found for row in rows]
    total = verdict_counts(row for _, rows in found for row in rows)
    result = {
        "study": study,
        "good": not any(r.fails for _, rows in found for r in rows),
        "verdicts": total,
        "rows": rows,
    }
    click.echo(json.dumps(result | ({"files": [str(f) for f in files]} if files else {}), allow_nan=False))


def _print_groups(study: str, found: GroupRows, files: list[Path]) -> None:
    from trimtab.commands.tables import print_rows

    for group, rows in found:
        print_rows(f"{group.title}, [1] {group.place}", rows)
    total = verdict_counts(row for _, rows in found for row in rows)
    click.echo("* not a number of the publication: read off an axis, or calculated independently from what it prints")
    click.echo(f"[1] {read_study_title(find_study(study))}")
    click.echo(", ".join(f"{n} {verdict}" for verdict, n in total.items() if n or verdict != "differs"))
    for file in files:
        click.echo(f"wrote {file}")
