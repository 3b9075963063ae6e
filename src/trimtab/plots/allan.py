"""Plot of Allan deviations, and of the noise models fitted to them."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.analysis.identify.allan import FLICKER, AllanFit, confidence_interval
from trimtab.plots.style import BLUE, GREEN, GREY, VERMILION, PicturePath, new_figure, save_figure

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
COLUMNS, WIDTH, ROW_HEIGHT = 3, 15.0, 4.0


def plot_allan(
    fits: Mapping[str, AllanFit],
    units: Mapping[str, str] | None = None,
    path: PicturePath = None,
    title: str = "Allan deviation",
) -> "Figure":
    """Draw each Allan deviation with 95 % error bars, the fitted noise model, and the model's non-zero components.

    Args:
        fits: name of a signal -> fitted noise model.
        units: unit of each fit, e.g. rad/s.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    columns = min(COLUMNS, len(fits))
    rows = -(-len(fits) // columns)
    figure = new_figure(WIDTH * columns / COLUMNS, 0.5 + rows * ROW_HEIGHT)
    every: Any = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, fit) in zip(every.flat, fits.items(), strict=False):
        _draw_fit(axes, name, fit, (units or {}).get(name, ""))
    for axes in every.flat[len(fits) :]:
        axes.set_axis_off()
    return save_figure(figure, path, title)


def _draw_fit(axes: Any, name: str, fit: AllanFit, unit: str) -> None:
    low, high = confidence_interval(fit)
    bars = np.stack([fit.deviation - low, high - fit.deviation])
    axes.errorbar(fit.tau, fit.deviation, bars, fmt="o", ms=3.5, color=BLUE, lw=1, capsize=2, label="log, 95 %")
    axes.plot(fit.tau, fit.model, color=VERMILION, lw=1.5, label="fitted")
    parts = {
        "N": (fit.white, fit.white.value / np.sqrt(fit.tau), "--"),
        "B": (fit.flicker, fit.flicker.value * np.sqrt(FLICKER) * np.ones_like(fit.tau), ":"),
        "K": (fit.walk, fit.walk.value * np.sqrt(fit.tau / 3), "-."),
    }
    for letter, (coefficient, line, style) in parts.items():
        if coefficient.low > 0:
            axes.plot(fit.tau, line, color=GREEN if letter == "K" else GREY, ls=style, lw=1, label=letter)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(0.6 * min(low.min(), fit.model.min()), 1.6 * max(high.max(), fit.model.max()))
    axes.set_title(name, loc="left", fontsize=10, weight="bold")
    axes.set_xlabel("averaging time (s)", fontsize=9)
    axes.set_ylabel(unit, fontsize=9)
    axes.grid(color="#d8d8d8", lw=0.6, which="both")
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, framealpha=0.9)
