"""Results of a campaign as tables and JSON data."""

from collections.abc import Sequence
from typing import Any

import click
import numpy as np

from trimtab.analysis.campaign.campaign import Campaign, CampaignResult
from trimtab.analysis.campaign.sampling.points import DESIGNS
from trimtab.analysis.campaign.statistics.intervals import quantile
from trimtab.analysis.campaign.statistics.morris import Morris, morris
from trimtab.analysis.campaign.statistics.requirement import RequirementVerdict
from trimtab.analysis.campaign.statistics.sensitivity import Sensitivity, sensitivity
from trimtab.commands.output import console, new_table, print_table

SHOWN_QUANTILES = {"p5": 0.05, "median": 0.5, "p95": 0.95}
BANDS = ("median", "p95")
"""Quantiles of a metric that a table shows with confidence bands."""
SOBOL_COLUMNS = (("total", "total order"), ("first", "first order"))
MORRIS_COLUMNS = (("mu_star", "mu*"), ("sigma", "sigma"))
"""Field names of a Sobol or Morris sensitivity analysis, with table headings."""
TABLE_WIDTH = 105
"""Minimum terminal width (characters) at which the table shows confidence bands."""
MOST_FAILED_RUNS = 8
"""Maximum number of failed runs that are listed."""


def metric_names(result: CampaignResult) -> list[str]:
    """Return the names of the metrics in a campaign's result."""
    spread = {path for path, _ in result.plan.spread}
    return [n for n in result.columns if n not in spread and n not in ("run", "success", "lost")]


def summarise_metrics(result: CampaignResult) -> dict[str, dict[str, float]]:
    """Return for each metric: quantiles with confidence bands, maximum, number of runs without a finite value."""
    summary: dict[str, dict[str, float]] = {}
    for name in metric_names(result):
        x = result.columns[name]
        summary[name] = {}
        for label, p in SHOWN_QUANTILES.items():
            q = quantile(x, p)
            summary[name] |= {label: q.value, f"{label}_low": q.low, f"{label}_high": q.high}
        summary[name] |= {
            "largest": float(np.max(np.where(np.isnan(x), np.inf, x))),
            "never": float((~np.isfinite(x)).sum()),
        }
    return summary


def print_campaign(
    campaign: Campaign, result: CampaignResult, verdicts: Sequence[RequirementVerdict], command: str
) -> None:
    """Print the table, the success rate, the requirements, and the command that repeats a failed run."""
    n = len(result.columns["run"])
    table = new_table(title=f"{result.plan.scenario}, {n} runs of seed {result.plan.seed}")
    table.add_column("metric", no_wrap=True)
    screen = console()
    wide = screen.width >= TABLE_WIDTH
    band = " (95 % band)" if wide else ""
    for heading in ("5 %", f"median{band}", f"95 %{band}", "largest", "never"):
        table.add_column(heading, justify="right")
    labels = {m.name: m.label for m in campaign.ready.metrics}
    for name, q in summarise_metrics(result).items():
        bands = [f"{q[k]:.4g}" + (f" ({q[f'{k}_low']:.4g} to {q[f'{k}_high']:.4g})" if wide else "") for k in BANDS]
        table.add_row(labels[name], f"{q['p5']:.4g}", *bands, f"{q['largest']:.4g}", f"{q['never']:.0f}")
    print_table(table)
    conditions = [f"{c.metric} {c.compare} {c.bound:g}" for c in campaign.ready.success] or ["state stays finite"]
    if result.plan.sampling in DESIGNS:
        click.echo(f"success: {result.success.successes} of {n} runs of the design, which are not independent")
        print_sensitivity(campaign, result)
    else:
        click.echo(f"success: {result.success}, {result.success.successes} of {n}: {' and '.join(conditions)}")
    lost = int(result.columns["lost"].sum())
    if lost:
        click.echo(f"lost: {lost} runs, because the state diverged")
    rate = f"{result.flown_runs / result.wall_s:.0f} runs/s" if result.flown_runs else "all runs were in the store"
    click.echo(f"flown: {result.flown_runs} runs in {result.wall_s:.1f} s, {rate}")
    for verdict in verdicts:
        click.echo(str(verdict))
    failed = result.columns["run"][~result.columns["success"]]
    if len(failed):
        few = ", ".join(str(r) for r in failed[:MOST_FAILED_RUNS]) + (", …" if len(failed) > MOST_FAILED_RUNS else "")
        click.echo(f"failed: {few}; repeat one: {command} --rerun {failed[0]} --out run-{failed[0]}")


def print_sensitivity(campaign: Campaign, result: CampaignResult) -> None:
    """Print the sensitivity of each metric to each factor, largest first."""
    for metric, matters in sensitivities(campaign, result).items():
        if matters.note:
            click.echo(f"{metric}: {matters.note}")
            continue
        pair = SOBOL_COLUMNS if isinstance(matters, Sensitivity) else MORRIS_COLUMNS
        table = new_table(title=f"{metric}: sensitivity, from {matters.rows} runs")
        table.add_column("factor", no_wrap=True)
        for _, heading in pair:
            table.add_column(f"{heading} (95 %)", justify="right")
        for name in matters.order:
            i = matters.factors.index(name)
            numbers = [[getattr(matters, field + end)[i] for end in ("", "_low", "_high")] for field, _ in pair]
            table.add_row(name, *(f"{v:.4g} ({low:.4g} to {high:.4g})" for v, low, high in numbers))
        print_table(table)


def sensitivities(campaign: Campaign, result: CampaignResult) -> dict[str, Sensitivity | Morris]:
    """Return the sensitivities of success and of each metric. A metric that is not finite is replaced by its ranks."""
    parameters = [f.text for f in campaign.ready.spread.factors]
    matters: dict[str, Any] = {}
    for name in [*metric_names(result), "success"]:
        x = result.columns[name]
        by_rank = not np.isfinite(x).all()
        label = f"{name} (by rank)" if by_rank else name
        if result.plan.sampling == "saltelli":
            matters[label] = sensitivity(x, parameters, by_rank=by_rank)
        else:
            matters[label] = morris(x, result.plan.seed, parameters, by_rank=by_rank)
    return matters
