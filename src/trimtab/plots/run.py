"""One picture of a run: every signal that matters over one time axis, the ideal run beside the real one.

Which panels there are follows from the log's paths, so that any vehicle, law and actuator gets its picture.
"""

import dataclasses
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, full_path, nearest_target_value
from trimtab.plots.style import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    SEVERAL,
    VERMILION,
    PicturePath,
    decimate,
    save_figure,
    style_grid,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

COLUMNS, WIDTH, ROW_HEIGHT = 3, 16.0, 1.85
LEFT, RIGHT, TOP, BOTTOM, GAP = 0.85, 0.25, 0.95, 0.6, 0.9
"""Margins and the gap between columns, inches."""


@dataclasses.dataclass(frozen=True)
class Panel:
    """One pair of axes. kind: line, log, mode, age or flags; demand_path: drawn behind."""

    title: str
    paths: tuple[str, ...]
    kind: str = "line"
    demand_path: str = ""
    compares_ideal: bool = False


def plot_run(
    real: Log,
    ideal: Log | None = None,
    path: PicturePath = None,
    title: str = "",
    *,
    targets: Iterable[Target] = (),
) -> "Figure":
    """Draw a run; with a path also save it (PNG, or what the suffix says; the file appears whole or not at all).

    Args:
        real: the run.
        ideal: the run to compare with, or None; drawn for the truth and the law.
        path: where to save.
        title: what to write above; without it the scenario and the seed.
        targets: drawn as a line with its band, in the panel of their signal.
    """
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec
    from matplotlib.ticker import MaxNLocator

    by_path = {full_path(t.path): t for t in targets}
    for target in by_path:
        real[target]
    panels = select_panels(real)
    rows = max(1, -(-len(panels) // COLUMNS))
    height = TOP + BOTTOM + rows * ROW_HEIGHT
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white")
    right, wide = 1 - RIGHT / WIDTH, (WIDTH - LEFT - RIGHT - GAP * (COLUMNS - 1)) / COLUMNS
    place = {"left": LEFT / WIDTH, "right": right, "top": 1 - TOP / height, "bottom": BOTTOM / height}
    grid = GridSpec(rows, COLUMNS, figure=figure, hspace=0.42, wspace=GAP / wide, **place)
    first: Any = None
    for i, panel in enumerate(panels):
        axes: Any = figure.add_subplot(grid[i // COLUMNS, i % COLUMNS], sharex=first)
        first = first or axes
        _draw_panel(axes, panel, real, ideal, by_path.get(panel.paths[0]))
        _style_panel(axes, panel, real, bottom=i + COLUMNS >= len(panels))
    if first is not None and len(real) > 1:
        first.set_xlim(real.t[0], real.t[-1])
        first.xaxis.set_major_locator(MaxNLocator(6))
    figure.text(LEFT / WIDTH, 1 - 0.3 / height, title or _title(real), fontsize=14, weight="bold", va="center")
    handles = _legend(panels, ideal is not None, bool(by_path))
    where = (right, 1 - 0.3 / height)
    figure.legend(handles=handles, loc="center right", bbox_to_anchor=where, ncols=5, frameon=False, fontsize=11)
    return save_figure(figure, path)


def select_panels(log: Log) -> list[Panel]:
    """What to draw, in the order of the loop's story: truth, forces, law, actuators, ages, flags."""
    drawn = [p for p in log.paths if _panel_kind(log, p) not in ("time", "flag")]
    goals = {p: f"law.{p.removeprefix('truth.')}_wanted" for p in drawn if p.startswith("truth.")}
    panels = [
        Panel(_title_of_path(p), (p,), demand_path=goal if goal in drawn else "", compares_ideal=True)
        for p, goal in goals.items()
    ]
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
    flags = [p for p in log.paths if p.startswith(("law.", "actuators.")) and _panel_kind(log, p) == "flag"]
    if flags:
        panels.append(Panel("Flags", tuple(flags), "flags"))
    return panels or [Panel(_title_of_path(p), (p,), compares_ideal=True) for p in drawn]


def _panel_kind(log: Log, path: str) -> str:
    if path in log.declarations:
        return log.declarations[path].kind
    return "flag" if log[path].dtype.kind == "b" else "real"


def _is_idle(log: Log, path: str) -> bool:
    """Whether it is a term of a law, of several numbers, that is switched off: zero all the time."""
    return path.startswith("law.") and log[path].ndim > 1 and not log[path].any()


def _title_of_path(path: str) -> str:
    """A title from a path: surge_velocity becomes Surge velocity, speed_rpm Speed; symbols such as FX or h stay."""
    name = path.rsplit(".", 1)[-1].removesuffix("_rpm").replace("_", " ")
    return name if len(name) == 1 else name[0].upper() + name[1:]


def _short_label(name: str) -> str:
    """A name that fits left of the axes, on several lines if need be."""
    return textwrap.fill(name, 13)


def _title(log: Log) -> str:
    name = str(log.metadata.get("scenario", "Run"))
    return f"{name} · seed {log.metadata['seed']}" if "seed" in log.metadata else name


def _draw_panel(axes: Any, panel: Panel, real: Log, ideal: Log | None, target: Target | None) -> None:
    if panel.kind == "flags":
        _draw_flags(axes, panel, real)
        return
    if target is not None:
        value = nearest_target_value(real, target)
        axes.axhspan(value - target.band, value + target.band, color=GREEN, alpha=0.16, lw=0)
        axes.axhline(value, color=GREEN, lw=1, ls="--")
    if panel.demand_path:
        _draw_line(axes, panel, real, panel.demand_path, [GREY], lw=0.8)
    several = len(panel.paths) > 1 or any(real[p].ndim > 1 for p in panel.paths)
    for i, path in enumerate(panel.paths):
        _draw_line(axes, panel, real, path, SEVERAL[i:] if several else [BLUE], lw=1.0)
        if ideal is not None and panel.compares_ideal and path in ideal:
            style = {"ls": "--"} if several else {}
            low = 0.1 if panel.kind == "mode" else 0.0  # so that both can be seen where they agree
            _draw_line(axes, panel, ideal, path, SEVERAL[i:] if several else [VERMILION], lw=1.3, lower=low, **style)
    if len(panel.paths) > 1:
        from matplotlib.lines import Line2D

        handles = [Line2D([], [], color=SEVERAL[i % len(SEVERAL)], label=p) for i, p in enumerate(panel.paths)]
        axes.legend(handles=handles, loc="lower right", fontsize=8, framealpha=0.8, handlelength=1.2)


def _draw_line(axes: Any, panel: Panel, log: Log, path: str, colours: Any, lower: float = 0.0, **style: Any) -> None:
    values = log[path] if log[path].ndim > 1 else log[path][:, None]
    for k, column in enumerate(values.T):
        if panel.kind == "log":
            column = np.where(column > 0, column, np.nan)
        t, x = decimate(log.t, column)
        look: dict[str, Any] = {"drawstyle": "steps-post"} if panel.kind == "mode" else {}
        look |= {"alpha": 0.65} if panel.kind == "age" else {}
        look |= {"marker": "."} if len(log) == 1 else {}
        axes.plot(t, x - lower if lower else x, color=colours[k % len(colours)], label=path, **look, **style)


def _draw_flags(axes: Any, panel: Panel, log: Log) -> None:
    for i, path in enumerate(panel.paths):
        t, x = decimate(log.t, log[path])
        edges = np.flatnonzero(np.diff(np.concatenate([[0], x.astype(np.int8), [0]])))
        ends = np.append(t, t[-1:])
        spans = [(ends[a], ends[b] - ends[a]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        axes.broken_barh(spans, (i - 0.3, 0.6), color=BLUE, label=path)
    axes.set_yticks(range(len(panel.paths)), [_short_label(_title_of_path(p)) for p in panel.paths])
    axes.set_ylim(-0.6, len(panel.paths) - 0.4)


def _style_panel(axes: Any, panel: Panel, log: Log, *, bottom: bool) -> None:
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    path = panel.paths[0]
    axes.set_title(panel.title, loc="left", fontsize=10, weight="bold", y=1.02, pad=0)
    where = f"{panel.demand_path}, {path}" if panel.demand_path else path
    if len(panel.paths) == 1:
        axes.set_title(where, loc="right", fontsize=7, color=GREY, y=1.02, pad=0)
    unit = log.unit(path) if panel.kind in ("line", "log", "age") else ""
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


def _legend(panels: list[Panel], ideal: bool, targets: bool) -> list[Any]:
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
    return handles
