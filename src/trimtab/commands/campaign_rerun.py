"""One run of a campaign once more: with its whole log, held against the row that the campaign has of it."""

import json
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from trimtab.campaign.campaign import Campaign
    from trimtab.commands.campaign import Request


def rerun(request: "Request", made: "Campaign", run: int) -> bool:
    """Fly a run again; whether it is equal to its row, where the store has it."""
    from trimtab.logs.mcap import write_mcap
    from trimtab.plots.run import plot_run

    scenario = made.scenario(run)
    log = made.rerun(run)
    row = made.row(run, log)
    apart = _apart(request, run, row)
    files = []
    if request.out is not None:
        request.out.mkdir(parents=True, exist_ok=True)
        files = [request.out / f"run-{run}.mcap", request.out / f"run-{run}.png"]
        write_mcap(log, files[0])
        plot_run(log, None, files[1], title=f"{scenario.name}, run {run}", targets=tuple(scenario.targets))
    if request.as_json:
        plain = {name: value.item() if value == value else None for name, value in row.items()}
        plain = {name: None if value in (float("inf"), float("-inf")) else value for name, value in plain.items()}
        told = {"run": run, "row": plain, "differs": apart, "files": [str(f) for f in files]}
        click.echo(json.dumps(told, allow_nan=False))
        return not apart
    _show(run, row, made)
    for file in files:
        click.echo(f"wrote {file}")
    if apart is None:
        click.echo("no row to hold it against: name the campaign's store with --store")
    elif apart:
        click.echo(f"DIFFERS from its row in {', '.join(apart)}")
    else:
        click.echo("equal to its row, to the bit")
    return not apart


def _apart(request: "Request", run: int, row: dict[str, Any]) -> list[str] | None:
    """Names of the columns that differ from the store's row; None where there is no such row."""
    if request.store is None:
        return None
    from trimtab.campaign.store.store import read_store

    _, columns = read_store(request.store)
    at = (columns["run"] == run).nonzero()[0]
    if not len(at):
        return None
    there = {name: columns[name][at[0]] for name in row}
    return [name for name, value in row.items() if not (value == there[name] or value != value)]


def _show(run: int, row: dict[str, Any], made: "Campaign") -> None:
    from trimtab.commands.tables import console, new_table

    table = new_table(title=f"{made.plan.scenario}, run {run} of seed {made.plan.seed}", title_justify="left")
    table.add_column("", no_wrap=True)
    table.add_column("value", justify="right")
    for name, value in row.items():
        table.add_row(name, f"{value:.6g}" if value.dtype.kind == "f" else str(value))
    console().print(table)
