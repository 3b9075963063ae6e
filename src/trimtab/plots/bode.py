"""Bode plot of a control loop that is opened at one command at a time, while all other commands stay closed."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.design.loop_map import LoopMap, find_crossings
from trimtab.plots.style import GREY, SEVERAL, PicturePath, new_figure, save_figure, style_axes

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure


DASHES = ("-", (0, (6, 6)), (0, (2, 6)))
"""Line styles with gaps, so that two equal curves are both visible."""


def plot_bode(loop: LoopMap, path: PicturePath = None, title: str = "") -> "Figure":
    """Draw magnitude and phase of the loop opened at each command. A dot marks magnitude 1, with the phase margin.

    Args:
        loop: linear map of the loop.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    figure = new_figure(7.0, 5.6)
    axes: Any = figure.subplots(2, 1, sharex=True)
    w = loop.grid()
    values, crossings = loop.broken_loops(w), find_crossings(loop)
    style_axes(axes[0], "magnitude", f"{title}: loop opened at one command at a time", "dB")
    style_axes(axes[1], "phase", "", "degrees")
    for k, (column, name, colour) in enumerate(zip(values.T, loop.commands, SEVERAL, strict=False)):
        dashes = DASHES[k % len(DASHES)]
        size = 20 * np.log10(np.maximum(np.abs(column), 1e-12))
        phase = np.degrees(np.unwrap(np.angle(column)))
        if crossings[name]:  # at magnitude 1, the phase margin is the phase above -180 degrees
            frequency, margin = crossings[name][-1]
            own = np.interp(np.log(frequency), np.log(w), phase)
            phase -= 360 * np.round((own - np.degrees(margin) + 180) / 360)
        drawn = size > -80
        if not drawn.any():
            continue
        axes[0].semilogx(w[drawn], size[drawn], color=colour, ls=dashes, label=name)
        axes[1].semilogx(w[drawn], phase[drawn], color=colour, ls=dashes)
        for frequency, margin in crossings[name]:
            at = np.interp(np.log(frequency), np.log(w), phase)
            axes[0].plot(frequency, 0, "o", ms=5, color=colour)
            axes[1].plot(frequency, at, "o", ms=5, color=colour)
            place = {"xytext": (5, 7), "textcoords": "offset points", "fontsize": 9, "color": colour}
            axes[1].annotate(f"{np.degrees(margin):.0f}°", (frequency, at), **place)
    axes[0].axhline(0, color=GREY, lw=0.8)
    axes[1].axhline(-180, color=GREY, lw=0.8, ls="--")
    axes[1].set_ylim(max(axes[1].get_ylim()[0], -900), None)
    axes[1].set_xlabel("frequency (rad/s)")
    axes[0].legend(frameon=False, fontsize=9)
    return save_figure(figure, path)
