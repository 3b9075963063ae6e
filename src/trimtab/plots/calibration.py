"""Plots of calibrations: readings, fitted line with 95 % band, outliers and residuals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trimtab.plots.style import BLUE, GREY, SEVERAL, VERMILION, PicturePath, new_figure, save_figure, style_grid

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

COLUMNS, WIDTH, HEIGHT = 3, 5.2, 4.6


class FitCurve(NamedTuple):
    """Readings, and the line fitted to them. x, y: readings (n,).  fitted: values of the line at the readings (n,).

    kept: (n,) bool, False for outliers.  line_x, line_y: points of the line (m,).  band: half width of the line's 95 %
    interval (m,), or None.  label: text in the legend.
    """

    x: Any
    y: Any
    fitted: Any
    kept: Any
    line_x: Any
    line_y: Any
    band: Any = None
    label: str = ""


class FitPanel(NamedTuple):
    """Panel of a calibration plot: curves in common axes, and labels of the axes."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[FitCurve]
    note: str = ""


def plot_fits(panels: Sequence[FitPanel], path: PicturePath = None, title: str = "") -> "Figure":
    """Draw panels of fits: readings, line and band above, and residuals below. Outliers are drawn as crosses.

    Args:
        panels: panels with the fits.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(max(WIDTH * columns, 7.0), 0.4 + HEIGHT * rows)
    heights = [2.6, 1.0] * rows
    axes: Any = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=heights)
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        _draw_panel(axes[2 * row, column], axes[2 * row + 1, column], panel)
    for k in range(len(panels), rows * columns):
        row, column = divmod(k, columns)
        axes[2 * row, column].set_axis_off()
        axes[2 * row + 1, column].set_axis_off()
    return save_figure(figure, path, title)


def _draw_panel(above: Any, below: Any, panel: FitPanel) -> None:
    for k, curve in enumerate(panel.curves):
        color = BLUE if len(panel.curves) == 1 else SEVERAL[k % len(SEVERAL)]
        line = VERMILION if len(panel.curves) == 1 else color
        dots: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.5 if len(curve.x) < 200 else 1.2, "color": color}
        kept = np.asarray(curve.kept, bool)
        above.plot(curve.x[kept], curve.y[kept], alpha=0.7, label=curve.label or "measured", **dots)
        above.plot(curve.line_x, curve.line_y, color=line, lw=1.4, label=None if curve.label else "fitted")
        if curve.band is not None:
            low, high = curve.line_y - curve.band, curve.line_y + curve.band
            label = None if curve.label else "95 %"
            above.fill_between(curve.line_x, low, high, color=line, alpha=0.18, lw=0, label=label)
        rest = curve.y - curve.fitted
        below.plot(curve.x[kept], rest[kept], alpha=0.7, **dots)
        if not kept.all():
            out: dict[str, Any] = {"ls": "", "marker": "x", "ms": 8, "mew": 1.6, "color": VERMILION}
            above.plot(curve.x[~kept], curve.y[~kept], label="left out" if k == 0 else None, **out)
    below.axhline(0, color=GREY, lw=0.8)
    above.set_title(panel.title, loc="left", fontsize=10, weight="bold")
    above.set_title(panel.note, loc="right", fontsize=8, color=GREY)
    above.set_ylabel(panel.y_label, fontsize=9)
    below.set_ylabel("residual", fontsize=9)
    below.set_xlabel(panel.x_label, fontsize=9)
    above.sharex(below)
    above.tick_params(labelbottom=False)
    style_grid(above)
    style_grid(below)
    above.legend(fontsize=8, framealpha=0.9)
