"""What a campaign says, as a table, as numbers and as pictures."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

if TYPE_CHECKING:
    from trimtab.campaign.campaign import Campaign, CampaignResult
    from trimtab.campaign.statistics.morris import Morris
    from trimtab.campaign.statistics.requirement import RequirementVerdict
    from trimtab.campaign.statistics.sensitivity import Sensitivity

SHOWN_QUANTILES = {"p5": 0.05, "median": 0.5, "p95": 0.95}
TABLE_WIDTH = 105
"""Columns of a terminal from which on the table has bands."""
MOST_FAILED_RUNS = 8
"""How many failed runs are named."""


def metric_names(found: "CampaignResult") -> list[str]:
    """The metrics of a result."""
    spread = {path for path, _ in found.plan.spread}
    return [n for n in found.columns if n not in spread and n not in ("run", "success", "lost")]


def summarise_metrics(found: "CampaignResult") -> dict[str, dict[str, float]]:
    """By metric the quantiles of SHOWN, each with its band, the largest value, and how often there was none."""
    from trimtab.campaign.statistics.intervals import quantile

    told: dict[str, dict[str, float]] = {}
    for name in metric_names(found):
        x = found.columns[name]
        told[name] = {}
        for label, p in SHOWN_QUANTILES.items():
            q = quantile(x, p)
            told[name] |= {label: q.value, f"{label}_low": q.low, f"{label}_high": q.high}
        told[name] |= {
            "largest": float(np.max(np.where(np.isnan(x), np.inf, x))),
            "never": float((~np.isfinite(x)).sum()),
        }
    return told


def print_campaign(
    made: "Campaign", found: "CampaignResult", verdicts: "Sequence[RequirementVerdict]", command: str
) -> None:
    """The table, the success, the requirements, and what to type to see one that failed."""
    from trimtab.campaign.sampling.points import DESIGNS
    from trimtab.commands.tables import console, new_table

    n = len(found.columns["run"])
    table = new_table(title=f"{found.plan.scenario}, {n} runs of seed {found.plan.seed}", title_justify="left")
    table.add_column("metric", no_wrap=True)
    screen = console()
    wide = screen.width >= TABLE_WIDTH
    band = " (95 % band)" if wide else ""
    for heading in ("5 %", f"median{band}", f"95 %{band}", "largest", "never"):
        table.add_column(heading, justify="right")
    labels = {m.name: m.label for m in made.ready.metrics}
    for name, q in summarise_metrics(found).items():
        bands = [
            _format_number(q[k])
            + (f" ({_format_number(q[f'{k}_low'])} to {_format_number(q[f'{k}_high'])})" if wide else "")
            for k in ("median", "p95")
        ]
        table.add_row(labels[name], _format_number(q["p5"]), *bands, _format_number(q["largest"]), f"{q['never']:.0f}")
    screen.print(table)
    conditions = (
        " and ".join(f"{c.metric} {c.compare} {c.bound:g}" for c in made.ready.success) or "the state stays finite"
    )
    if found.plan.sampling in DESIGNS:
        click.echo(f"success: {found.success.successes} of {n} rows of the design, which are no independent worlds")
        print_sensitivity(made, found)
    else:
        click.echo(f"success: {found.success}, {found.success.successes} of {n}: {conditions}")
    lost = int(found.columns["lost"].sum())
    if lost:
        click.echo(f"lost: {lost} runs, whose state ran away")
    rate = f"{found.flown_runs / found.wall_s:.0f} runs/s" if found.flown_runs else "all were in the store"
    click.echo(f"flown: {found.flown_runs} in {found.wall_s:.1f} s, {rate}")
    for verdict in verdicts:
        click.echo(str(verdict))
    failed = found.columns["run"][~found.columns["success"]]
    if len(failed):
        few = ", ".join(str(r) for r in failed[:MOST_FAILED_RUNS]) + (", …" if len(failed) > MOST_FAILED_RUNS else "")
        click.echo(f"failed: {few}; one of them once more: {command} --rerun {failed[0]} --out run-{failed[0]}")


def _format_number(value: float) -> str:
    return f"{value:.4g}"


def print_sensitivity(made: "Campaign", found: "CampaignResult") -> None:
    """What each factor matters to each metric, largest first."""
    from trimtab.campaign.statistics.morris import Morris
    from trimtab.commands.tables import console, new_table

    for metric, told in sensitivities(made, found).items():
        if told.note:
            click.echo(f"{metric}: {told.note}")
            continue
        effects = isinstance(told, Morris)
        pair = (
            (("mu_star", "mu*"), ("sigma", "sigma"))
            if effects
            else (("total", "total order"), ("first", "first order"))
        )
        table = new_table(title=f"{metric}: what matters, of {told.rows} runs", title_justify="left")
        table.add_column("factor", no_wrap=True)
        for _, heading in pair:
            table.add_column(f"{heading} (95 %)", justify="right")
        for name in told.order:
            i = told.factors.index(name)
            numbers = [[getattr(told, field + end)[i] for end in ("", "_low", "_high")] for field, _ in pair]
            table.add_row(
                name,
                *(f"{_format_number(v)} ({_format_number(low)} to {_format_number(high)})" for v, low, high in numbers),
            )
        console().print(table)


def sensitivities(made: "Campaign", found: "CampaignResult") -> "dict[str, Sensitivity | Morris]":
    """Of each metric, and of the success, from the rows of a design; by rank where a metric was not always finite."""
    from trimtab.campaign.statistics.morris import morris
    from trimtab.campaign.statistics.sensitivity import sensitivity

    parameters = [f.text for f in made.ready.spread.factors]
    told: dict[str, Any] = {}
    for name in [*metric_names(found), "success"]:
        x = found.columns[name]
        by_rank = not np.isfinite(x).all()
        label = f"{name} (by rank)" if by_rank else name
        if found.plan.sampling == "saltelli":
            told[label] = sensitivity(x, parameters, by_rank=by_rank)
        else:
            told[label] = morris(x, found.plan.seed, parameters, by_rank=by_rank)
    return told


def write_pictures(made: "Campaign", found: "CampaignResult", folder: Path) -> list[Path]:
    """Histograms, convergence, and what the failures have in common; or what matters, of a design."""
    from trimtab.campaign.sampling.points import DESIGNS
    from trimtab.plots.campaign import plot_convergence, plot_histogram, plot_parallel, plot_sensitivity

    title, files = found.plan.scenario, []
    if found.plan.sampling in DESIGNS:
        for name, told in sensitivities(made, found).items():
            files.append(folder / f"sensitivity-{_file_stem(name)}.png")
            plot_sensitivity(told, files[-1], f"{title}: {name}")
        return files
    limits = {c.metric: c.bound for c in made.ready.success if np.isfinite(c.bound)}
    for name, label in [(m.name, m.label) for m in made.ready.metrics]:
        files.append(folder / f"histogram-{_file_stem(name)}.png")
        plot_histogram(found.columns[name], path=files[-1], title=title, label=label, limit=limits.get(name))
    files.append(folder / "convergence.png")
    plot_convergence(found.columns["success"], path=files[-1], title=title)
    spread = {path: found.columns[path] for path, _ in found.plan.spread}
    if spread:
        files.append(folder / "parallel-coordinates.png")
        plot_parallel(spread, found.columns["success"], files[-1], title=title)
    return files


def _file_stem(name: str) -> str:
    """A metric's name as part of a file's."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-")
