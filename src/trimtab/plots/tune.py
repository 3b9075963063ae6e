"""A picture of a tuning: cost and gains over the runs flown, and what it is worth in runs it saw, and did not see."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.campaign.search.tune import TuningResult
from trimtab.plots.run import BLUE, DPI, GREY, SEVERAL, VERMILION, save_figure

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

SIZE = (13.0, 4.2)


def plot_tune(found: TuningResult, path: str | os.PathLike[str] | None = None, title: str = "Tuning") -> "Figure":
    """Draw a tuning.

    Args:
        found: what `tune` gave.
        path: where to save (PNG, or what the suffix says; the file appears whole or not at all); None: nowhere.
        title: what to write above.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white", layout="constrained")
    axes: Any = figure.subplots(1, 3, gridspec_kw={"width_ratios": (3, 3, 2)})
    flown = np.array([s.flown_runs for s in found.steps])
    axes[0].plot(flown, [s.cost for s in found.steps], ".-", color=BLUE, lw=1.2)
    axes[0].set_ylabel(
        "mean cost of a generation's best" if found.method == "search" else "mean cost near by, each of new runs"
    )
    axes[0].set_title(found.method, loc="left", fontsize=10, weight="bold")
    places = np.array([s.x for s in found.steps])
    for i, name in enumerate(found.before):
        label = f"{name.rsplit('.', 1)[-1]}: {found.before[name]:.4g} → {found.after[name]:.4g}"
        axes[1].plot(flown, places[:, i], ".-", color=SEVERAL[i % len(SEVERAL)], lw=1.2, label=label)
    axes[1].set_ylim(-0.03, 1.03)
    axes[1].set_ylabel("gain, as place in its range")
    axes[1].legend(fontsize=8, frameon=False)
    for one in axes[:2]:
        one.set_xlabel("runs flown", fontsize=9)
    _draw_comparisons(axes[2], found)
    for one in axes:
        one.grid(color="#d8d8d8", lw=0.6)
        one.set_axisbelow(True)
        one.tick_params(labelsize=8)
        one.yaxis.label.set_size(9)
    verdict = "helps" if found.is_improvement else "does NOT help"
    figure.suptitle(f"{title}: {verdict} in runs it did not see", fontsize=13, weight="bold", x=0.01, ha="left")
    if path is not None:
        save_figure(figure, Path(path))
    return figure


def _draw_comparisons(axes: Any, found: TuningResult) -> None:
    """Mean paired differences with their intervals."""
    bars = (("seen", found.seen_comparison, GREY), ("held out", found.held_out_comparison, BLUE))
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
    axes.set_ylabel(f"change of the cost, {100 * found.held_out_comparison.level:.0f} %")
