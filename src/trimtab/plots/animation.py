"""Animations as GIF: of a run, and of the runs of a campaign.

In the animation of a run, the craft moves in the plan view, and a cursor moves through the main signals. The plan view
is left out if the log contains no position. In the animation of several runs, all craft move in one plan view. The
figure is drawn once. Each frame draws only the moving parts on top of it.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.mcap import replace_file
from trimtab.logs.metrics import Target, target_path
from trimtab.logs.spatial import with_flight
from trimtab.plots.plan import POINTS, draw_plan, find_path, has_plan
from trimtab.plots.run import Panel, draw_panel, run_title, select_panels, style_panel
from trimtab.plots.style import BLUE, GREY, ORANGE, VERMILION, new_figure, style_axes, thin_rows

FRAME_S = 0.08
"""Time for which a frame is shown (s)."""
FRAMES = 100
"""Maximum number of frames. A run that needs more at its own speed is shown faster."""
HOLD_S = 2.0
"""Time for which the last frame is shown (s)."""
WIDTH, HEIGHT, DPI = 8.0, 4.6, 80
"""Size of the figure (inches), and resolution (pixels per inch)."""
PATHS_WIDTH = 6.0
"""Width of the figure of several runs (inches)."""
COLOURS = 32
"""Number of colours of the GIF. More colours make the file larger."""
SIGNALS = 3
"""Number of signals beside the plan view. Without a plan view, twice as many are drawn."""
CRAFT = np.array([[1.0, 0.0], [0.3, 0.4], [-0.8, 0.4], [-0.8, -0.4], [0.3, -0.4]])
"""Outline of a craft: forward and to the right, relative to its size."""
CRAFT_SIZE = 0.055
"""Size of a craft in the animation of a run, as a fraction of the plan view's width."""
CRAFT_OF_MANY = 0.02
"""Size of a craft in the animation of several runs, as a fraction of the plan view's width."""


class Mover(NamedTuple):
    """Craft that moves in the plan view: times (n,) s, path (n, 2) east, north, and heading (n,) or None.

    artists: artists of the trail and of the craft.  size: size of the craft, as a fraction of the plan view's width.
    """

    t: Any
    path: Any
    heading: Any
    artists: tuple[Any, Any]
    size: float


def animate_run(
    real: Log,
    ideal: Log | None = None,
    path: str | Path = "run.gif",
    title: str = "",
    *,
    targets: Iterable[Target] = (),
) -> None:
    """Draw an animation of a run to a GIF file.

    Args:
        real: log of the run.
        ideal: log of the ideal run, drawn for comparison, or None.
        path: file, which ends in .gif. The file is written atomically.
        title: title of the plot. Default: the scenario and the seed.
        targets: targets of the run. Their signals are drawn first, each with a line and a tolerance band.

    Raises:
        InputError: the log contains fewer than two rows, or the file does not end in .gif.
    """
    from matplotlib.lines import Line2D

    _check_film(path, real)
    real, ideal = with_flight(real), None if ideal is None else with_flight(ideal)
    figure = _new_film()
    has_map, wanted = has_plan(real), tuple(targets)
    grid = figure.add_gridspec(SIGNALS, 2, width_ratios=[1.35, 1] if has_map else [1, 1])
    cells = [grid[row, column] for column in ((1,) if has_map else (0, 1)) for row in range(SIGNALS)]
    movers = _draw_map(figure.add_subplot(grid[:, 0]), real, ideal) if has_map else []
    if not has_map and ideal is not None:
        several = any(real[p].ndim > 1 for p in real.paths if p.startswith("truth."))  # a colour for each element
        looks = ((GREY, "-"), (GREY, "--")) if several else ((BLUE, "-"), (VERMILION, "-"))
        handles = [Line2D([], [], color=c, ls=ls, label=n) for (c, ls), n in zip(looks, ("real", "ideal"), strict=True)]
        figure.legend(handles=handles, loc="outside lower left", ncols=2, frameon=False, fontsize=9)
    cursors = _draw_signals(figure, cells, real, ideal, wanted)
    figure.suptitle(title or run_title(real), fontsize=12, weight="bold", x=0.01, ha="left")

    def update(t: float) -> list[Any]:
        for cursor in cursors:
            cursor.set_xdata([t, t])
        for mover in movers:
            _move(mover, t)
        return [*cursors, *(a for m in movers for a in m.artists)]

    _write_film(Path(path), figure, (float(real.t[0]), float(real.t[-1])), update)


