"""Plot of the dilution of precision over the floor, with the beacons and the edges of the beacons' cones."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.plots.style import VERMILION, PicturePath, new_figure, save_figure

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

    from trimtab.design.dilution import DilutionMap

LEVELS = (0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)


def plot_dilution(
    dilution_map: "DilutionMap", path: PicturePath = None, title: str = "Dilution of precision"
) -> "Figure":
    """Draw a map of the dilution of precision, with north up and east to the right.

    In white areas no fix is possible. The number of visible beacons changes at each line.

    Args:
        dilution_map: map to draw.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    from matplotlib.colors import BoundaryNorm

    figure = new_figure(7.0, 5.8)
    axes: Any = figure.add_subplot()
    values = np.ma.masked_invalid(np.asarray(dilution_map.dilution))
    colours = axes.pcolormesh(
        dilution_map.east,
        dilution_map.north,
        values,
        cmap="cividis",
        norm=BoundaryNorm(LEVELS, 256, extend="both"),
        shading="nearest",
    )
    figure.colorbar(colours, ax=axes, label="error of a fix / error of a range")
    counts = np.asarray(dilution_map.visible)
    edges = [k + 0.5 for k in range(int(counts.min()), int(counts.max()))]
    if edges:
        axes.contour(dilution_map.east, dilution_map.north, counts, levels=edges, colors="#707070", linewidths=0.7)
    beacons = np.asarray(dilution_map.beacons)
    axes.plot(beacons[:, 1], beacons[:, 0], "^", color=VERMILION, markersize=9, markeredgecolor="white", label="beacon")
    axes.set(xlabel="east (m)", ylabel="north (m)", title=title, aspect="equal")
    axes.legend(loc="upper right", framealpha=0.9)
    return save_figure(figure, path)
