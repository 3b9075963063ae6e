"""A picture of a search for the worst case: the margin over the runs flown, and where in the box the worst ones lie."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.campaign.search.falsify import FalsificationResult
from trimtab.plots.run import BLUE, DPI, GREY, SEVERAL, VERMILION, save_figure

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

WIDTH, HEIGHT, WORST = 13.0, 4.6, 60
"""WORST: how many of the worst candidates are drawn across the box."""


def plot_falsify(
    found: FalsificationResult, path: str | os.PathLike[str] | None = None, title: str = "Search for the worst case"
) -> "Figure":
    """Draw the search.

    Args:
        found: what `falsify` gave.
        path: where to save (PNG, or what the suffix says; the file appears whole or not at all); None: nowhere.
        title: what to write above.
    """
    from matplotlib.figure import Figure

    names = [name.rsplit(".", 1)[-1] for name in found.names]
    size = (WIDTH, max(HEIGHT, 1.6 + 0.32 * len(names)))
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    axes: Any = figure.subplots(1, 2, gridspec_kw={"width_ratios": (3, 2)})
    _draw_margins(axes[0], found)
    _draw_candidates(axes[1], found, names)
    for one in axes:
        one.grid(color="#d8d8d8", lw=0.6)
        one.set_axisbelow(True)
        one.tick_params(labelsize=8)
    verdict = f"failure, margin {found.margin:.4g}" if found.fails else f"no failure, least margin {found.margin:.4g}"
    figure.suptitle(f"{title}: {verdict}", fontsize=13, weight="bold", x=0.01, ha="left")
    if path is not None:
        save_figure(figure, Path(path))
    return figure


def _draw_margins(axes: Any, found: FalsificationResult) -> None:
    each = found.candidate_margins.shape[1]
    least = found.candidate_margins.min(axis=1)
    at = each * np.arange(1, len(least) + 1)
    stages = np.unique(found.stages)
    for stage in stages:
        mine = found.stages == stage
        name, colour = f"restart {stage}" if stage else "CMA-ES", SEVERAL[(max(stage, 0) + 1) % len(SEVERAL)]
        if stage == -1:
            name, colour = "over the box", GREY
        elif stage == stages[-1] and len(stages) > 2:
            name, colour = "other random numbers", SEVERAL[3]
        axes.plot(at[mine], least[mine], ".", ms=3, color=colour, alpha=0.6, label=name)
    axes.plot(at, np.minimum.accumulate(least), color=BLUE, lw=1.8, label="least so far")
    axes.axhline(0, color=VERMILION, lw=1.4)
    axes.set_xlabel("runs flown", fontsize=9)
    axes.set_ylabel("margin (failure below 0)", fontsize=9)
    axes.legend(fontsize=8, frameon=False, ncols=2)


def _draw_candidates(axes: Any, found: FalsificationResult, names: list[str]) -> None:
    """Coordinates of the worst candidates; the worst of all is joined by a line."""
    _, once = np.unique(found.points, axis=0, return_index=True)
    worst = once[np.argsort(found.candidate_margins.min(axis=1)[once], kind="stable")][:WORST][::-1]
    rows = np.arange(len(names))
    for i in worst:
        axes.plot(found.points[i], rows, ".", color=GREY, ms=5, alpha=0.3)
    axes.plot(found.point, rows, "o-", color=VERMILION, lw=1.2, ms=5)
    axes.set_yticks(rows, names, fontsize=8)
    axes.set_xlim(-0.03, 1.03)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel(f"place between the bounds: the worst, and {len(worst)} bad ones", fontsize=9)
