"""Plot of a stability map: success rates, traced boundary, simulated points, and curves of theoretical criteria."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.analysis.campaign.search.axes import Axis
from trimtab.analysis.campaign.search.map_theory import StabilityCriterion
from trimtab.analysis.campaign.search.stability_map import StabilityMap
from trimtab.plots.style import BLUE, GREEN, ORANGE, PURPLE, SKY_BLUE, VERMILION, PicturePath, new_figure, save_figure

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
LINES = {
    "delay margin": (VERMILION, "--"),
    "jitter margin": (GREEN, "-."),
    "packet loss": (PURPLE, ":"),
}


def plot_stability_map(
    region: StabilityMap,
    path: PicturePath = None,
    title: str = "",
    *,
    theory: Iterable[StabilityCriterion] = (),
) -> "Figure":
    """Draw a stability map: blue where runs succeed, orange where runs fail, and a dot for each simulated point.

    Args:
        region: stability map to draw.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot. Default: the scenario's name.
        theory: theoretical stability criteria, whose curves are also drawn.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.lines import Line2D

    figure = new_figure(6.4, 5.2)
    axes: Any = figure.subplots()
    colours = LinearSegmentedColormap.from_list("success", [ORANGE, "white", SKY_BLUE])
    (x, y), share = region.sample_points.T, region.share
    means = _cell_means(region).T
    image = axes.pcolormesh(region.at_x, region.at_y, means, cmap=colours, vmin=0, vmax=1, rasterized=True)
    axes.scatter(x, y, s=4, c="#404040", linewidths=0)
    handles: list[Any] = [Line2D([], [], color="#404040", marker="o", markersize=3, linewidth=0, label="flown")]
    if share.min() < region.traced_boundary.threshold <= share.max():
        axes.tricontour(x, y, share, levels=[region.traced_boundary.threshold], colors="black", linewidths=1.6)
        handles.append(Line2D([], [], color="black", linewidth=1.6, label="boundary"))
    handles += [handle for one in theory for handle in _draw_criterion(axes, one)]
    axes.set(xlabel=_label(region.x), ylabel=_label(region.y))
    axes.set_xlim(region.at_x[0], region.at_x[-1])
    axes.set_ylim(region.at_y[0], region.at_y[-1])
    figure.colorbar(image, label=f"share of {region.runs} runs that succeed" if region.runs > 1 else "success")
    points = f"{region.traced_boundary.evaluated_points} points flown of {region.traced_boundary.of}"
    axes.set_title(f"{title or region.scenario.name}: {points}", fontsize="medium")
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return save_figure(figure, path)


def _draw_criterion(axes: Any, one: StabilityCriterion) -> list[Any]:
    """Draw the curves of a theoretical criterion, and return the legend entries of these curves."""
    from matplotlib.lines import Line2D

    look: tuple[str, Any] = LINES.get(one.name, (BLUE, ":"))
    colour, style = look
    lines = one.zero_lines()
    for line in lines:
        axes.plot(*line.T, color=colour, linestyle=style, linewidth=2)
    return (
        [Line2D([], [], color=colour, linestyle=style, linewidth=2, label=f"{one.name} (linear, no loss)")]
        if lines
        else []
    )


def _label(axis: Axis) -> str:
    return f"{axis.name} ({axis.unit})" if axis.unit not in ("", "1") else axis.name


def _cell_means(region: StabilityMap) -> Any:
    """Return the success rate to draw in each cell of the finest grid (nx - 1, ny - 1).

    This is the mean success rate at the corners of the simulated cell that contains the cell.
    """
    grid = region.traced_boundary.grid()
    whole = np.empty((grid.shape[0] - 1, grid.shape[1] - 1))
    for i, j, size in region.traced_boundary.cells:
        corners = grid[[i, i, i + size, i + size], [j, j + size, j, j + size]]
        whole[i : i + size, j : j + size] = corners.mean()
    return whole
