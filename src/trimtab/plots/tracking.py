"""A picture of how well a run tracks: wanted and flown, inputs, then each state nobody measures with its estimate.

Which rows there are follows from the log's paths: a signal `law.X_wanted` beside `truth.X` makes one.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.plots.style import BLUE, GREEN, GREY, VERMILION, PicturePath, decimate, new_figure, save_figure, style_axes

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
WIDTH, ROW_HEIGHT, TOP = 14.0, 1.7, 0.7
ROOM = 1.3
"""Axes show so many times what they have to."""
WITHOUT = "estimate.state.without_measurement"
"""What the estimator's model gives without any measurement: an error that vanishes there too proves nothing."""


class SignalRow(NamedTuple):
    """One signal: its name, and whether the estimator has to find it (an estimate that differs from the truth)."""

    name: str
    is_estimated: bool


def tracking_rows(log: Log) -> list[SignalRow]:
    """Tracked signals first, in the order of the log, then those that are estimated."""
    wanted = [p.removeprefix("law.").removesuffix("_wanted") for p in log.paths if _is_wanted(log, p)]
    rows = [SignalRow(name, _has_own_estimate(log, name)) for name in wanted]
    return sorted(rows, key=lambda row: row.is_estimated)


def plot_tracking(log: Log, path: PicturePath = None, title: str = "Tracking") -> "Figure":
    """Draw each wanted signal with its error; inputs between tracked and estimated ones.

    Args:
        log: of a run whose law logs `X_wanted` for signals X of the truth.
        path: where to save, see `PicturePath`.
        title: what to write above.
    """
    rows = tracking_rows(log)
    if not rows:
        problem = "its law logs no signal X_wanted beside truth.X"
        raise InputError("plot_tracking", problem, fix="draw it with plot_run instead")
    inputs = [p for p in log.paths if p.startswith("actuators.u.")]
    tracked = [r for r in rows if not r.is_estimated]
    count = len(rows) + -(-len(inputs) // 2)
    figure = new_figure(WIDTH, TOP + count * ROW_HEIGHT)
    every: Any = figure.subplots(count, 2, sharex=True, squeeze=False)
    for axes, row in zip(every, tracked, strict=False):
        _draw_row(axes, log, row)
    below = every[len(tracked) :]
    for axes, name in zip(below.flat, inputs, strict=False):
        _draw_input(axes, log, name)
    for axes in list(below.flat)[len(inputs) : len(inputs) + len(inputs) % 2]:
        axes.set_axis_off()
    for axes, row in zip(below[-(-len(inputs) // 2) :], rows[len(tracked) :], strict=True):
        _draw_row(axes, log, row)
    for axes in every[-1]:
        axes.set_xlabel("time (s)", fontsize=9)
    if len(log) > 1:
        every[0, 0].set_xlim(log.t[0], log.t[-1])
    return save_figure(figure, path, title, "blue: flown; green: wanted; red: estimated", title_size=14)


def _is_wanted(log: Log, path: str) -> bool:
    name = path.removeprefix("law.").removesuffix("_wanted")
    return path == f"law.{name}_wanted" and f"truth.{name}" in log and log[path].ndim == 1


def _has_own_estimate(log: Log, name: str) -> bool:
    """Whether there is an estimate of it that is not simply the truth, to rounding."""
    path = f"estimate.state.{name}"
    if path not in log:
        return False
    error, size = np.abs(log[path] - log[f"truth.{name}"]), np.abs(log[f"truth.{name}"])
    return bool(np.nanmax(error[1:], initial=0.0) > 1e-9 * max(np.nanmax(size, initial=0.0), 1e-9))


def _draw_row(pair: Any, log: Log, row: SignalRow) -> None:
    value, error = pair
    path, title = f"truth.{row.name}", row.name.replace("_", " ")
    unit = log.unit(path)
    if row.is_estimated:
        value.plot(*decimate(log.t, log[f"estimate.state.{row.name}"]), color=VERMILION, lw=0.9)
    value.plot(*decimate(log.t, log[path]), color=BLUE, lw=1.0)
    value.plot(*decimate(log.t, log[f"law.{row.name}_wanted"]), color=GREEN, lw=1.0, ls="--")
    _style_panel(value, title, "", unit)
    if not row.is_estimated:
        off = _signed_difference(log, path, log[path], log[f"law.{row.name}_wanted"])
        error.plot(*decimate(log.t, off), color=BLUE, lw=0.9)
        _set_vertical_range(error, log, off)
        _style_panel(error, f"{title} minus wanted", _rms(log, off), unit)
        return
    off = _signed_difference(log, path, log[f"estimate.state.{row.name}"], log[path])
    note = _rms(log, off)
    alone, shown = f"{WITHOUT}.{row.name}", [off]
    if alone in log:
        bare = _signed_difference(log, path, log[alone], log[path])
        shown.append(bare)
        error.plot(*decimate(log.t, bare), color=GREY, lw=0.8)
        note += "; grey: without measurement"
    error.plot(*decimate(log.t, off), color=VERMILION, lw=0.9)
    _set_vertical_range(error, log, *shown)
    _set_vertical_range(value, log, log[path], log[f"estimate.state.{row.name}"], middle=True)
    _style_panel(error, f"{title}: estimate minus truth", note, unit)


def _signed_difference(log: Log, path: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a - b, the short way round for angles."""
    off = a - b
    angle = path in log.declarations and log.declarations[path].kind == "angle"
    return np.angle(np.exp(1j * off)) if angle else off


def _set_vertical_range(axes: Any, log: Log, *signals: np.ndarray, middle: bool = False) -> None:
    """The vertical range of what comes after the first twentieth of the run: a start far off would hide all else."""
    late = np.concatenate([x[len(log) // 20 :] for x in signals])
    late = late[np.isfinite(late)]
    if not len(late):
        return
    centre = float(late.min() + late.max()) / 2 if middle else 0.0
    reach = ROOM * float(np.abs(late - centre).max())
    if 0 < reach < 1e12:
        axes.set_ylim(centre - reach, centre + reach)


def _draw_input(axes: Any, log: Log, path: str) -> None:
    x, title = log[path], path.removeprefix("actuators.u.").replace("_", " ")
    axes.plot(*decimate(log.t, x), color=BLUE, lw=0.9)
    _style_panel(axes, title, f"{x.min():.4g} to {x.max():.4g}" if len(x) else "", log.unit(path))


def _rms(log: Log, error: np.ndarray) -> str:
    """What is left after the first tenth of the run."""
    late = error[len(log) // 10 :]
    if not np.isfinite(late).all():
        return "lost"
    return f"rms {np.sqrt(np.mean(late**2)):.3g} after {log.t[len(log) // 10]:.0f} s" if len(late) else ""


def _style_panel(axes: Any, title: str, note: str, unit: str) -> None:
    from matplotlib.ticker import FuncFormatter

    style_axes(axes, title, note, unit)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.6g}"))
