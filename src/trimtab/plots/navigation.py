"""Plot of a run's navigation: errors with bands of two sigmas as computed by the filter, and NIS of the
measurements."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.consistency import gate_threshold
from trimtab.logs.log import Log
from trimtab.logs.navigation import Series, assess_navigation, innovations, state_series
from trimtab.logs.spatial import display_unit
from trimtab.plots.style import BLUE, GREY, VERMILION, PicturePath, decimate, new_figure, save_figure, style_axes

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
COLUMNS, WIDTH, ROW_HEIGHT, TOP = 3, 16.0, 2.1, 0.7
ROOM = 1.6
"""Range of the axes, as a multiple of errors and bands late in the run. Errors at the start may be outside."""


def plot_navigation(log: Log, path: PicturePath = None, title: str = "Navigation") -> "Figure":
    """Draw the errors (estimate minus truth) with bands of two sigmas, estimated biases, and NIS with its 95 % limit.

    Args:
        log: log of a run whose estimate has sigmas and innovations.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot. The verdict on the consistency of the filter is appended.
    """
    states, aided = state_series(log), innovations(log)
    if not states:
        problem = "the estimate in the log has no sigmas"
        raise InputError("plot_navigation", problem, fix="log all signals of a run with an aided INS")
    judged = assess_navigation(log)
    states = {name: one for name, one in states.items() if len(one.t)}
    known = [n for n in states if states[n].error is not None]
    names = [*known, *(n for n in states if n not in known)]
    rows = max(1, -(-(len(names) + len(aided)) // COLUMNS))
    figure = new_figure(WIDTH, TOP + rows * ROW_HEIGHT)
    every: Any = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    for axes, name in zip(every.flat, names, strict=False):
        unit, factor = _unit(log, name)
        s = states[name]
        error = None if s.error is None else s.error * factor
        _draw_state(axes, name, Series(s.t, s.estimate * factor, error, s.sigma * factor), unit)
    for axes, (name, one) in zip(every.flat[len(names) :], aided.items(), strict=False):
        _draw_nis(axes, name, *one)
    _label_times(every.flat, len(names) + len(aided))
    ends = [s.t[i] for s in states.values() for i in (0, -1)]
    if ends and min(ends) < max(ends):
        every[0, 0].set_xlim(min(ends), max(ends))
    title = title if states else f"{title}, no estimate became valid"
    verdict = "" if judged is None else f", {judged.verdict}"
    legend = "blue: error, or bias as estimated; grey: two sigmas; orange: outside"
    return save_figure(figure, path, f"{title}{verdict}", legend, title_size=14)


def _unit(log: Log, name: str) -> tuple[str, float]:
    """Return the display unit of a state, and the factor of conversion to this unit."""
    path = next((p for p in log.paths if p.startswith("estimate.") and p.endswith(f".{name}")), "")
    return display_unit(path, log.unit(path) if path else "")


def _label_times(every: Any, used: int) -> None:
    """Label the time axis of the lowest panel in each column, and remove unused panels."""
    for axes in every[used:]:
        axes.set_axis_off()
    for axes in every[max(0, used - COLUMNS) : used]:
        axes.set_xlabel("time (s)", fontsize=9)
        axes.tick_params(labelbottom=True)


def _draw_state(axes: Any, name: str, s: Series, unit: str) -> None:
    """Draw the error of a state, or the estimate if the log does not contain the true value of the state."""
    middle = s.estimate if s.error is None else np.zeros(len(s.t))
    shown = s.estimate if s.error is None else s.error
    low, high = (decimate(s.t, middle + k * s.sigma) for k in (-2, 2))
    axes.fill_between(low[0], low[1], np.interp(low[0], *high), color=GREY, alpha=0.25, lw=0)
    axes.plot(*decimate(s.t, shown), color=BLUE, lw=0.9)
    if s.error is not None:
        outside = np.where(np.abs(s.error) > 2 * s.sigma, s.error, np.nan)
        axes.plot(s.t, outside, color=VERMILION, lw=1.1, marker=".", ms=1.5)
    late = slice(len(s.t) // 4, None)
    centre = float(np.median(shown[late]))
    reach = max(np.max(np.abs(shown[late] - centre)), np.max(2 * s.sigma[late] + np.abs(middle - centre)[late]))
    if np.isfinite(reach) and reach > 0:
        axes.set_ylim(centre - ROOM * reach, centre + ROOM * reach)
    words = name.replace("_", " ")
    inside = "" if s.error is None else f"{100 * np.mean(np.abs(s.error) <= 2 * s.sigma):.0f} % within two sigmas"
    style_axes(axes, f"{words[0].upper()}{words[1:]}{'' if s.error is None else ' error'}", inside, unit)


def _draw_nis(axes: Any, name: str, t: Any, nis: Any, dof: int) -> None:
    """Draw the NIS of each update on a logarithmic scale, with the 95 % limit and the expected mean."""
    limit = gate_threshold(dof, 0.95)
    axes.plot(t, np.where(nis > 0, nis, np.nan), ".", color=BLUE, ms=3, alpha=0.5)
    axes.plot(t, np.where(nis > limit, nis, np.nan), ".", color=VERMILION, ms=3)
    axes.axhline(limit, color=GREY, lw=1, ls="--")
    axes.set_yscale("log")
    axes.set_ylim(1e-3, max(30.0, 2 * float(np.max(nis[np.isfinite(nis)], initial=1.0))))
    style_axes(axes, f"NIS of {name}", f"{100 * np.mean(nis <= limit):.0f} % below the 95 % line", "")
