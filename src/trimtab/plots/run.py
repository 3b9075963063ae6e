"""Plot of a run: the main signals over a common time axis, with the ideal run for comparison.

The panels are chosen by the paths in the log, so the plot is possible for any vehicle, law and actuator. For a vehicle
that moves in three dimensions, altitude, speed, attitude angles in degrees and angular rates are drawn instead of
vectors and quaternion, and the path of the vehicle is drawn from above and from the side.
"""

import dataclasses
import itertools
import os
import textwrap
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.explain_call import explain_call
from trimtab.core.quantity import split_component
from trimtab.logs.log import Log, check_log
from trimtab.logs.metrics import Target, metrics, nearest_target_value, target_path
from trimtab.logs.spatial import ANGLES, FLIGHT, RATES, display_unit, flight_sources, referenced_signal, with_flight
from trimtab.plots.plan import draw_plan, draw_profile, has_plan, has_profile
from trimtab.plots.style import (
    BLUE,
    CHATTER,
    DPI,
    GREEN,
    GREY,
    ORANGE,
    SEVERAL,
    VERMILION,
    PicturePath,
    decimate,
    draw_line,
    has_chatter,
    save_figure,
    style_grid,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

COLUMNS, WIDTH, ROW_HEIGHT = 3, 16.0, 1.85
LEFT, RIGHT, TOP, BOTTOM, GAP = 0.85, 0.25, 0.95, 0.6, 0.9
"""Margins of the figure and gap between columns of panels (inches)."""
PLAN_ROWS = 3
"""Height of the plan view in the last column, in rows of panels. An altitude profile needs one more row below."""
IN_SPACE = {
    "Altitude": ("altitude",),
    "Speed": ("ground_speed", "climb", "air_speed"),
    "Attitude": ANGLES,
    "Rates": RATES,
}
"""Title of a panel for a vehicle that moves in three dimensions -> signals in the panel."""
LIMIT_FARTHEST = 0.5
"""Largest distance of an input limit that is drawn, as a multiple of the range of the input. A limit farther away is
left out."""
TITLE_POINTS, NOTE_POINTS, PANEL_POINTS = 6.2, 3.8, 300.0
"""Width (points) of a character of a panel's title and of its note, and room for both."""


@dataclasses.dataclass(frozen=True)
class Panel:
    """Panel of the plot.

    paths: paths of the signals.  kind: kind of panel: line, log, mode, age or flags.  demand_path: path of the demanded
    signal, which is drawn in grey behind the curve.
    """

    title: str
    paths: tuple[str, ...]
    kind: str = "line"
    demand_path: str = ""
    compares_ideal: bool = False


@explain_call()
def plot_run(
    real: Log,
    ideal: Log | PicturePath = None,
    path: PicturePath = None,
    title: str = "",
    *,
    targets: Iterable[Target] = (),
) -> "Figure":
    """Draw a run, and save the plot if a path is given. The file is written atomically.

    >>> from trimtab import plot_run, simulate
    >>> len(plot_run(simulate("hovercraft/spin", duration="100 ms")).axes) > 4
    True

    Args:
        real: log of the run.
        ideal: log of the ideal run, whose true state and law are drawn for comparison, or None. If this argument is a
            file name, it is used as `path`.
        path: path of the saved file. The suffix determines the format, PNG by default.
        title: title of the plot. Default: the scenario and the seed.
        targets: targets. Each target is drawn as a line with a tolerance band, in the panel of its signal.
    """
    check_log(real, "plot_run({})")
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    if isinstance(ideal, str | os.PathLike):
        ideal, path = None, ideal if path is None else path
    real, ideal = with_flight(real), None if ideal is None else with_flight(ideal)
    by_signal: dict[str, list[Target]] = {}
    for target in targets:
        aimed = target_path(real, target)
        by_signal.setdefault(aimed if aimed in real.signals else split_component(aimed)[0], []).append(target)
    panels, side_rows = select_panels(real, by_signal), PLAN_ROWS * has_plan(real) + has_profile(real)
    places = _panel_places(len(panels), side_rows)
    rows = max([side_rows, 1, *(row + 1 for row, _ in places)])
    height = TOP + BOTTOM + rows * ROW_HEIGHT
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white")
    right, wide = 1 - RIGHT / WIDTH, (WIDTH - LEFT - RIGHT - GAP * (COLUMNS - 1)) / COLUMNS
    place = {"left": LEFT / WIDTH, "right": right, "top": 1 - TOP / height, "bottom": BOTTOM / height}
    grid = GridSpec(rows, COLUMNS, figure=figure, hspace=0.42, wspace=GAP / wide, **place)
    first: Any = None
    lowest = {column: row for row, column in places}
    for panel, (row, column) in zip(panels, places, strict=True):
        axes: Any = figure.add_subplot(grid[row, column], sharex=first)
        first = first or axes
        draw_panel(axes, panel, real, ideal, by_signal.get(panel.paths[0], []))
        style_panel(axes, panel, real, bottom=row == lowest[column])
    if has_profile(real):
        above, below = grid[:side_rows, COLUMNS - 1].subgridspec(2, 1, height_ratios=[PLAN_ROWS, 1], hspace=0.22)
        draw_plan(figure.add_subplot(above), real, ideal)
        draw_profile(figure.add_subplot(below), real, ideal)
    elif side_rows:
        draw_plan(figure.add_subplot(grid[:side_rows, COLUMNS - 1]), real, ideal)
    if first is not None and len(real) > 1:
        first.set_xlim(real.t[0], real.t[-1])
        first.xaxis.set_major_locator(MaxNLocator(6))
    figure.text(LEFT / WIDTH, 1 - 0.3 / height, title or run_title(real), fontsize=14, weight="bold", va="center")
    handles = _legend(panels, ideal is not None, bool(by_signal), real if side_rows else None)
    if any(has_chatter(axes) for axes in figure.axes):
        handles.append(Patch(color=GREY, alpha=0.3, lw=0, label=CHATTER))
    where = (right, 1 - 0.3 / height)
    figure.legend(handles=handles, loc="center right", bbox_to_anchor=where, ncols=8, frameon=False, fontsize=11)
    return save_figure(figure, path)


def select_panels(log: Log, aimed: Collection[str] = ()) -> list[Panel]:
    """Return the panels, in the order of the loop: truth, forces, law, actuators, ages, flags.

    A signal from which drawn signals are derived, e.g. a quaternion, is left out unless it has a target.
    """
    said = flight_sources(log) - set(aimed) if f"{FLIGHT}roll" in log else set[str]()
    drawn = [p for p in log.paths if _panel_kind(log, p) not in ("time", "flag") and p not in said]
    in_space = [Panel(title, tuple(p for n in names if (p := FLIGHT + n) in log)) for title, names in IN_SPACE.items()]
    references = {f"truth.{name}": p for p in drawn if (name := referenced_signal(p))}
    goals = {p: references.get(p, "") for p in drawn if p.startswith("truth.")}
    panels = [dataclasses.replace(panel, compares_ideal=True) for panel in in_space if panel.paths]
    panels += [Panel(_title_of_path(p), (p,), demand_path=goal, compares_ideal=True) for p, goal in goals.items()]
    shown = set(goals.values())
    for path in [p for p in drawn if p.startswith("actuators.")]:
        name = path.rsplit(".", 1)[-1]
        pair = f"law.demand.{name}" if path.startswith("actuators.u.") else f"command.value.{name}"
        shown |= {path, pair}
        kind = "mode" if _panel_kind(log, path) == "mode" else "line"
        panels.append(Panel(_title_of_path(path), (path,), kind, demand_path=pair if pair in drawn else ""))
    rest = [p for p in drawn if p not in shown]
    for path in [p for p in rest if p.startswith(("law.", "command.value.")) and not _is_idle(log, p)]:
        kind = "mode" if _panel_kind(log, path) == "mode" else "log" if "lyapunov" in path else "line"
        panels.append(Panel(_title_of_path(path), (path,), kind, compares_ideal=path.startswith("law.")))
    ages = [p for p in drawn if p.endswith(".age") and p.startswith(("downlink.", "uplink."))]
    if ages:
        panels.append(Panel("Age of the newest sample", tuple(ages), "age"))
    flagged = [p for p in log.paths if p.startswith(("law.", "actuators.")) and _panel_kind(log, p) == "flag"]
    flags = [one for p in flagged for one in log.numbers(p)]
    if flags:
        panels.append(Panel("Flags", tuple(flags), "flags"))
    return _tell_apart(panels or [Panel(_title_of_path(p), (p,), compares_ideal=True) for p in drawn])


def _tell_apart(panels: list[Panel]) -> list[Panel]:
    """Return the panels with the block of the signal added to titles that occur twice, e.g. "Heading, law.demand"."""
    titles = [panel.title for panel in panels]
    return [
        dataclasses.replace(panel, title=f"{panel.title}, {panel.paths[0].rpartition('.')[0]}")
        if panel.title in titles[:k]
        else panel
        for k, panel in enumerate(panels)
    ]


def _panel_places(count: int, side_rows: int) -> list[tuple[int, int]]:
    """Return row and column of each panel, in reading order. The cells of plan view and profile are not used."""
    cells = ((row, column) for row in range(count + side_rows) for column in range(COLUMNS))
    free = (cell for cell in cells if not (cell[0] < side_rows and cell[1] == COLUMNS - 1))
    return list(itertools.islice(free, count))


def _panel_kind(log: Log, path: str) -> str:
    if path in log.declarations:
        return log.declarations[path].kind
    return "flag" if log[path].dtype.kind == "b" else "real"


def _is_idle(log: Log, path: str) -> bool:
    """Return True for a vector term of a law that is switched off, i.e. zero in all rows."""
    return path.startswith("law.") and log[path].ndim > 1 and not log[path].any()


def _title_of_path(path: str) -> str:
    """Return a panel title for a path, e.g. "Surge velocity" for surge_velocity. Symbols such as FX are not changed."""
    name = path.rsplit(".", 1)[-1].removesuffix("_rpm").replace("_", " ")
    return name if len(name) == 1 else name[0].upper() + name[1:]


def _short_label(name: str) -> str:
    """Return a name with line breaks, so that it fits to the left of the axes."""
    return textwrap.fill(name, 13)


def run_title(log: Log) -> str:
    """Return the title of a run: the scenario and the seed."""
    name = str(log.metadata.get("scenario", "Run"))
    return f"{name} · seed {log.metadata['seed']}" if "seed" in log.metadata else name


def draw_panel(axes: Any, panel: Panel, real: Log, ideal: Log | None, targets: list[Target]) -> None:
    """Draw the signals of a panel, with limits and targets."""
    if panel.kind == "flags":
        _draw_flags(axes, panel, real)
        return
    for target in targets:
        factor = display_unit(target_path(real, target), real.unit(panel.paths[0]))[1]
        value, band = factor * nearest_target_value(real, target), factor * target.band
        axes.axhspan(value - band, value + band, color=GREEN, alpha=0.16, lw=0)
        axes.axhline(value, color=GREEN, lw=1, ls="--")
        settling = metrics(real, [target], [target.path])[target.path]["settling_s"]
        said = (
            "outside the target band at the end"
            if settling is None
            else f"within the target band from {settling:.3g} s on"
        )
        colour = VERMILION if settling is None else GREEN
        box = {"facecolor": "white", "alpha": 0.85, "lw": 0, "pad": 1.5}
        axes.text(0.99, 0.05, said, transform=axes.transAxes, color=colour, ha="right", fontsize=8, bbox=box, zorder=5)
    if panel.demand_path:
        _draw_line(axes, panel, real, panel.demand_path, [GREY], lw=0.8)
    several = len(panel.paths) > 1 or any(real[p].ndim > 1 for p in panel.paths)
    for i, path in enumerate(panel.paths):
        _draw_line(axes, panel, real, path, SEVERAL[i:] if several else [BLUE], lw=1.0)
        if ideal is not None and panel.compares_ideal and path in ideal:
            style = {"ls": "--"} if several else {}
            low = 0.1 if panel.kind == "mode" else 0.0  # so that both lines can be seen where they agree
            _draw_line(axes, panel, ideal, path, SEVERAL[i:] if several else [VERMILION], lw=1.3, lower=low, **style)
    _draw_limits(axes, panel, real)
    labels = [_title_of_path(p) if p.startswith(FLIGHT) else p for p in panel.paths]
    if len(panel.paths) == 1:
        labels = [one.removeprefix(panel.paths[0]) for one in real.numbers(panel.paths[0])]
    if 1 < len(labels) <= len(SEVERAL):
        from matplotlib.lines import Line2D

        handles = [Line2D([], [], color=SEVERAL[i % len(SEVERAL)], label=label) for i, label in enumerate(labels)]
        axes.legend(handles=handles, loc="lower right", fontsize=8, framealpha=0.8, handlelength=1.2)


def _draw_limits(axes: Any, panel: Panel, log: Log) -> None:
    """Draw those declared limits of an input that are near the curve."""
    path = panel.paths[0]
    declared = log.declaration(path)
    known = log[path][np.isfinite(log[path])]
    if panel.kind != "line" or not path.startswith(("actuators.", "command.value.")) or declared is None:
        return
    for limit in (declared.low, declared.high):
        if limit is not None and len(known):
            low, high = float(known.min()), float(known.max())
            if max(low - limit, limit - high) <= LIMIT_FARTHEST * max(high - low, abs(limit)):
                axes.axhline(limit, color=GREY, lw=1, ls=":")


def _draw_line(axes: Any, panel: Panel, log: Log, path: str, colours: Any, lower: float = 0.0, **style: Any) -> None:
    values = log[path] if log[path].ndim > 1 else log[path][:, None]
    factor = display_unit(path, log.unit(path))[1]
    values = values if factor == 1 else values * factor
    for k, column in enumerate(values.T):
        if panel.kind == "log":
            column = np.where(column > 0, column, np.nan)
        look: dict[str, Any] = {"drawstyle": "steps-post"} if panel.kind == "mode" else {}
        look |= {"alpha": 0.65} if panel.kind == "age" else {}
        look |= {"marker": "."} if len(log) == 1 else {}
        look |= {"color": colours[k % len(colours)], "label": path, "logarithmic": panel.kind == "log"}
        draw_line(axes, log.t, column - lower if lower else column, **look, **style)


def _draw_flags(axes: Any, panel: Panel, log: Log) -> None:
    for i, path in enumerate(panel.paths):
        t, x = decimate(log.t, log[path])
        edges = np.flatnonzero(np.diff(np.concatenate([[0], x.astype(np.int8), [0]])))
        ends = np.append(t, t[-1:])
        spans = [(ends[a], ends[b] - ends[a]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        axes.broken_barh(spans, (i - 0.3, 0.6), color=BLUE, label=path)
    axes.set_yticks(range(len(panel.paths)), [_short_label(_title_of_path(p)) for p in panel.paths])
    axes.set_ylim(-0.6, len(panel.paths) - 0.4)


def signal_note(panel: Panel) -> str:
    """Return the names of a panel's signals as a note, as many as fit next to the panel's title."""
    path, room = panel.paths[0], PANEL_POINTS - TITLE_POINTS * len(panel.title)
    notes = (f"{panel.demand_path}, {path}", path) if panel.demand_path else (path,)
    return next((note for note in notes if NOTE_POINTS * len(note) <= room), "")


def style_panel(axes: Any, panel: Panel, log: Log, *, bottom: bool) -> None:
    """Write title, unit and ticks of a panel. bottom: True if the time axis is labelled."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    path = panel.paths[0]
    axes.set_title(panel.title, loc="left", fontsize=10, weight="bold", y=1.02, pad=0)
    if len(panel.paths) == 1:
        axes.set_title(signal_note(panel), loc="right", fontsize=7, color=GREY, y=1.02, pad=0)
    unit = display_unit(path, log.unit(path))[0] if panel.kind in ("line", "log", "age") else ""
    axes.set_ylabel(unit if unit != "1" else "", fontsize=9)
    axes.yaxis.set_label_coords(-0.13, 0.5)
    style_grid(axes)
    axes.tick_params(labelbottom=bottom, length=2)
    axes.spines[["top", "right"]].set_visible(False)
    if bottom:
        axes.set_xlabel("time (s)", fontsize=9)
    modes = log.declarations[path].modes if path in log.declarations else ()
    if panel.kind == "mode" and modes:
        axes.set_yticks(range(len(modes)), [_short_label(mode) for mode in modes])
        axes.set_ylim(-0.4, len(modes) - 0.6)
    elif panel.kind == "log" and (log[path] > 0).any():
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    elif panel.kind != "flags":
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.6g}"))
    if panel.kind == "age":
        axes.set_ylim(bottom=0)


def _legend(panels: list[Panel], ideal: bool, targets: bool, planar: Log | None) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=BLUE, lw=2, label="real")]
    if ideal:
        handles.append(Line2D([], [], color=VERMILION, lw=2, label="ideal"))
    if any(p.demand_path for p in panels):
        handles.append(Line2D([], [], color=GREY, lw=2, label="demanded"))
    if targets:
        handles.append(Line2D([], [], color=GREEN, lw=1.5, ls="--", label="target"))
        handles.append(Patch(color=GREEN, alpha=0.16, lw=0, label="band"))
    if planar is not None and "estimate.state.north" in planar:
        handles.append(Line2D([], [], color=ORANGE, lw=2, label="estimate"))
    if planar is not None and "law.north_reference" in planar:
        handles.append(Line2D([], [], color=GREEN, lw=3, alpha=0.5, label="reference"))
    return handles
