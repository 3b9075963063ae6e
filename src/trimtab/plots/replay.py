"""Plot of a replay: estimated states and commands, recorded and replayed, and the errors of both.

The drawn signals depend on the paths in the logs.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.spatial import display_unit
from trimtab.plots.style import BLUE, GREY, VERMILION, PicturePath, decimate, new_figure, save_figure, style_axes

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
WIDTH, ROW_HEIGHT, TOP = 14.0, 1.7, 0.7
SHOWN_PREFIXES = ("estimate.state.", "law.demand.", "command.value.")


def common_signals(recorded: Log, replayed: Log) -> list[str]:
    """Return the paths of the signals to draw: scalar estimated states, demands and commands that both logs contain.

    Sigmas are left out.
    """
    both = [p for p in recorded.paths if p in replayed and p.startswith(SHOWN_PREFIXES)]
    plain = [p for p in both if p.count(".") == 2 and not p.rpartition(".")[2].startswith("sigma_")]
    return [p for p in plain if recorded[p].dtype.kind == "f" and recorded[p].ndim == replayed[p].ndim == 1]


def interpolate_truth(log: Log, path: str, ticks: Any) -> Any:
    """Return the true values of an estimated state at the instants `ticks`, or None if the log lacks them."""
    name = f"truth.{path.removeprefix('estimate.state.')}"
    if not path.startswith("estimate.state.") or name not in log:
        return None
    return log[name][np.searchsorted(log.ticks, ticks)]


def plot_replay(log: Log, recorded: Log, replayed: Log, path: PicturePath = None, title: str = "Replay") -> "Figure":
    """Draw recorded and replayed signals in one column of panels, and errors or differences in another column.

    Args:
        log: complete log, which may contain the true state.
        recorded, replayed: signals at the control instants, as `run.replay` returns them.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    names = common_signals(recorded, replayed)
    if not names:
        problem = "the two logs have no estimated state, demand or command in common"
        raise InputError("plot_replay", problem, fix="record estimate, law and command")
    figure = new_figure(WIDTH, TOP + len(names) * ROW_HEIGHT)
    every: Any = figure.subplots(len(names), 2, sharex=True, squeeze=False)
    for (value, error), name in zip(every, names, strict=True):
        truth = interpolate_truth(log, name, recorded.ticks)
        _draw_values(value, recorded, replayed, name, truth)
        _draw_errors(error, recorded, replayed, name, truth)
    for axes in every[-1]:
        axes.set_xlabel("time (s)", fontsize=9)
    if len(recorded) > 1:
        every[0, 0].set_xlim(recorded.t[0], recorded.t[-1])
    return save_figure(figure, path, title, "blue: recorded; red, dashed: replayed; grey: truth", title_size=14)


def _draw_values(axes: Any, recorded: Log, replayed: Log, name: str, truth: Any) -> None:
    unit, factor = display_unit(name, recorded.unit(name))
    if truth is not None:
        axes.plot(*decimate(recorded.t, factor * truth), color=GREY, lw=2.0, alpha=0.6)
    axes.plot(*decimate(recorded.t, factor * recorded[name]), color=BLUE, lw=1.0)
    axes.plot(*decimate(replayed.t, factor * replayed[name]), color=VERMILION, lw=1.0, ls="--")
    style_axes(axes, name, "", unit)


def _draw_errors(axes: Any, recorded: Log, replayed: Log, name: str, truth: Any) -> None:
    unit, factor = display_unit(name, recorded.unit(name))
    if truth is None:
        off = factor * (replayed[name] - recorded[name])
        axes.plot(*decimate(recorded.t, off), color=VERMILION, lw=0.9)
        style_axes(axes, "replayed minus recorded", f"rms {_rms(off):.3g}", unit)
        return
    errors = factor * (recorded[name] - truth), factor * (replayed[name] - truth)
    for off, colour, style in zip(errors, (BLUE, VERMILION), ("-", "--"), strict=True):
        axes.plot(*decimate(recorded.t, off), color=colour, lw=0.9, ls=style)
    style_axes(
        axes, "estimate minus truth", f"rms recorded {_rms(errors[0]):.3g}, replayed {_rms(errors[1]):.3g}", unit
    )


def _rms(values: Any) -> float:
    kept = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(kept * kept))) if len(kept) else float("nan")
