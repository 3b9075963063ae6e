"""Plot of a model inversion: states and inputs for outputs that follow a trajectory exactly."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.design.output_inversion import Inversion
from trimtab.plots.style import GREY, SEVERAL, PicturePath, new_figure, save_figure, style_axes

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

DRAWN_MOTION_MIN = 0.01
"""Smallest motion of a state that is drawn, relative to the largest motion of a state in the same unit. Outputs are
always drawn."""
ROUNDING = 1e-6
"""Change of a state, relative to the state's magnitude, below which the state counts as constant."""


def plot_inversion(
    found: Inversion,
    states: tuple[str, ...],
    inputs: tuple[str, ...],
    span: tuple[float, float],
    path: PicturePath = None,
    title: str = "",
    units: Mapping[str, str] | None = None,
    outputs: tuple[str, ...] = (),
) -> "Figure":
    """Draw outputs, other states that change, and inputs over time. The time in which the outputs change is shaded.

    Args:
        found: result of the model inversion.
        states, inputs: names of the states and inputs, in the order of the columns.
        span: times (s) at which the outputs begin and cease to change.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
        units: name of a state or input -> unit. Angles in rad are drawn in degrees.
        outputs: names of the outputs that follow the trajectory. Outputs that are also states are drawn first.
    """
    units = units or {}
    moves = dict(zip(states, np.ptp(found.x, axis=0).tolist(), strict=True))
    most = {n: max(moves[m] for m in states if units.get(m) == units.get(n)) for n in states}
    sizes = dict(zip(states, np.abs(found.x).max(axis=0).tolist(), strict=True))
    moving = [n for n in states if moves[n] > max(DRAWN_MOTION_MIN * most[n], ROUNDING * sizes[n]) and n not in outputs]
    moving = [*(n for n in outputs if n in states), *moving]
    columns = dict(zip((*states, *inputs), np.column_stack([found.x, found.u]).T, strict=True))
    names = [*moving, *inputs]
    figure = new_figure(7.0, 0.8 + 1.35 * len(names))
    axes: Any = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    for ax, name in zip(axes, names, strict=True):
        unit = units.get(name, "")
        scale = 180 / np.pi if unit in ("rad", "rad/s") else 1.0
        shown = unit.replace("rad", "deg")
        style_axes(ax, name, title if ax is axes[0] else "", shown)
        ax.axvspan(*span, color=GREY, alpha=0.15, lw=0)
        ax.plot(found.times, scale * columns[name], color=SEVERAL[1 if name in inputs else 0])
    axes[-1].set_xlabel("time (s)")
    return save_figure(figure, path)
