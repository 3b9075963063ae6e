"""Plot of an error budget: bars for the effect of each imperfection, in one panel for each error."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.plots.style import BLUE, VERMILION, PicturePath, new_figure, save_figure
from trimtab.run.error_budget import ErrorBudget

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

ALONE, WITHOUT, NONE = BLUE, VERMILION, "#E8E8E8"


def plot_error_budget(budget: ErrorBudget, path: PicturePath = None, title: str = "") -> "Figure":
    """Draw an error budget. For each error, bars show the RMS with one imperfection only, and with all except this one.

    Args:
        budget: error budget to draw.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    measures, n = list(budget.units), len(budget.costs)
    figure = new_figure(1.8 + 2.0 * len(measures), 1.6 + 0.28 * max(n, 3))
    panels: Any = figure.subplots(1, len(measures), sharey=True, squeeze=False)
    y = np.arange(n)
    for axes, measure in zip(panels[0], measures, strict=True):
        whole, least = budget.whole[measure][0], budget.least[measure][0]
        axes.axvspan(0, least, color=NONE)
        axes.axvline(whole, color="black", linewidth=0.9, label="all")
        for offset, kind, colour in ((-0.19, "alone", ALONE), (0.19, "without", WITHOUT)):
            values = np.array([getattr(cost, kind)[measure] for cost in budget.costs]).reshape(n, 2)
            values = np.where(np.isfinite(values), values, np.nan)
            axes.errorbar(
                values[:, 0], y + offset, xerr=2 * values[:, 1], fmt="o", color=colour, markersize=3.5, linewidth=0.9
            )
        unit = budget.units[measure]
        axes.set(title=measure.replace("_", " "), xlabel=f"rms ({unit})" if unit != "1" else "rms", xlim=(0, None))
        axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)
        axes.locator_params(axis="x", nbins=4)
    panels[0][0].set_yticks(y, [cost.name for cost in budget.costs])
    panels[0][0].invert_yaxis()
    marks = [
        ("line", "black", "all imperfections"),
        ("o", WITHOUT, "all imperfections except this one"),
        ("o", ALONE, "only this imperfection"),
        ("area", NONE, "no imperfection"),
    ]
    figure.legend(handles=[_legend_mark(*m) for m in marks], loc="outside lower center", ncols=2, frameon=False)
    figure.suptitle(title, fontsize="medium")
    return save_figure(figure, path)


def _legend_mark(kind: str, colour: str, label: str) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if kind == "area":
        return Patch(color=colour, label=label)
    if kind == "line":
        return Line2D([], [], color=colour, linewidth=0.9, label=label)
    return Line2D([], [], color=colour, marker="o", markersize=4, linewidth=0, label=label)
