"""Plot of a swarm's run: paths of all craft from above, and distances between craft over time."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.plots.style import (
    BLUE,
    GREY,
    SEVERAL,
    VERMILION,
    PicturePath,
    decimate,
    new_figure,
    save_figure,
    style_axes,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 14.0, 7.0
WAY_POINTS = 400
"""Maximum number of points of a craft's path that are drawn."""
NOSE = 0.45
"""Length of the mark that shows the direction of a craft's nose (m)."""


def plot_swarm(real: Log, ideal: Log | None = None, path: PicturePath = None, title: str = "Swarm") -> "Figure":
    """Draw the paths of all craft from above, and their smallest spacing and largest position error over time.

    Args:
        real: log of a run with north, east and heading of several craft in the true state.
        ideal: log of the ideal run, drawn for comparison, or None.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    if "truth.north" not in real or real["truth.north"].ndim != 2:
        problem = "the truth in the log is not that of several craft"
        raise InputError("plot_swarm", problem, fix="draw it with plot_run instead")
    figure = new_figure(WIDTH, HEIGHT)
    panels: Any = figure.subplot_mosaic([["floor", "spacing"], ["floor", "formation_error"]], width_ratios=(1.1, 1.0))
    _draw_floor(panels["floor"], real)
    notes = (
        ("spacing", "smallest distance between two craft"),
        ("formation_error", "largest distance from the desired position"),
    )
    for name, note in notes:
        _draw_distance(panels[name], real, ideal, name, note)
    panels["formation_error"].set_xlabel("time (s)", fontsize=9)
    return save_figure(figure, path, title, "blue: real; red: ideal; dot: start; stroke: nose at the end")


def _draw_floor(axes: Any, log: Log) -> None:
    north, east, heading = (log[f"truth.{name}"] for name in ("north", "east", "heading"))
    every = max(1, len(log) // WAY_POINTS)
    several = north.shape[1] <= len(SEVERAL)
    for i in range(north.shape[1]):
        colour = SEVERAL[i] if several else VERMILION if i == 0 else BLUE
        axes.plot(east[::every, i], north[::every, i], color=colour, lw=0.8, alpha=0.6)
        axes.plot(east[0, i], north[0, i], ".", color=GREY, ms=5)
        tip = east[-1, i] + NOSE * np.sin(heading[-1, i]), north[-1, i] + NOSE * np.cos(heading[-1, i])
        axes.plot([east[-1, i], tip[0]], [north[-1, i], tip[1]], color=colour, lw=2)
        axes.plot(east[-1, i], north[-1, i], "o", color=colour, ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    style_axes(axes, f"{north.shape[1]} craft from above", "craft 0 leads" if several else "red: craft 0, which leads")
    axes.set_xlabel("east (m)", fontsize=9)
    axes.set_ylabel("north (m)", fontsize=9)


def _draw_distance(axes: Any, real: Log, ideal: Log | None, name: str, note: str) -> None:
    said = ""
    for log, colour in ((ideal, VERMILION), (real, BLUE)):
        path = "" if log is None else next((p for p in log.paths if p.startswith("sensors.") and p.endswith(name)), "")
        if log is not None and path:
            axes.plot(*decimate(log.t, log[path]), color=colour, lw=1.0)
            said = f"least {log[path].min():.3g} m" if name == "spacing" else f"at the end {log[path][-1]:.2g} m"
    style_axes(axes, note[0].upper() + note[1:], said, "m")
    axes.set_ylim(bottom=0)
