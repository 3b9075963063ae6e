"""Style of all plots: colours, grid, titles, lines thinned to the resolution of a screen, and saving.

Colours: Okabe and Ito, "Color universal design", 2008. They can be distinguished without colour vision.
"""

import io
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.mcap import replace_file

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

BLUE, VERMILION, GREY, GREEN = "#0072B2", "#D55E00", "#707070", "#009E73"
ORANGE, PURPLE, SKY_BLUE = "#E69F00", "#CC79A7", "#56B4E9"
SEVERAL = (BLUE, ORANGE, GREEN, PURPLE, SKY_BLUE, VERMILION, "#000000")
DPI = 100
PicturePath = str | os.PathLike[str] | None
"""Path of the file in which a plot is saved, or None to save no file. The format is that of the suffix, PNG by default.
The file is written atomically."""
BINS = 600
"""Number of bins into which a line is divided before it is drawn, about the width of a panel in pixels. Of each bin,
only the extremes are drawn."""
COLUMNS, TURNS, SWINGS, STRETCH = 100, 4, (0.2, 0.5), 15
"""Criterion of chatter, i.e. of an oscillation whose period is only a few pixels wide. A line is divided into COLUMNS
columns. It chatters in STRETCH or more adjacent columns if it reverses at least TURNS times in each of these columns,
and if its range, as a fraction of the line's span, is at least the smaller number of SWINGS in each of these columns
and at least the larger number in half of them.
"""
CHATTER = "chatter: range and mean"
"""Legend entry for the range and the mean that are drawn instead of a chattering line."""


def new_figure(width: float, height: float) -> "Figure":
    """Return a new white figure of the given size (inches), with a layout without overlaps."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")


def style_grid(axes: Any) -> None:
    """Draw a light grid below all curves, and small tick labels."""
    axes.grid(color="#d8d8d8", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def style_axes(axes: Any, title: str, note: str = "", unit: str = "") -> None:
    """Style the panel of a signal: title at the left, note at the right, and unit of the signal."""
    axes.set_title(title, loc="left", fontsize=10, weight="bold")
    axes.set_title(note, loc="right", fontsize=8, color=GREY)
    axes.set_ylabel(unit if unit != "1" else "", fontsize=9)
    style_grid(axes)
    axes.tick_params(length=2)
    axes.spines[["top", "right"]].set_visible(False)


def decimate(t: np.ndarray, x: np.ndarray, bins: int = BINS) -> tuple[np.ndarray, np.ndarray]:
    """Return fewer points (m,), (m,) of a line (n,), (n,), which looks the same if drawn `bins` pixels wide.

    The line is divided into `bins` sections. Of each section, the lowest, the highest and the first missing point are
    kept. The first and the last point of the line are also kept, so that m <= 3 bins + 2.
    """
    n = len(x)
    if n <= 4 * bins:
        return t, x
    size = -(-n // bins)
    padded = np.append(x.astype(np.float64), np.full(-n % size, x[-1], np.float64)).reshape(-1, size)
    missing, start = np.isnan(padded), np.arange(len(padded)) * size
    low = start + np.where(missing, np.inf, padded).argmin(1)
    high = start + np.where(missing, -np.inf, padded).argmax(1)
    gaps = (start + missing.argmax(1))[missing.any(1)]
    kept = np.unique(np.concatenate([[0, n - 1], low, high, gaps]).clip(0, n - 1))
    return t[kept], x[kept]


def thin_rows(rows: Any, most: int) -> Any:
    """Return up to `most` of the indices `rows` (n,), evenly spread, including the first and the last."""
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]


def draw_line(axes: Any, t: np.ndarray, x: np.ndarray, *, logarithmic: bool = False, **look: Any) -> None:
    """Draw a line (n,), (n,) with a reduced number of points.

    Where the line chatters and would fill a solid area, its range (pale) and its mean are drawn. logarithmic: True if
    chatter is judged on a logarithmic scale.  look: options of `axes.plot`, including color.
    """
    x = np.asarray(x, np.float64)
    if len(x) > 4 * BINS:
        size = -(-len(x) // COLUMNS)
        low, high, mean = _column_ranges(x, size)
        busy = _chattering_columns(np.log10(x) if logarithmic else x, size)
        if busy.any():
            edges = np.minimum(np.arange(len(busy) + 1) * size, len(t) - 1)
            middles = (t[edges[1:]] + t[edges[:-1]]) / 2
            filled = np.append(busy, False) | np.append(False, busy)
            pale: dict[str, Any] = {"color": look["color"], "alpha": 0.3, "lw": 0, "zorder": 1.5, "label": CHATTER}
            low, high = np.append(low, low[-1]), np.append(high, high[-1])
            axes.fill_between(t[edges], low, high, where=filled, step="post", **pale)
            x = np.where(np.repeat(busy, size)[: len(x)], np.interp(t, middles[busy], mean[busy]), x)
    axes.plot(*decimate(t, x), **look)


def _column_ranges(x: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the lowest value, highest value and mean of each column of `size` points.

    The results of a column with a missing point are NaN.
    """
    padded = np.append(x, np.full(-len(x) % size, x[-1])).reshape(-1, size)
    return padded.min(1), padded.max(1), padded.mean(1)


def _chattering_columns(x: np.ndarray, size: int) -> np.ndarray:
    """Return a mask of the columns in which a line chatters.

    For the span of the line, the lowest and highest columns are ignored, because the line may start far away.
    """
    low, high, _ = _column_ranges(x, size)
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return known
    span = np.percentile(high[known], 95) - np.percentile(low[known], 5)
    change = np.diff(x)
    moves = np.flatnonzero(change)
    turns = moves[1:][change[moves[1:]] * change[moves[:-1]] < 0]
    turning = known & (np.bincount(turns // size, minlength=len(low)) >= TURNS)
    swing = np.where(known, high - low, 0.0) / max(span, np.finfo(float).tiny)
    busy, much = (turning & (swing >= share) for share in SWINGS)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], busy.astype(np.int8), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        busy[a:b] = b - a >= STRETCH and 2 * np.count_nonzero(much[a:b]) >= b - a
    return busy


def has_chatter(axes: Any) -> bool:
    """Return True if a chattering line has been drawn in the axes."""
    return any(one.get_label() == CHATTER for one in axes.collections)


def save_figure(
    figure: "Figure", path: PicturePath, title: str = "", note: str = "", *, title_size: float = 13
) -> "Figure":
    """Add a title at the upper left and a note at the upper right, and save the figure if a path is given."""
    if title:
        figure.suptitle(title, fontsize=title_size, weight="bold", x=0.01, ha="left")
    if note:
        figure.text(0.99, 0.99, note, fontsize=10, color=GREY, ha="right", va="top")
    figure.__dict__["_repr_png_"] = partial(_draw_png, figure)  # notebooks use this to display the figure
    if path is None:
        return figure
    file, kinds = Path(path), figure.canvas.get_supported_filetypes()
    kind = file.suffix.lstrip(".").lower() or "png"
    if kind not in kinds:
        raise InputError(
            f"plot '{file}'", f"cannot be saved as {kind!r}", choices=kinds, fix="use a file name that ends in .png"
        )
    fast: dict[str, Any] = {"pil_kwargs": {"compress_level": 3}} if kind == "png" else {}
    with replace_file(file) as stream:
        figure.savefig(stream, format=kind, dpi=DPI, **fast)
    return figure


def _draw_png(figure: "Figure") -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI)
    return stream.getvalue()
