"""Plots of the campaign: success by size of the parameter errors, and influence of each coefficient.

Colours: Okabe and Ito, "Color universal design", 2008.
"""

from pathlib import Path
from typing import Any

import numpy as np

from studies.hypersonic2022._campaign import KINDS, NAMES
from studies.hypersonic2022._campaign_ranking import failure_thresholds, sobol_indices
from studies.hypersonic2022._campaign_sizes import EACH, RANKED, SIZES, fly_size, success_proportion
from studies.hypersonic2022._trade import BETTER
from trimtab.plots.style import BLUE, DPI, GREEN, GREY, VERMILION

SHOWN = 12
FARTHEST = 0.9


def draw_success(folder: Path) -> Path:
    """Plot the share of successful flights and its interval by size of the errors, for both laws and another filter."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), dpi=DPI, facecolor="white", layout="constrained")
    axes: Any = figure.add_subplot()
    cases = (
        (BLUE, "with integral action", 0.0, [fly_size(x, True) for x in SIZES], SIZES),
        (VERMILION, "without integral action, as shipped", 0.0, [fly_size(x, False) for x in SIZES], SIZES),
        (GREEN, f"with integral action, Qacc {BETTER.name}", 0.3, *_other_filter_rates()),
    )
    for colour, words, aside, every, sizes in cases:
        shares = [success_proportion(found) for found in every]
        y = 100 * np.array([s.share for s in shares])
        error = 100 * np.array([(s.share - s.low, s.high - s.share) for s in shares]).T
        x = 100 * np.array(sizes) + aside
        axes.errorbar(x, y, yerr=error, color=colour, marker="o", markersize=4, lw=1.2, capsize=3, label=words)
    axes.set(xlabel="each coefficient uniform within ± (%)", ylabel="flights that succeed (%), 95 % interval")
    axes.set(ylim=(0, 103), xlim=(0, 32))
    axes.legend(loc="center left", bbox_to_anchor=(0.38, 0.5), fontsize=9, frameon=False)
    _style_axes(
        axes, f"37 plant coefficients varied, {len(KINDS)} disturbances, noise; {len(KINDS) * EACH} flights per point"
    )
    return _save_figure(figure, folder, "further-work-success.png")


def draw_ranking(folder: Path) -> Path:
    """Plot each coefficient's total index, and its largest tolerable error alone. Each law has a row of panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.0), dpi=DPI, facecolor="white", layout="constrained")
    every: Any = figure.subplots(2, 2)
    for (left, right), integral in zip(every, (True, False), strict=True):
        size, law = RANKED[integral], "with" if integral else "without"
        found, alone = sobol_indices(size, integral), failure_thresholds(integral)
        first = np.argsort(-found.total[:-1], kind="stable")[:SHOWN]
        y = np.arange(SHOWN)
        total = found.total[first]
        error = np.array([np.maximum(total - found.low[first], 0), np.maximum(found.high[first] - total, 0)])
        left.barh(y, total, color=BLUE, height=0.7, xerr=error, error_kw={"lw": 0.9, "capsize": 2, "ecolor": GREY})
        left.barh(y, np.maximum(found.first[first], 0), color="#56B4E9", height=0.28)
        _style_axes(left, f"Total index of success, ±{100 * size:.0f} %, {law} integral action (pale: first order)")
        for sign, values, colour in ((-1, alone.down[first], VERMILION), (1, alone.up[first], BLUE)):
            ends = np.isfinite(values)
            right.barh(y[ends], sign * 100 * values[ends], color=colour, height=0.7)
            right.barh(y[~ends], np.full((~ends).sum(), sign * 100 * FARTHEST), color="#E8E8E8", height=0.7)
        right.axvline(0, color="black", lw=0.8)
        right.set_xlim(-95, 95)
        _style_axes(right, "Largest tolerable error of one coefficient alone (%); pale: no failure")
        for axes in (left, right):
            axes.set_yticks(y, [NAMES[i] for i in first])
            axes.invert_yaxis()
    return _save_figure(figure, folder, "further-work-ranking.png")


def _other_filter_rates() -> tuple[Any, Any]:
    sizes = (0.15, 0.20, 0.30)
    return [fly_size(x, True, EACH, BETTER.Q) for x in sizes], sizes


def _save_figure(figure: Any, folder: Path, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / name)
    return folder / name


def _style_axes(axes: Any, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, weight="bold")
    axes.grid(color="#d8d8d8", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
