"""Plot of the measured delays of a radio link: histograms of uplink, downlink and round trip, for each load."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.flight.line_delays import DelayModel, Delays, fit_delay_model, latency_rows, link_traces
from trimtab.plots.style import BLUE, GREY, VERMILION, PicturePath, new_figure, save_figure, style_grid

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
WIDTH, ROW_HEIGHT, BINS = 13.0, 2.6, 30


def plot_link_delays(measured: Sequence[Delays], path: PicturePath = None, title: str = "Delays of a link") -> "Figure":
    """Draw the fraction of packets per ms of delay, with the distributions fitted to uplink and downlink delays.

    Args:
        measured: measured delays of each load. Each load is drawn in a separate row of panels.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    figure = new_figure(WIDTH, 0.6 + ROW_HEIGHT * len(measured))
    every: Any = figure.subplots(len(measured), 3, squeeze=False)
    for line, delays in zip(every, measured, strict=True):
        recorded, table = link_traces(delays), latency_rows(delays)
        trip = delays.up + delays.down
        line[0].set_ylabel("fraction of packets per ms", fontsize=9)
        for axes, name, seconds in zip(line, table, (delays.up, delays.down, trip), strict=True):
            fitted = fit_delay_model(recorded[name]) if name in recorded else None
            _draw_histogram(axes, 1e3 * seconds[np.isfinite(seconds)], fitted)
            load = f"{delays.plan.up:g}/{delays.plan.down:g} kb/s"
            axes.set_title(f"{name}, {load}", loc="left", fontsize=10, weight="bold")
            axes.axvline(table[name].mean_ms, color=GREY, lw=1, ls="--")
    for axes in every[-1]:
        axes.set_xlabel("delay (ms)", fontsize=9)
    return save_figure(figure, path, title)


def _draw_histogram(axes: Any, delays_ms: np.ndarray[Any, Any], fitted: DelayModel | None) -> None:
    low, high = float(delays_ms.min()), float(delays_ms.max())
    edges = np.linspace(low, max(high, low + 0.1), BINS + 1)
    axes.hist(delays_ms, edges, density=True, color=BLUE, alpha=0.75)
    if fitted is not None:
        at = (edges[1:] + edges[:-1]) / 2
        axes.plot(at, gamma_density(fitted, at / 1e3) / 1e3, color=VERMILION, lw=1.5)
    style_grid(axes)


def gamma_density(fitted: DelayModel, seconds: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the density of the shifted gamma distribution, in 1/s."""
    from scipy import special  # the import takes 0.2 s, and only plots need scipy

    k = ((fitted.mean - fitted.shift) / fitted.sd) ** 2
    x = np.maximum(seconds - fitted.shift, 1e-12) * (fitted.mean - fitted.shift) / fitted.sd**2
    rate = (fitted.mean - fitted.shift) / fitted.sd**2
    return np.where(seconds > fitted.shift, np.exp((k - 1) * np.log(x) - x - special.gammaln(k)) * rate, 0.0)
