"""How every picture looks: colours, grid, titles, lines thinned to what a screen shows, and how it is saved.

Colours: Okabe and Ito, "Color universal design", 2008; told apart also without colour vision.
"""

import os
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
"""Where a picture is saved: PNG, or what the suffix says; the file appears whole or not at all. None: nowhere."""
BINS = 600
"""Bins to a line: about the pixels of a panel's width. Each keeps its extremes."""


def new_figure(width: float, height: float) -> "Figure":
    """A white figure, inches, whose panels make room for one another."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")


def style_grid(axes: Any) -> None:
    """A light grid below all that is drawn, and small numbers."""
    axes.grid(color="#d8d8d8", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def style_axes(axes: Any, title: str, note: str = "", unit: str = "") -> None:
    """One panel of a signal: its title on the left, a note on the right, its unit beside it."""
    axes.set_title(title, loc="left", fontsize=10, weight="bold")
    axes.set_title(note, loc="right", fontsize=8, color=GREY)
    axes.set_ylabel(unit if unit != "1" else "", fontsize=9)
    style_grid(axes)
    axes.tick_params(length=2)
    axes.spines[["top", "right"]].set_visible(False)


def decimate(t: np.ndarray, x: np.ndarray, bins: int = BINS) -> tuple[np.ndarray, np.ndarray]:
    """Of each of `bins` stretches of a line the lowest, the highest and the first missing point; and both ends.

    Drawn at that many pixels the picture is the same. Shapes (n,) and (n,) come back as (m,) and (m,), m <= 3 bins + 2.
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


def save_figure(
    figure: "Figure", path: PicturePath, title: str = "", note: str = "", *, title_size: float = 13
) -> "Figure":
    """Write a title in the upper left corner, a note in the upper right, and save the figure where there is a path."""
    if title:
        figure.suptitle(title, fontsize=title_size, weight="bold", x=0.01, ha="left")
    if note:
        figure.text(0.99, 0.99, note, fontsize=10, color=GREY, ha="right", va="top")
    if path is None:
        return figure
    file, kinds = Path(path), figure.canvas.get_supported_filetypes()
    kind = file.suffix.lstrip(".").lower() or "png"
    if kind not in kinds:
        raise InputError(f"plot '{file}'", f"cannot be saved as {kind!r}", choices=kinds, fix="name it something.png")
    fast: dict[str, Any] = {"pil_kwargs": {"compress_level": 3}} if kind == "png" else {}
    with replace_file(file) as stream:
        figure.savefig(stream, format=kind, dpi=DPI, **fast)
    return figure
