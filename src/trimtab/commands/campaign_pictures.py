"""Pictures and animation of a campaign."""

import re
from pathlib import Path

import numpy as np

from trimtab.analysis.campaign.campaign import Campaign, CampaignResult
from trimtab.analysis.campaign.sampling.points import DESIGNS
from trimtab.commands.campaign_tables import sensitivities
from trimtab.commands.output import draw_plot
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.time import seconds
from trimtab.run.known_signals import find_signals

ANIMATED = 40
"""Maximum number of runs in an animation."""


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
