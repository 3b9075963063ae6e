"""Plots of a search: margins of a falsification (`falsify`), and cost and gains of a tuning (`tune`)."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.analysis.campaign.search.falsify import FalsificationResult
from trimtab.analysis.campaign.search.tune import TuningResult
from trimtab.plots.style import BLUE, GREY, SEVERAL, VERMILION, PicturePath, new_figure, save_figure, style_grid

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

WIDTH, FALSIFY_HEIGHT, TUNE_HEIGHT = 13.0, 4.6, 4.2
WORST = 60
"""Number of candidates with the smallest margins whose coordinates are drawn."""


def plot_falsify(
    search: FalsificationResult, path: PicturePath = None, title: str = "Search for the worst case"
) -> "Figure":
    """Draw the margins of all candidates of a search, and the coordinates of the worst candidates.

    Args:
        search: result of `falsify`.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    names = [name.rsplit(".", 1)[-1] for name in search.names]
    figure = new_figure(WIDTH, max(FALSIFY_HEIGHT, 1.6 + 0.32 * len(names)))
    axes: Any = figure.subplots(1, 2, gridspec_kw={"width_ratios": (3, 2)})
    _draw_margins(axes[0], search)
    _draw_candidates(axes[1], search, names)
    for one in axes:
        style_grid(one)
    verdict = "failure, margin" if search.fails else "no failure; smallest margin"
    return save_figure(figure, path, f"{title}: {verdict} {search.margin:.4g}")


def _draw_margins(axes: Any, search: FalsificationResult) -> None:
    each = search.candidate_margins.shape[1]
    least = search.candidate_margins.min(axis=1)
    at = each * np.arange(1, len(least) + 1)
    stages = np.unique(search.stages)
    for stage in stages:
        mine = search.stages == stage
        name, colour = f"restart {stage}" if stage else "CMA-ES", SEVERAL[(max(stage, 0) + 1) % len(SEVERAL)]
        if stage == -1:
            name, colour = "Sobol points", GREY
        elif stage == stages[-1] and len(stages) > 2:
            name, colour = "same candidate, other random numbers", SEVERAL[3]
        axes.plot(at[mine], least[mine], ".", ms=3, color=colour, alpha=0.6, label=name)
    axes.plot(at, np.minimum.accumulate(least), color=BLUE, lw=1.8, label="smallest so far")
    axes.axhline(0, color=VERMILION, lw=1.4)
    axes.set_xlabel("runs flown", fontsize=9)
    axes.set_ylabel("margin (failure below 0)", fontsize=9)
    axes.legend(fontsize=8, frameon=False, ncols=2)


def _draw_candidates(axes: Any, search: FalsificationResult, names: list[str]) -> None:
    """Draw the coordinates of the candidates with the smallest margins. A line joins those of the worst candidate."""
    _, once = np.unique(search.points, axis=0, return_index=True)
    worst = once[np.argsort(search.candidate_margins.min(axis=1)[once], kind="stable")][:WORST][::-1]
    rows = np.arange(len(names))
    for i in worst:
        axes.plot(search.points[i], rows, ".", color=GREY, ms=5, alpha=0.3)
    axes.plot(search.point, rows, "o-", color=VERMILION, lw=1.2, ms=5)
    axes.set_yticks(rows, names, fontsize=8)
    axes.set_xlim(-0.03, 1.03)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel(
        f"position between the bounds: worst candidate (red) and {len(worst)} other bad candidates", fontsize=9
    )


def plot_tune(tuning: TuningResult, path: PicturePath = None, title: str = "Tuning") -> "Figure":
    """Draw cost and gains over the steps of a tuning, and the change of the cost in training and in validation runs.

    Args:
        tuning: result of `tune`.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    figure = new_figure(WIDTH, TUNE_HEIGHT)
    axes: Any = figure.subplots(1, 3, gridspec_kw={"width_ratios": (3, 3, 2)})
    flown = np.array([s.flown_runs for s in tuning.steps])
    axes[0].plot(flown, [s.cost for s in tuning.steps], ".-", color=BLUE, lw=1.2)
    axes[0].set_ylabel(
        "mean cost of the best of each generation"
        if tuning.method == "search"
        else "mean cost of each step, in new runs"
    )
    axes[0].set_title(tuning.method, loc="left", fontsize=10, weight="bold")
    places = np.array([s.x for s in tuning.steps])
    for i, name in enumerate(tuning.before):
        label = f"{name.rsplit('.', 1)[-1]}: {tuning.before[name]:.4g} → {tuning.after[name]:.4g}"
        axes[1].plot(flown, places[:, i], ".-", color=SEVERAL[i % len(SEVERAL)], lw=1.2, label=label)
    axes[1].set_ylim(-0.03, 1.03)
    axes[1].set_ylabel("gain, as a fraction of its range")
    axes[1].legend(fontsize=8, frameon=False)
    for one in axes[:2]:
        one.set_xlabel("runs flown", fontsize=9)
    _draw_comparisons(axes[2], tuning)
    for one in axes:
        style_grid(one)
        one.yaxis.label.set_size(9)
    verdict = "improvement" if tuning.is_improvement else "NO significant improvement"
    return save_figure(figure, path, f"{title}: {verdict} in runs not used for tuning")


def _draw_comparisons(axes: Any, tuning: TuningResult) -> None:
    """Draw the mean differences of the cost in paired runs, with confidence intervals."""
    bars = (("training", tuning.seen_comparison, GREY), ("validation", tuning.held_out_comparison, BLUE))
    for i, (_, c, colour) in enumerate(bars):
        if np.isfinite(c.difference):
            axes.errorbar(
                i, c.difference, [[c.difference - c.low], [c.high - c.difference]], fmt="o", color=colour, capsize=5
            )
        else:
            axes.text(i, 0, f"{c.better} better\n{c.worse} worse", ha="center", va="bottom", fontsize=8, color=colour)
    axes.axhline(0, color=VERMILION, lw=1.4)
    axes.set_xlim(-0.6, 1.6)
    axes.set_xticks((0, 1), [f"{name}\n{c.runs} runs" for name, c, _ in bars])
    axes.set_ylabel(f"change of the cost ({100 * tuning.held_out_comparison.level:.0f} % interval)")
