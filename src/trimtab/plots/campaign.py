"""Plots of a campaign: runs in parallel coordinates, histogram of a metric, convergence of an estimate, sensitivity.

Source: Inselberg, "The plane with parallel coordinates", The Visual Computer 1 (1985).
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.analysis.campaign.sampling.points import NOISE
from trimtab.analysis.campaign.statistics.intervals import Quantile, as_column, quantile
from trimtab.analysis.campaign.statistics.morris import Morris
from trimtab.analysis.campaign.statistics.requirement import success_proportion
from trimtab.analysis.campaign.statistics.sensitivity import Sensitivity
from trimtab.core.errors import InputError
from trimtab.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    PicturePath,
    new_figure,
    save_figure,
    thin_rows,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

MOST_LINES = 400
"""Maximum number of successful runs, and of failed runs, that are drawn as lines. More lines would merge into one
area."""
LIGHT = "#BFD9EA"
LOOKS = 60
"""Number of points of a curve that shows the convergence of an estimate."""
HUGE = 1e12
"""Value, far outside the plot, that is drawn in place of infinity, because matplotlib cannot draw infinity."""
BEYOND = 4.0
"""Half width of a histogram about the median, as a multiple of the width of the middle 90 % of values. Values outside
are counted, but not drawn."""


def plot_parallel(
    parameters: Mapping[str, Any],
    success: Any,
    path: PicturePath = None,
    title: str = "",
    units: Mapping[str, str] = MappingProxyType({}),
) -> "Figure":
    """Draw each run as a line through its parameters, in parallel coordinates. Failed runs are drawn on top.

    Of a large number of runs, only some are drawn.

    Args:
        parameters: name of a parameter -> values in n runs, finite numbers of shape (n,).
        success: True for each successful run, shape (n,).
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
        units: name of a parameter -> unit.
    """
    good = as_column(success, "plot_parallel") > 0
    names = list(parameters)
    place, low, high = _axis_positions(parameters, len(good))
    figure, axes = _new_axes(10.0, 5.2, title)
    k = np.arange(len(names))
    for chosen, colour, word, order in ((good, BLUE, "succeeded", 1), (~good, VERMILION, "failed", 2)):
        rows = thin_rows(np.flatnonzero(chosen), MOST_LINES)
        _draw_lines(axes, place[:, rows].T, colour, order)
        drawn = "" if len(rows) == chosen.sum() else f", {len(rows)} of them drawn"
        axes.plot([], [], color=colour, label=f"{chosen.sum()} {word}{drawn}")
    for i in k:
        axes.plot([i, i], [0, 1], color="#404040", linewidth=0.8, zorder=3)
        for y, value, side in ((-0.02, low[i], "top"), (1.02, high[i], "bottom")):
            axes.text(i, y, f"{value:.3g}", ha="center", va=side, fontsize=8, color=GREY)
    axes.set(xlim=(-0.4, len(names) - 0.6), ylim=(-0.08, 1.08), yticks=[])
    labels = [
        f"{short} ({units[name]})" if units.get(name, "1") not in ("", "1") else short
        for short, name in zip(short_names(names), names, strict=True)
    ]
    axes.set_xticks(k, labels, rotation=30, ha="right", fontsize=9)
    axes.tick_params(axis="x", length=0)
    axes.spines[:].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return save_figure(figure, path)


def _axis_positions(parameters: Mapping[str, Any], runs: int) -> tuple[Any, Any, Any]:
    """Return the positions of the runs on the parameter axes, and the smallest and largest value of each parameter.

    Positions are from 0 to 1, with shape (parameters, runs).
    """
    names, table = list(parameters), np.array([as_column(v, f"plot_parallel: {n}") for n, v in parameters.items()])
    if not names or table.shape[1] != runs or not np.isfinite(table).all():
        problem = (
            f"each run needs a finite value of each parameter, and success; got {len(names)} parameters of"
            f" {table.shape[1:]} runs, and success of {runs}"
        )
        raise InputError("plot_parallel", problem, fix="use one finite number for each run and parameter")
    low, high = table.min(axis=1), table.max(axis=1)
    place = (table - low[:, None]) / np.where(high > low, high - low, 1.0)[:, None]
    place[high == low] = 0.5
    return place, low, high


def _draw_lines(axes: Any, places: Any, colour: str, order: int) -> None:
    """Draw one line per run through its positions on the parameter axes.

    places: positions (runs, parameters).  order: drawing order. Lines with a higher order are on top. The more lines
    are drawn, the fainter they are.
    """
    from matplotlib.collections import LineCollection

    k = np.arange(places.shape[1])
    lines = [np.stack([k, world], axis=1) for world in places]
    faint = float(np.clip(40 * order / max(len(places), 1), 0.12 * order, 0.9))
    axes.add_collection(LineCollection(lines, colors=colour, alpha=faint, linewidths=0.5 * order**0.5, zorder=order))


def short_names(names: Sequence[str]) -> list[str]:
    """Return paths shortened to as many last components as are needed to distinguish them."""
    parts = [name.split(".") for name in names]
    for count in range(1, max(map(len, parts)) + 1):
        short = [".".join(p[-count:]) for p in parts]
        if len(set(short)) == len(short):
            return short
    return list(names)


def plot_histogram(
    values: Any,
    shares: Sequence[float] = (0.05, 0.5, 0.95),
    path: PicturePath = None,
    title: str = "",
    *,
    label: str = "",
    level: float = 0.95,
    limit: float | None = None,
) -> "Figure":
    """Draw the distribution of a metric over the runs, with quantiles and confidence bands of the quantiles.

    Args:
        shares: levels of the quantiles, from 0 to 1.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
        label: name and unit of the metric.
        level: confidence level of each band.
        limit: required limit of the metric, drawn as a line if it is near the values. The legend always shows the
        limit.
    """
    figure, axes = _new_axes(7.0, 4.4, title)
    x = as_column(values, "plot_histogram")
    bands = [quantile(x, p, level) for p in shares]
    finite = np.sort(x[np.isfinite(x)])
    left, right = _histogram_edges(finite)
    drawn = finite[(left <= finite) & (finite <= right)]
    count = int(np.clip(np.sqrt(len(drawn)), 10, 80))
    axes.hist(drawn, bins=np.linspace(left, right, count + 1), color=LIGHT, edgecolor="white", linewidth=0.4)
    for band, colour in zip(bands, (GREEN, BLUE, PURPLE, ORANGE) * len(bands), strict=False):
        _draw_band(axes, band, colour, left, right)
    if limit is not None:
        _draw_limit(axes, limit, left, right)
    axes.set(xlabel=label, ylabel="runs")
    notes = [f"{len(x)} runs"] + [f"{len(finite) - len(drawn)} beyond the edges"] * (len(drawn) < len(finite))
    notes += [f"{len(x) - len(finite)} without a finite value, counted as +inf"] * (len(finite) < len(x))
    axes.set_title("; ".join(notes), fontsize=9, color=GREY, loc="right")
    axes.legend(fontsize=8, title=f"bands: {100 * level:g} %", title_fontsize=8)
    return save_figure(figure, path)


def plot_convergence(
    values: Any,
    p: float | None = None,
    path: PicturePath = None,
    title: str = "",
    *,
    label: str = "",
    level: float = 0.95,
    limit: float | None = None,
) -> "Figure":
    """Draw an estimate over the number of runs, with two kinds of confidence intervals.

    Intervals of the first kind are valid at a single number of runs, those of the second kind at all numbers of runs
    simultaneously.

    Args:
        values: success (true or false) or a metric of runs 0 to n - 1, shape (n,).
        p: level of the quantile of the metric that is estimated. None: the success rate is estimated.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
        label: label of the vertical axis.
        level: confidence level of the intervals.
        limit: required limit of the estimate, drawn as a line.
    """
    figure, axes = _new_axes(7.0, 4.4, title)
    x = as_column(values, "plot_convergence")
    runs = np.unique(np.geomspace(min(10, len(x)), len(x), LOOKS).round().astype(int))
    fixed, anytime = (np.array([_quantile_interval(x[:n], p, level, every) for n in runs]) for every in (False, True))
    fixed, anytime = np.clip(fixed, -HUGE, HUGE), np.clip(anytime, -HUGE, HUGE)
    everywhere = f"{100 * level:g} %, valid at every number of runs"
    axes.fill_between(runs, anytime[:, 1], anytime[:, 2], color="#E4E4E4", linewidth=0, label=everywhere)
    once = f"{100 * level:g} %, valid at one number of runs"
    axes.fill_between(runs, fixed[:, 1], fixed[:, 2], color=LIGHT, linewidth=0, label=once)
    axes.plot(runs, fixed[:, 0], color=BLUE, linewidth=1.4, label="estimate")
    if limit is not None:
        axes.axhline(limit, color=VERMILION, linewidth=1.2, linestyle="--", label=f"limit {limit:g}")
    if p is not None:
        axes.set_ylim(*_estimate_limits(np.where(np.abs(fixed) < HUGE, fixed, np.nan), limit))
    axes.set(xscale="log", xlabel="number of runs", xlim=(runs[0], max(runs[-1], runs[0] + 1)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_ylabel(label or ("success rate" if p is None else f"p{100 * p:g}"))
    axes.legend(fontsize=8)
    axes.grid(color="#DDDDDD", linewidth=0.5)
    return save_figure(figure, path)


def plot_sensitivity(effects: Sensitivity | Morris, path: PicturePath = None, title: str = "") -> "Figure":
    """Draw the sensitivity of a metric to each factor, largest first, with confidence intervals.

    For a result of `sensitivity`, total and first order indices are drawn. For `morris`, mu* and sigma are drawn.

    Args:
        effects: result of `sensitivity` or of `morris`.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    if isinstance(effects, Sensitivity):
        pair, label = (("total", "total order"), ("first", "first order")), "share of the variance"
    else:
        pair, label = (("mu_star", "mu*: size"), ("sigma", "sigma: spread")), "effect over the factor's range"
    order = [effects.factors.index(name) for name in effects.order]
    y = np.arange(len(order))
    figure, axes = _new_axes(7.0, 1.5 + 0.34 * max(len(order), 3), title)
    for (field, name), colour, offset in zip(pair, (BLUE, ORANGE), (-0.19, 0.19), strict=True):
        value, low, high = (np.asarray(getattr(effects, field + end))[order] for end in ("", "_low", "_high"))
        axes.barh(y + offset, value, height=0.36, color=colour, label=name)
        spread = np.maximum([value - low, high - value], 0)
        axes.errorbar(value, y + offset, xerr=spread, fmt="none", ecolor="black", elinewidth=0.9, capsize=2)
    names = [effects.factors[i] for i in order]
    shown = [name if name != NOISE else "noise (random numbers)" for name in short_names(names)]
    axes.set_yticks(y, shown, fontsize=9)
    axes.set(ylim=(len(order) - 0.4, -0.6), xlabel=label)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.grid(axis="x", color="#DDDDDD", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set_title(effects.note or f"{effects.rows} runs, intervals {100 * effects.level:g} %", fontsize=9, color=GREY)
    axes.legend(fontsize=8, loc="lower right")
    return save_figure(figure, path)


def _histogram_edges(finite: Any) -> tuple[float, float]:
    """Return the limits of a histogram of sorted values. Far outliers are outside."""
    if not len(finite):
        return 0.0, 1.0
    low, middle, high = np.percentile(finite, [5, 50, 95])
    reach = BEYOND * (high - low) or max(1e-3, abs(middle)) / 2
    left, right = max(finite[0], middle - reach), min(finite[-1], middle + reach)
    return (float(left), float(right)) if right > left else (left - reach, right + reach)


def _draw_limit(axes: Any, limit: float, left: float, right: float) -> None:
    """Draw a required limit as a line. If the limit is far outside the histogram, only the legend shows it."""
    name, style = f"limit {limit:g}", {"color": VERMILION, "linewidth": 1.2, "linestyle": "--"}
    if left - (right - left) <= limit <= right + (right - left):
        axes.axvline(limit, label=name, **style)
    else:
        axes.plot([], [], label=f"{name}, beyond the {'left' if limit < left else 'right'} edge", **style)


def _draw_band(axes: Any, band: Quantile, colour: str, left: float, right: float) -> None:
    inside = [float(np.clip(v, left, right)) for v in (band.low, band.high)]
    axes.axvspan(*inside, color=colour, alpha=0.25, linewidth=0)
    if np.isfinite(band.value) and left <= band.value <= right:
        axes.axvline(band.value, color=colour, linewidth=1.4)
    axes.plot([], [], color=colour, label=str(band))


def _quantile_interval(x: Any, p: float | None, level: float, anytime: bool) -> tuple[float, float, float]:
    if p is None:
        success = success_proportion(x, level, anytime=anytime)
        return success.share, success.low, success.high
    band = quantile(x, p, level, anytime=anytime)
    return band.value, band.low, band.high


def _estimate_limits(estimates: Any, limit: float | None) -> tuple[float, float]:
    """Return the vertical limits of the plot, from the second half of the estimates and confidence bands.

    A band without a limit extends to the edge of the plot.
    """
    shown = estimates[len(estimates) // 2 :]
    shown = np.r_[shown[np.isfinite(shown)], [] if limit is None else [limit]]
    if not len(shown):
        return 0.0, 1.0
    margin = 0.1 * float(np.ptp(shown)) or 1.0
    return float(shown.min()) - margin, float(shown.max()) + margin


def _new_axes(width: float, height: float, title: str) -> tuple["Figure", Any]:
    figure = new_figure(width, height)
    figure.suptitle(title, fontsize="medium")
    return figure, figure.add_subplot()
