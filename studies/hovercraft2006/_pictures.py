"""Plots of the study: panels of curves, with the axis limits of the thesis's figures where these are known."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

WIDTH, HEIGHT = 4.2, 2.6


class Panel(NamedTuple):
    """One plot with its curves.

    curves: (x, y, label or "", Matplotlib style).  limits: limits of y; None if unknown.
    equal: True for the same scale of x and y.
    """

    title: str
    xlabel: str
    ylabel: str
    curves: tuple[tuple[Any, Any, str, str], ...]
    limits: tuple[float, float] | None = None
    equal: bool = False


def draw_panels(path: Path, title: str, panels: Iterable[Panel], columns: int = 1) -> Path:
    """Draw panels row by row into one picture."""
    from matplotlib.figure import Figure

    every = list(panels)
    rows = -(-len(every) // columns)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(WIDTH * columns, 0.5 + HEIGHT * rows), layout="constrained")
    figure.suptitle(title)
    for n, panel in enumerate(every):
        axes = figure.add_subplot(rows, columns, n + 1)
        for x, y, label, style in panel.curves:
            axes.plot(x, y, style, label=label or None, linewidth=0.9, markersize=4)
        axes.set(title=panel.title, xlabel=panel.xlabel, ylabel=panel.ylabel)
        axes.grid(alpha=0.3)
        if panel.equal:
            axes.set_aspect("equal", adjustable="datalim")
        if panel.limits is not None:
            axes.set_ylim(*panel.limits)
        if any(label for _, _, label, _ in panel.curves):
            axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=100)
    return path
