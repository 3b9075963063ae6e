"""Plan view of a run: north against east, with heading marks, truth, estimate, reference and fence.

A plan view is drawn if the true state contains north and east, or if the vehicle moves in three dimensions
(`logs.spatial`). For a vehicle in three dimensions, a profile (altitude over distance flown) can also be drawn.
Estimate and reference are drawn if the log contains them. North is up and east is to the right, at the same scale.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.spatial import FLIGHT, with_flight
from trimtab.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    PicturePath,
    new_figure,
    save_figure,
    style_axes,
    thin_rows,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

POINTS = 2000
"""Maximum number of points of a drawn line."""
MARKS = 14
"""Number of marks along the path that show the heading."""
MARK_LENGTH = 0.05
"""Length of a heading mark, as a fraction of the plot."""
EXTENT_MIN = 0.5
"""Smallest extent of the plot (m)."""
FENCE_FARTHEST = 0.7
"""Largest distance of a fence that is drawn, as a multiple of the extent of the flight. A fence farther away is left
out."""


class Fence(NamedTuple):
    """Position bounds of a supervisor (m): north, east, and distance from the origin. Infinity means no bound."""

    south: float = -np.inf
    north: float = np.inf
    west: float = -np.inf
    east: float = np.inf
    distance: float = np.inf


def has_plan(log: Log) -> bool:
    """Return True if a plan view can be drawn from the log."""
    prefix = _prefix(log)
    return all(prefix + n in log and log[prefix + n].ndim == 1 for n in ("north", "east")) and len(log) > 0


def has_profile(log: Log) -> bool:
    """Return True if the log contains altitude and position of the vehicle, so that a profile can be drawn."""
    return has_plan(log) and f"{FLIGHT}altitude" in log


def _prefix(log: Log) -> str:
    """Return the prefix of the log paths of north and east: "flight." if the derived signals exist, else "truth."."""
    return FLIGHT if f"{FLIGHT}north" in log else "truth."


def plot_plan(log: Log, ideal: Log | None = None, path: PicturePath = None, title: str = "") -> "Figure":
    """Draw the plan view of a run in its own figure.

    Args:
        log: log of the run.
        ideal: log of the ideal run, drawn for comparison, or None.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.

    Raises:
        InputError: the log contains no north and east position.
    """
    log, ideal = with_flight(log), None if ideal is None else with_flight(ideal)
    if not has_plan(log):
        problem = "the truth in the log has no north and east"
        raise InputError("plot_plan", problem, fix="draw it with plot_run instead")
    figure = new_figure(8.0, 7.0)
    axes: Any = figure.add_subplot()
    draw_plan(axes, log, ideal)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    return save_figure(figure, path, title)


def draw_plan(axes: Any, log: Log, ideal: Log | None = None) -> None:
    """Draw the plan view of a run into a panel."""
    north, east = (log[_prefix(log) + name] for name in ("north", "east"))
    size, shown = _span(north, east), thin_rows(np.arange(len(log)), POINTS)
    _draw_fence(axes, find_fence(log.metadata.get("parameters") or {}), north, east)
    if "law.north_reference" in log and "law.east_reference" in log:
        wanted = log["law.east_reference"][shown], log["law.north_reference"][shown]
        asked = _is_valid(log)[shown]
        axes.plot(*(np.where(asked, x, np.nan) for x in wanted), color=GREEN, lw=2.5, alpha=0.5, label="reference")
    if ideal is not None and has_plan(ideal):
        at = thin_rows(np.arange(len(ideal)), POINTS)
        way = (ideal[_prefix(ideal) + name][at] for name in ("east", "north"))
        axes.plot(*way, color=VERMILION, lw=1.1, ls="--", label="ideal")
    axes.plot(east[shown], north[shown], color=BLUE, lw=1.4, label="truth")
    if "estimate.state.north" in log and "estimate.state.east" in log:
        valid = _is_valid(log)[shown]
        guess = (np.where(valid, log[f"estimate.state.{n}"][shown], np.nan) for n in ("east", "north"))
        axes.plot(*guess, color=ORANGE, lw=0.8, label="estimate")
    axes.plot(east[:1], north[:1], "o", color=BLUE, mfc="white", ms=6)
    axes.plot(east[-1:], north[-1:], "o", color=BLUE, ms=5)
    heading = _heading(log, "truth")
    if heading is not None:
        _draw_headings(axes, heading, np.array([east, north]), MARK_LENGTH * size)
    style_axes(axes, "Plan", "○ start   ● end   short lines: nose", "north (m)")
    axes.set_xlabel("east (m)", fontsize=9)
    axes.set_aspect("equal", adjustable="datalim")
    ends = np.array([_ends(east), _ends(north)])
    room = np.maximum(EXTENT_MIN - np.diff(ends)[:, 0], 0.16 * size) / 2
    axes.update_datalim([ends[:, 0] - room, ends[:, 1] + room])
    axes.autoscale_view()


def find_path(log: Log, block: str) -> tuple[Any, Any] | None:
    """Return the path (n, 2) east, north, and the heading (n,) or None, of the block "truth" or "estimate" of a log.

    Return None if the block contains no position. Rows without a valid estimate are NaN.
    """
    prefix = _prefix(log) if block == "truth" else "estimate.state."
    if not all(f"{prefix}{name}" in log for name in ("east", "north")):
        return None
    path = np.stack([log[f"{prefix}{name}"] for name in ("east", "north")], axis=1)
    if block == "estimate":
        path = np.where(_is_valid(log)[:, None], path, np.nan)
    return path, _heading(log, block)


def _heading(log: Log, block: str) -> Any:
    """Return the heading (n,) of the truth or of the estimate, or None."""
    paths = (f"{FLIGHT}yaw", "truth.heading") if block == "truth" else ("estimate.state.heading",)
    return next((log[p] for p in paths if p in log), None)


def find_fence(parameters: Mapping[str, Any]) -> Fence:
    """Return the tightest position bounds in the settings of a logged run."""
    bounds: dict[str, float] = {}
    for path, fields in parameters.items():
        head, _, name = path.rpartition(".")
        if name != "fields" or ".supervisor.limits." not in path:
            continue
        low, high = float(parameters[f"{head}.low"]), float(parameters[f"{head}.high"])
        for field, lower, upper in (("north", "south", "north"), ("east", "west", "east")):
            if tuple(fields) == (field,):
                bounds[lower] = max(low, bounds.get(lower, -np.inf))
                bounds[upper] = min(high, bounds.get(upper, np.inf))
        if set(fields) == {"north", "east"}:
            bounds["distance"] = min(high, bounds.get("distance", np.inf))
    return Fence(**bounds)


def _draw_fence(axes: Any, fence: Fence, north: Any, east: Any) -> None:
    """Draw the sides of a fence that are near the flight."""
    size, look = _span(north, east), {"color": GREY, "lw": 1.2, "ls": ":"}
    label = {"label": "fence"}
    sides = ((fence.south, north, axes.axhline), (fence.north, north, axes.axhline))
    for at, along, draw in (*sides, (fence.west, east, axes.axvline), (fence.east, east, axes.axvline)):
        if np.isfinite(at) and np.abs(along - at).min() < FENCE_FARTHEST * size:
            draw(at, **look, **label)
            label = {}
    if fence.distance < FENCE_FARTHEST * size + np.hypot(north, east).max():
        angle = np.linspace(0, 2 * np.pi, 200)
        axes.plot(fence.distance * np.sin(angle), fence.distance * np.cos(angle), **look, **label)


def draw_profile(axes: Any, log: Log, ideal: Log | None = None) -> None:
    """Draw the altitude of a vehicle over the distance flown into a panel."""
    for one, colour, look in ((ideal, VERMILION, "--"), (log, BLUE, "-")):
        if one is None or not has_profile(one):
            continue
        shown, up = thin_rows(np.arange(len(one)), POINTS), one[f"{FLIGHT}altitude"]
        steps = np.hypot(*(np.diff(one[FLIGHT + name]) for name in ("north", "east")))
        way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
        axes.plot(way[shown], up[shown], color=colour, lw=1.2, ls=look)
        if one is log:
            axes.plot(way[:1], up[:1], "o", color=BLUE, mfc="white", ms=6)
            axes.plot(way[-1:], up[-1:], "o", color=BLUE, ms=5)
    style_axes(axes, "Profile", "", "altitude (m)")
    axes.set_xlabel("distance over the ground (m)", fontsize=9)


def _draw_headings(axes: Any, headings: Any, places: Any, length: float) -> None:
    """Draw short lines in the direction of the craft's nose, at evenly spaced times. places: east, north (2, n)."""
    at = np.unique(np.linspace(0, len(headings) - 1, MARKS).astype(int))
    heading, places = headings[at], places[:, at]
    ahead = length * np.array([np.sin(heading), np.cos(heading)])
    for place, tip in zip(places.T, (places + ahead).T, strict=True):
        axes.plot(*zip(place, tip, strict=True), color=BLUE, lw=2.2, solid_capstyle="round")


def _is_valid(log: Log) -> Any:
    return log["estimate.valid"].astype(bool) if "estimate.valid" in log else np.ones(len(log), bool)


def _ends(x: Any) -> tuple[float, float]:
    known = x[np.isfinite(x)]
    return (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)


def _span(north: Any, east: Any) -> float:
    return max(EXTENT_MIN, *(high - low for low, high in (_ends(north), _ends(east))))
