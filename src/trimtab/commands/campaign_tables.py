"""What a campaign says, as a table, as numbers and as pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

if TYPE_CHECKING:
    from trimtab.campaign.campaign import Campaign, Result
    from trimtab.campaign.verdict import Verdict

SHOWN = {"p5": 0.05, "median": 0.5, "p95": 0.95}
FAILED = 8
"""How many failed runs are named."""


def names_of(found: "Result") -> list[str]:
    """The metrics of a result."""
    spread = {path for path, _ in found.plan.spread}
    return [n for n in found.columns if n not in spread and n not in ("run", "success", "lost")]


def summary(found: "Result") -> dict[str, dict[str, float]]:
    """By metric the quantiles of SHOWN, each with its band, the largest value, and how often there was none."""
    from trimtab.campaign.quantiles import quantile

    told: dict[str, dict[str, float]] = {}
    for name in names_of(found):
        x = found.columns[name]
        told[name] = {}
        for label, p in SHOWN.items():
            q = quantile(x, p)
            told[name] |= {label: q.value, f"{label}_low": q.low, f"{label}_high": q.high}
        told[name] |= {
            "largest": float(np.max(np.where(np.isnan(x), np.inf, x))),
            "never": float((~np.isfinite(x)).sum()),
        }
    return told


def print_campaign(made: "Campaign", found: "Result", verdicts: "Sequence[Verdict]", command: str) -> None:
    """The table, the success, the requirements, and what to type to see one that failed."""
    from trimtab.commands.tables import console, new_table

    n = len(found.columns["run"])
    table = new_table(title=f"{found.plan.scenario}, {n} runs of seed {found.plan.seed}", title_justify="left")
    table.add_column("metric", no_wrap=True)
    for heading in ("5 %", "median (95 % band)", "95 % (95 % band)", "largest", "never"):
        table.add_column(heading, justify="right")
    for name, q in summary(found).items():
        bands = [f"{_n(q[k])} ({_n(q[f'{k}_low'])} to {_n(q[f'{k}_high'])})" for k in ("median", "p95")]
        table.add_row(name, _n(q["p5"]), *bands, _n(q["largest"]), f"{q['never']:.0f}")
    console().print(table)
    conditions = (
        " and ".join(f"{c.metric} {c.compare} {c.bound:g}" for c in made.ready.success) or "the state stays finite"
    )
    click.echo(f"success: {found.success}, {found.success.successes} of {n}: {conditions}")
    lost = int(found.columns["lost"].sum())
    if lost:
        click.echo(f"lost: {lost} runs, whose state ran away")
    rate = f"{found.flown / found.wall_s:.0f} runs/s" if found.flown else "all were in the store"
    click.echo(f"flown: {found.flown} in {found.wall_s:.1f} s, {rate}")
    for verdict in verdicts:
        click.echo(str(verdict))
    failed = found.columns["run"][~found.columns["success"]]
    if len(failed):
        few = ", ".join(str(r) for r in failed[:FAILED]) + (", …" if len(failed) > FAILED else "")
        click.echo(f"failed: {few}; one of them once more: {command} --rerun {failed[0]} --out run-{failed[0]}")


def _n(value: float) -> str:
    return f"{value:.4g}"


def write_pictures(made: "Campaign", found: "Result", folder: Path) -> list[Path]:
    """Histogram, convergence, and what the failures have in common."""
    from trimtab.plots import campaign as plots

    return plots.write_campaign(made, found, folder)
