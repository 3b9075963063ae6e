"""A picture of a campaign's worlds: each a line through its parameters, failures on top.

Source: Inselberg, "The plane with parallel coordinates", The Visual Computer 1 (1985). Colours: Okabe and Ito, "Color
universal design", 2008.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.campaign.statistics.quantiles import column
from trimtab.core.errors import InputError
from trimtab.plots.run import BLUE, DPI, GREY, VERMILION, save

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

MOST_LINES = 400
"""So many worlds of a kind are drawn as lines at most; more would be one surface."""


def plot_parallel(
    parameters: Mapping[str, Any],
    success: Any,
    path: str | os.PathLike[str] | None = None,
    title: str = "",
) -> "Figure":
    """Draw each world as a line through its parameters, failures on top; of many, some, and says how many.

    Args:
        parameters: values by name, each of shape (n,): numbers, finite.
        success: of each run, shape (n,).
        path: where to save (PNG, or what the suffix says; the file appears whole or not at all); None: nowhere.
        title: what to write above.
    """
    from matplotlib.figure import Figure

    good = column(success, "plot_parallel") > 0
    names = list(parameters)
    place, low, high = _places(parameters, len(good))
    figure = Figure(figsize=(10.0, 5.2), dpi=DPI, facecolor="white", layout="constrained")
    figure.suptitle(title, fontsize="medium")
    axes: Any = figure.add_subplot()
    k = np.arange(len(names))
    for chosen, colour, word, order in ((good, BLUE, "succeeded", 1), (~good, VERMILION, "failed", 2)):
        rows = thinned(np.flatnonzero(chosen), MOST_LINES)
        _draw_lines(axes, place[:, rows].T, colour, order)
        axes.plot([], [], color=colour, label=f"{chosen.sum()} {word}, {len(rows)} of them drawn")
    for i in k:
        axes.plot([i, i], [0, 1], color="#404040", linewidth=0.8, zorder=3)
        for y, value, side in ((-0.02, low[i], "top"), (1.02, high[i], "bottom")):
            axes.text(i, y, f"{value:.3g}", ha="center", va=side, fontsize=8, color=GREY)
    axes.set(xlim=(-0.4, len(names) - 0.6), ylim=(-0.08, 1.08), yticks=[])
    axes.set_xticks(k, short_names(names), rotation=30, ha="right", fontsize=9)
    axes.tick_params(axis="x", length=0)
    axes.spines[:].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    if path is not None:
        save(figure, Path(path))
    return figure


def thinned(rows: Any, most: int) -> Any:
    """Up to `most` of the rows, evenly spread over them, the first and the last included."""
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]


def _places(parameters: Mapping[str, Any], runs: int) -> tuple[Any, Any, Any]:
    """Where each run lies on each axis, 0 to 1, shape (parameters, runs); smallest and largest value of each."""
    names, table = list(parameters), np.array([column(v, f"plot_parallel: {n}") for n, v in parameters.items()])
    if not names or table.shape[1] != runs or not np.isfinite(table).all():
        problem = f"{len(names)} parameters of {table.shape[1:]} runs, success of {runs}: no finite value of each"
        raise InputError("plot_parallel", problem, fix="give one finite number for each run and parameter")
    low, high = table.min(axis=1), table.max(axis=1)
    place = (table - low[:, None]) / np.where(high > low, high - low, 1.0)[:, None]
    place[high == low] = 0.5
    return place, low, high


def _draw_lines(axes: Any, places: Any, colour: str, order: int) -> None:
    """Lines of places (worlds, parameters), the fainter the more there are; a higher order lies on top."""
    from matplotlib.collections import LineCollection

    k = np.arange(places.shape[1])
    lines = [np.stack([k, world], axis=1) for world in places]
    faint = float(np.clip(40 * order / max(len(places), 1), 0.12 * order, 0.9))
    axes.add_collection(LineCollection(lines, colors=colour, alpha=faint, linewidths=0.5 * order**0.5, zorder=order))


def short_names(names: Sequence[str]) -> list[str]:
    """Paths by as many of their last parts as it takes to tell them apart."""
    parts = [name.split(".") for name in names]
    for count in range(1, max(map(len, parts)) + 1):
        short = [".".join(p[-count:]) for p in parts]
        if len(set(short)) == len(short):
            return short
    return list(names)