def animate_paths(logs: Sequence[Log], success: Sequence[bool], path: str | Path = "runs.gif", title: str = "") -> None:
    """Draw an animation of several runs to a GIF file: all craft move in one plan view.

    Args:
        logs: logs of the runs. Each must contain a position.
        success: True for each successful run, which is drawn in blue. The other runs are drawn in vermilion.
        path: file, which ends in .gif. The file is written atomically.
        title: title of the plot.

    Raises:
        InputError: a log contains no position or fewer than two rows, or the file does not end in .gif.
    """
    from matplotlib.lines import Line2D

    logs = [with_flight(log) for log in logs]
    for log in logs:
        _check_film(path, log)
        if not has_plan(log):
            fix = "animate runs of a vehicle that moves in a plane or in space"
            raise InputError("animate_paths", "the truth in the log has no north and east", fix=fix)
    figure = _new_film(PATHS_WIDTH)
    axes: Any = figure.add_subplot()
    movers: list[Mover] = []
    for log, is_success in sorted(zip(logs, success, strict=True), key=lambda pair: not pair[1]):
        found = find_path(log, "truth")
        assert found is not None
        colour = BLUE if is_success else VERMILION
        axes.plot(*found[0][thin_rows(np.arange(len(log)), POINTS)].T, color=colour, lw=0.6, alpha=0.15)
        movers.append(Mover(log.t, *found, _new_craft(axes, colour, colour, width=0.8), CRAFT_OF_MANY))
    style_axes(axes, "", "", "north (m)")
    axes.set_xlabel("east (m)", fontsize=9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(2 * CRAFT_SIZE)
    count = sum(map(bool, success))
    labels = ((BLUE, f"{count} succeeded"), (VERMILION, f"{len(logs) - count} failed"))
    handles = [Line2D([], [], color=colour, label=label) for colour, label in labels]
    figure.legend(handles=handles, loc="outside lower left", ncols=2, frameon=False, fontsize=9)
    figure.suptitle(title, fontsize=12, weight="bold", x=0.01, ha="left")

    def update(t: float) -> list[Any]:
        for mover in movers:
            _move(mover, t)
        return [a for m in movers for a in m.artists]

    _write_film(Path(path), figure, (0.0, max(float(log.t[-1]) for log in logs)), update)


def _check_film(path: str | Path, log: Log) -> None:
    if Path(path).suffix.lower() != ".gif":
        fix = f"use the file name {Path(path).with_suffix('.gif').name}"
        raise InputError(f"animation '{path}'", "the file name must end in .gif", fix=fix)
    if len(log) < 2:
        raise InputError("animation", f"the log must have at least 2 rows, got {len(log)}", fix="run for longer")


def _new_film(width: float = WIDTH) -> Any:
    figure = new_figure(width, HEIGHT)
    figure.set_dpi(DPI)
    return figure


def _write_film(file: Path, figure: Any, span: tuple[float, float], update: Callable[[float], list[Any]]) -> None:
    """Draw the frames of an animation and write them to a GIF file.

    span: first and last time (s).  update: function that sets the moving artists for a time (s), and returns them.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    clock = figure.text(0.99, 0.985, "", fontsize=11, color=GREY, ha="right", va="top", animated=True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    count = min(FRAMES, max(2, math.ceil((span[1] - span[0]) / FRAME_S)))
    speed = (span[1] - span[0]) / (count * FRAME_S)
    frames: list[Any] = []
    for t in np.linspace(*span, count):
        canvas.restore_region(still)
        clock.set_text(f"{t:.1f} s" + (f" at {speed:.2g} × real time" if speed > 1.05 else ""))
        for artist in (*update(float(t)), clock):
            figure.draw_artist(artist)
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    _write_gif(file, frames)


def _draw_map(axes: Any, real: Log, ideal: Log | None) -> list[Mover]:
    """Draw the plan view, pale, and return the craft that move in it."""
    draw_plan(axes, real, ideal)
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside lower left", ncols=len(labels), frameon=False, fontsize=9)
    for line in axes.lines:
        line.set_alpha(0.3)
        line.set_visible(not str(line.get_label()).startswith("_"))  # no marks of start, end and heading
    for side in ("left", "right"):
        axes.set_title("", loc=side)
    movers: list[Mover] = []
    logs = [(ideal, "truth", VERMILION, "none")] if ideal is not None and has_plan(ideal) else []
    for log, block, colour, face in (*logs, (real, "estimate", ORANGE, "none"), (real, "truth", BLUE, BLUE)):
        found = find_path(log, block)
        if found is None:
            continue
        movers.append(Mover(log.t, *found, _new_craft(axes, colour, face, width=1.6), CRAFT_SIZE))
    return movers


def _new_craft(axes: Any, colour: str, face: str, width: float) -> tuple[Any, Any]:
    """Return the artists of a trail and of a craft."""
    from matplotlib.patches import Polygon

    trail = axes.plot([], [], color=colour, lw=width, animated=True)[0]
    craft = Polygon([[0.0, 0.0]], closed=True, fc=face, ec=colour, lw=width, animated=True, zorder=5)
    axes.add_artist(craft)  # add_patch would extend the limits of the axes
    return trail, craft


def _move(mover: Mover, t: float) -> None:
    """Set the trail and the outline of a craft at time t (s)."""
    trail, craft = mover.artists
    k = max(int(np.searchsorted(mover.t, t + 1e-9)) - 1, 0)
    trail.set_data(*mover.path[thin_rows(np.arange(k + 1), POINTS)].T)
    centre = mover.path[k]
    craft.set_visible(bool(np.isfinite(centre).all()))
    low, high = trail.axes.get_xlim()
    size = mover.size * (high - low)
    if mover.heading is None:
        angles = np.linspace(0, 2 * np.pi, 25)
        outline = 0.4 * size * np.array([np.sin(angles), np.cos(angles)]).T
    else:
        s, c = np.sin(mover.heading[k]), np.cos(mover.heading[k])
        outline = size * CRAFT @ np.array([[s, c], [c, -s]])
    craft.set_xy(centre + outline)


def _draw_signals(
    figure: Any, cells: list[Any], real: Log, ideal: Log | None, targets: tuple[Target, ...]
) -> list[Any]:
    """Draw the main signals, one in each cell, and return their cursors."""
    aimed: dict[str, list[Target]] = {}
    for target in targets:
        aimed.setdefault(target_path(real, target), []).append(target)
    panels = [p for p in select_panels(real, aimed) if p.kind == "line" and not _is_on_map(p, real)]
    panels = sorted(panels, key=lambda panel: panel.paths[0] not in aimed)[: len(cells)]
    cursors: list[Any] = []
    for cell, panel in zip(cells, panels, strict=False):
        axes: Any = figure.add_subplot(cell)
        draw_panel(axes, panel, real, ideal, aimed.get(panel.paths[0], []))
        style_panel(axes, panel, real, bottom=cell.is_last_row() or panel is panels[-1])
        unit = axes.get_ylabel()
        axes.set_title(f"{panel.title} ({unit})" if unit else panel.title, loc="left", fontsize=9, weight="bold")
        axes.set_title("", loc="right")
        axes.set_ylabel("")
        for text in axes.texts:
            text.set_visible(False)
        axes.set_xlim(real.t[0], real.t[-1])
        cursors.append(axes.axvline(real.t[0], color=GREY, lw=1.4, animated=True))
    return cursors


def _is_on_map(panel: Panel, log: Log) -> bool:
    """Return True for a position that the plan view shows."""
    return has_plan(log) and panel.paths[0].rpartition(".")[2] in ("north", "east")


def _write_gif(file: Path, frames: list[Any]) -> None:
    """Write frames (height, width, 3) as a GIF that repeats."""
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    palette = images[-1].quantize(COLOURS)
    first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    times = [round(1000 * FRAME_S)] * len(rest) + [round(1000 * HOLD_S)]
    with replace_file(file) as stream:
        first.save(stream, format="GIF", save_all=True, append_images=rest, duration=times, loop=0)
