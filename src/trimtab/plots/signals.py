"""Plot of selected signals of one or several logs, with one panel per signal and a common time axis."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.logs.log import Log
from trimtab.logs.spatial import display_unit, with_flight
from trimtab.plots.style import (
    BLUE,
    CHATTER,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    PicturePath,
    draw_line,
    has_chatter,
    save_figure,
    style_grid,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

COLOURS = (BLUE, VERMILION, GREEN, ORANGE)
PANELS_MAX = 24
"""Maximum number of panels in a plot."""


def select_paths(log: Log, wanted: Sequence[str]) -> list[str]:
    """Return the paths of selected signals in a log, e.g. for "truth.yaw_rate", "truth.velocity[2]", "law.*".

    The order is that of the selection. A vector is split into its elements. Derived signals of a flight, such as
    "flight.roll", can also be selected.

    Raises: InputError for a path that is not in the log. The message suggests similar paths.
    """
    log, chosen = with_flight(log), list[str]()
    for path in wanted:
        if "*" in path or "?" in path:
            matching = [one for one in log.paths if fnmatchcase(one, path)]
            if not matching:
                raise InputError(
                    f"signal {path!r}", "matches no signal of this log", choices=log.paths[:12], fix="'truth.*'"
                )
        else:
            if path not in log:
                near = closest(path, log.paths, 6) or list(log.paths[:6])
                below = [one for one in log.paths if one.startswith(f"{path}.")]
                fix = f"'{path}.*'" if below else near[0]
                raise InputError(f"signal {path!r}", "is not in this log", choices=below[:6] or near, fix=fix)
            matching = [path]
        chosen += [number for one in matching for number in ([one] if log[one].ndim == 1 else log.numbers(one))]
    if len(chosen) > PANELS_MAX:
        raise InputError(
            "signals", f"{len(chosen)} signals are too many for one plot", fix=f"name at most {PANELS_MAX} signals"
        )
    return list(dict.fromkeys(chosen))


def plot_signals(logs: Mapping[str, Log], paths: Sequence[str], path: PicturePath = None, title: str = "") -> "Figure":
    """Draw signals, each in a separate panel, and save the plot if a path is given.

    Args:
        logs: name of a log, for the legend -> log. Each log has a colour. A log without a signal is left out of this
            signal's panel.
        paths: paths of scalar signals, as returned by `select_paths`.
        path: file in which the plot is saved, or None to save no file. The suffix determines the format: PNG, PDF, SVG.
        title: title of the plot.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 0.8 + 1.7 * len(paths)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(paths), 1, sharex=True))
    flights = {name: with_flight(log) for name, log in logs.items()}
    for axis, signal in zip(axes, paths, strict=True):
        for colour, (name, log) in zip(COLOURS, flights.items(), strict=False):
            if signal in log and len(log):
                unit, factor = display_unit(signal, log.unit(signal))
                draw_line(axis, log.t, np.asarray(log[signal], np.float64) * factor, color=colour, lw=1.0, label=name)
                if unit not in ("", "1"):
                    axis.set_ylabel(unit)
        axis.set_title(signal, loc="left", fontsize=9, weight="bold")
        axis.set_title(f"pale, {CHATTER}" if has_chatter(axis) else "", loc="right", fontsize=8, color=GREY)
        style_grid(axis)
    axes[-1].set_xlabel("time (s)")
    if len(logs) > 1:
        axes[0].legend(loc="upper right", fontsize=8)
    return save_figure(figure, path, title)
