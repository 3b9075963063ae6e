"""One picture of a run: every signal that matters over one time axis, the ideal run beside the real one.

Which panels there are follows from the log's paths, so that any vehicle, law and actuator gets its picture.
Colours: Okabe and Ito, "Color universal design", 2008; told apart also without colour vision.
"""

import dataclasses
import os
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.mcap import replace_file
from trimtab.logs.metrics import Target, full_path, nearest_target_value

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

BLUE, VERMILION, GREY, GREEN = "#0072B2", "#D55E00", "#707070", "#009E73"
SEVERAL = (BLUE, "#E69F00", GREEN, "#CC79A7", "#56B4E9", VERMILION, "#000000")
COLUMNS, WIDTH, ROW_HEIGHT, DPI = 3, 16.0, 1.85, 100
LEFT, RIGHT, TOP, BOTTOM, GAP = 0.85, 0.25, 0.95, 0.6, 0.9
"""Margins and the gap between columns, inches."""
BINS = 600
"""Bins to a line: about the pixels of a panel's width. Each keeps its extremes."""


@dataclasses.dataclass(frozen=True)
class Panel:
    """One pair of axes. kind: line, log, mode, age or flags; demanded: path drawn behind; ideal: whether to compare."""

    title: str
    paths: tuple[str, ...]
    kind: str = "line"
    demand_path: str = ""
    compares_ideal: bool = False


def plot_run(
    real: Log,
    ideal: Log | None = None,
    path: str | os.PathLike[str] | None = None,
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

    wanted = {full_path(t.path): t for t in targets}
    for target in wanted:
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
        _draw_panel(axes, panel, real, ideal, wanted.get(panel.paths[0]))
        _style_axes(axes, panel, real, bottom=i + COLUMNS >= len(panels))
    if first is not None and len(real) > 1:
        first.set_xlim(real.t[0], real.t[-1])
        first.xaxis.set_major_locator(MaxNLocator(6))
    figure.text(LEFT / WIDTH, 1 - 0.3 / height, title or _title(real), fontsize=14, weight="bold", va="center")
    handles = _legend(panels, ideal is not None, bool(wanted))
    where = (right, 1 - 0.3 / height)
    figure.legend(handles=handles, loc="center right", bbox_to_anchor=where, ncols=5, frameon=False, fontsize=11)
    if path is not None:
        save_figure(figure, Path(path))
    return figure


def select_panels(log: Log) -> list[Panel]:
    """What to draw, in the order of the loop's story: truth, forces, law, actuators, ages, flags."""
    drawn = [p for p in log.paths if _panel_kind(log, p) not in ("time", "flag")]
    goals = {p: f"law.{p.removeprefix('truth.')}_wanted" for p in drawn if p.startswith("truth.")}
    found = [
        Panel(_title_of_path(p), (p,), demand_path=goal if goal in drawn else "", compares_ideal=True)
        for p, goal in goals.items()
    ]
    taken = set(goals.values())
    for path in [p for p in drawn if p.startswith("actuators.")]:
        name = path.rsplit(".", 1)[-1]
        pair = f"law.demand.{name}" if path.startswith("actuators.u.") else f"command.value.{name}"
        taken |= {path, pair}
        kind = "mode" if _panel_kind(log, path) == "mode" else "line"
        found.append(Panel(_title_of_path(path), (path,), kind, demand_path=pair if pair in drawn else ""))
    rest = [p for p in drawn if p not in taken]
    for path in [p for p in rest if p.startswith(("law.", "command.value.")) and not _is_idle(log, p)]:
        kind = "mode" if _panel_kind(log, path) == "mode" else "log" if "lyapunov" in path else "line"
        found.append(Panel(_title_of_path(path), (path,), kind, compares_ideal=path.startswith("law.")))
    ages = [p for p in drawn if p.endswith(".age") and p.startswith(("downlink.", "uplink."))]
    if ages:
        found.append(Panel("Age of the newest sample", tuple(ages), "age"))
    flags = [p for p in log.paths if p.startswith(("law.", "actuators.")) and _panel_kind(log, p) == "flag"]
    if flags:
        found.append(Panel("Flags", tuple(flags), "flags"))
    return found or [Panel(_title_of_path(p), (p,), compares_ideal=True) for p in drawn]


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


def _style_axes(axes: Any, panel: Panel, log: Log, *, bottom: bool) -> None:
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    path = panel.paths[0]
    axes.set_title(panel.title, loc="left", fontsize=10, weight="bold", y=1.02, pad=0)
    where = f"{panel.demand_path}, {path}" if panel.demand_path else path
    if len(panel.paths) == 1:
        axes.set_title(where, loc="right", fontsize=7, color=GREY, y=1.02, pad=0)
    unit = log.unit(path) if panel.kind in ("line", "log", "age") else ""
    axes.set_ylabel(unit if unit != "1" else "", fontsize=9)
    axes.yaxis.set_label_coords(-0.13, 0.5)
    axes.grid(color="#d8d8d8", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, labelbottom=bottom, length=2)
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


def save_figure(figure: "Figure", path: Path) -> None:
    """Save a figure; the file appears whole or not at all."""
    kinds = figure.canvas.get_supported_filetypes()
    kind = path.suffix.lstrip(".").lower() or "png"
    if kind not in kinds:
        raise InputError(f"plot '{path}'", f"cannot be saved as {kind!r}", choices=kinds, fix="name it something.png")
    fast: dict[str, Any] = {"pil_kwargs": {"compress_level": 3}} if kind == "png" else {}
    with replace_file(path) as stream:
        figure.savefig(stream, format=kind, dpi=DPI, **fast)
