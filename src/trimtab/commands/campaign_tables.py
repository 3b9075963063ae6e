"""Results of a campaign as tables, JSON data, pictures and animation."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.analysis.campaign.campaign import Campaign, CampaignResult
from trimtab.analysis.campaign.sampling.points import DESIGNS
from trimtab.analysis.campaign.statistics.intervals import quantile
from trimtab.analysis.campaign.statistics.morris import Morris, morris
from trimtab.analysis.campaign.statistics.requirement import RequirementVerdict
from trimtab.analysis.campaign.statistics.sensitivity import Sensitivity, sensitivity
from trimtab.commands.output import console, draw_plot, new_table, print_table
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.time import seconds
from trimtab.run.known_signals import find_signals

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
ANIMATED = 40
"""Maximum number of runs in an animation."""


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


def write_pictures(campaign: Campaign, result: CampaignResult, folder: Path) -> list[Path]:
    """Draw histograms, convergence and parallel coordinates, or the results of a sensitivity analysis."""
    from trimtab.plots.campaign import plot_convergence, plot_histogram, plot_parallel, plot_sensitivity

    title, files = result.plan.scenario, []
    if result.plan.sampling in DESIGNS:
        for name, matters in sensitivities(campaign, result).items():
            files.append(folder / f"sensitivity-{_file_stem(name)}.png")
            plot_sensitivity(matters, files[-1], f"{title}: {name}")
        return files
    limits = {c.metric: c.bound for c in campaign.ready.success if np.isfinite(c.bound)}
    for name, label in [(m.name, m.label) for m in campaign.ready.metrics]:
        files.append(folder / f"histogram-{_file_stem(name)}.png")
        plot_histogram(result.columns[name], path=files[-1], title=title, label=label, limit=limits.get(name))
    files.append(folder / "convergence.png")
    plot_convergence(result.columns["success"], path=files[-1], title=title)
    spread = {path: result.columns[path] for path, _ in result.plan.spread}
    if len(spread) > 1:  # parallel coordinates with a single axis show nothing
        files.append(folder / "parallel-coordinates.png")
        declared = {path: d.unit for path, _, d in leaves(campaign.ready.scenario) if isinstance(d, Quantity)}
        units = {path: declared.get(path.partition("[")[0], "") for path in spread}
        plot_parallel(spread, result.columns["success"], files[-1], title=title, units=units)
    return files


def _file_stem(name: str) -> str:
    """Return a metric's name as part of a file name."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-")


def check_plan_view(campaign: Campaign, animation: Path | None) -> None:
    """Raise InputError if the file of --animate is named, but the runs cannot be drawn in a plan view."""
    if animation is not None and not {"truth.north", "flight.north"} & find_signals(campaign.scenario(0)).shapes.keys():
        problem = "the true state of the vehicle has no north and east, which the animation of a campaign needs"
        raise InputError(
            "--animate", problem, fix="leave --animate out, or animate one run: --rerun 0 --animate FILE.gif"
        )


def draw_animation(campaign: Campaign, result: CampaignResult, file: Path | None) -> list[str]:
    """Repeat the first runs of a campaign, and draw them to the file of --animate. Return the files written."""
    if file is None:
        return []
    from trimtab.plots.animation import FRAME_S, animate_paths

    runs, success = result.columns["run"][:ANIMATED], result.columns["success"][:ANIMATED]
    period = seconds(FRAME_S / 4)
    logs = [campaign.rerun(int(run), log_period=period, signals=("truth",)) for run in runs]
    title = f"{campaign.plan.scenario}, {len(logs)} runs"
    return [str(one) for one in draw_plot(file, animate_paths, logs, success.astype(bool).tolist(), title=title)]
