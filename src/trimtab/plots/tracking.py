"""Plot of the tracking in a run: reference and flown signals, inputs, and states that the estimator must find.

The drawn signals are chosen by the paths in the log: X is drawn if the log contains `law.X_reference` and `truth.X`.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.spatial import display_unit, referenced_signal
from trimtab.plots.style import (
    BLUE,
    CHATTER,
    GREEN,
    GREY,
    VERMILION,
    PicturePath,
    decimate,
    draw_line,
    has_chatter,
    new_figure,
    save_figure,
    style_axes,
)

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure
WIDTH, ROW_HEIGHT, TOP = 14.0, 1.7, 0.7
ROOM = 1.3
"""Range of the axes, as a multiple of the range of the drawn values."""
ABOVE, INSET = 0.8, (0.4, 0.56, 0.59, 0.34)
"""Free space above an error curve, as a multiple of the curve's range, and position of an inset in the axes: left,
bottom, width, height."""
WITHOUT = "estimate.state.without_measurement"
"""Log path of an estimate that uses no measurements. It is drawn for comparison with the estimator's error."""


class SignalRow(NamedTuple):
    """Signal in a row of the plot. is_estimated: True if the estimate of the signal differs from the true value."""

    name: str
    is_estimated: bool


def tracking_rows(log: Log) -> list[SignalRow]:
    """Return the signals to draw: first the tracked signals, in the order of the log, then the estimated signals."""
    tracked = [referenced_signal(p) for p in log.paths if _is_reference(log, p)]
    rows = [SignalRow(name, _has_own_estimate(log, name)) for name in tracked]
    return sorted(rows, key=lambda row: row.is_estimated)


def plot_tracking(log: Log, path: PicturePath = None, title: str = "Tracking") -> "Figure":
    """Draw the tracked signals with their errors, then the inputs, then the estimated signals.

    Args:
        log: log of a run whose law logs `X_reference` for signals X of the true state.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    rows = tracking_rows(log)
    if not rows:
        problem = "the law in the log has no signal X_reference next to truth.X"
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
    note = "blue: flown; green: reference; red: estimated"
    if any(row.is_estimated and _sigma(log, row.name) is not None for row in rows):
        note += "; dashed: two sigmas"
    if any(has_chatter(axes) for axes in figure.axes):
        note += f"; pale, {CHATTER}"
    return save_figure(figure, path, title, note, title_size=14)


def _is_reference(log: Log, path: str) -> bool:
    name = referenced_signal(path)
    return bool(name) and f"truth.{name}" in log and log[path].ndim == 1


def _has_own_estimate(log: Log, name: str) -> bool:
    """Return True if the log contains an estimate that differs from the truth by more than rounding errors."""
    path = f"estimate.state.{name}"
    if path not in log:
        return False
    error, size = np.abs(log[path] - log[f"truth.{name}"]), np.abs(log[f"truth.{name}"])
    return bool(np.nanmax(error[1:], initial=0.0) > 1e-9 * max(np.nanmax(size, initial=0.0), 1e-9))


def _draw_row(pair: Any, log: Log, row: SignalRow) -> None:
    value, error = pair
    path, title = f"truth.{row.name}", row.name.replace("_", " ")
    unit, factor = display_unit(path, log.unit(path))
    true, reference = factor * log[path], factor * log[f"law.{row.name}_reference"]
    if row.is_estimated:
        draw_line(value, log.t, factor * log[f"estimate.state.{row.name}"], color=VERMILION, lw=0.9)
    draw_line(value, log.t, true, color=BLUE, lw=1.0)
    draw_line(value, log.t, reference, color=GREEN, lw=1.0, ls="--")
    _style_panel(value, title, "", unit)
    if not row.is_estimated:
        off = factor * _signed_difference(log, path, log[path], log[f"law.{row.name}_reference"])
        _draw_error(error, log, [(off, BLUE)])
        _style_panel(error, f"{title} minus reference", _rms(log, off), unit)
        return
    off = factor * _signed_difference(log, path, log[f"estimate.state.{row.name}"], log[path])
    note, shown, sigma = _rms(log, off), [(off, VERMILION)], _sigma(log, row.name)
    alone = f"{WITHOUT}.{row.name}"
    if alone in log:
        shown.insert(0, (factor * _signed_difference(log, path, log[alone], log[path]), GREY))
        note += "; grey: without measurement"
    _draw_error(error, log, shown, None if sigma is None else factor * sigma)
    _set_vertical_range(value, log, true, factor * log[f"estimate.state.{row.name}"], middle=True)
    _style_panel(error, f"{title}: estimate minus truth", note, unit)


def _sigma(log: Log, name: str) -> np.ndarray | None:
    """Return the estimator's sigma of a state, which is logged as a signal or as an element of a vector.

    The vector has the order in which the states of the estimate without measurements appear in the log.
    """
    path, several = f"estimate.state.sigma_{name}", "estimate.state.sigma"
    if path in log:
        return log[path]
    names = [p.rpartition(".")[2] for p in log.paths if p.startswith(f"{WITHOUT}.")]
    if several in log and name in names and log[several].shape[1:] == (len(names),):
        return log[several][:, names.index(name)]
    return None


def _draw_error(axes: Any, log: Log, shown: list[tuple[np.ndarray, str]], sigma: np.ndarray | None = None) -> None:
    """Draw error curves in different colours, and the band of two sigmas. A start far outside is drawn in an inset."""
    band = [] if sigma is None else [-2 * sigma, 2 * sigma]
    end = _set_vertical_range(axes, log, *band, *(x for x, _ in shown))
    views = [(axes, slice(None))]
    if end:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + ABOVE * (high - low))
        views.append((axes.inset_axes(INSET), slice(end)))
    for view, rows in views:
        t = log.t[rows]
        for x, colour in shown:
            draw_line(view, t, x[rows], color=colour, lw=0.9)
        for edge in band:
            view.plot(*decimate(t, edge[rows]), color="black", lw=0.9, ls=(0, (4, 2)))
    for view, _ in views[1:]:
        view.tick_params(labelsize=6, length=2, pad=1)
        view.set_xlim(log.t[0], log.t[end - 1])
        view.set_title("the start", fontsize=7, color=GREY, loc="right", pad=2)


def _signed_difference(log: Log, path: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a - b. For angles, return the difference wrapped to ±180 degrees."""
    off = a - b
    angle = path in log.declarations and log.declarations[path].kind == "angle"
    return np.angle(np.exp(1j * off)) if angle else off


def _set_vertical_range(axes: Any, log: Log, *signals: np.ndarray, middle: bool = False) -> int:
    """Set the vertical range from all values except the first twentieth of the run.

    A start far outside would otherwise make the other values unreadable. Return the row from which on the last signal
    is within the range, or 0 if it was never outside.
    """
    first = len(log) // 20
    late = np.concatenate([x[first:] for x in signals])
    late = late[np.isfinite(late)]
    if not len(late):
        return 0
    centre = float(late.min() + late.max()) / 2 if middle else 0.0
    reach = ROOM * float(np.abs(late - centre).max())
    if not 0 < reach < 1e12:
        return 0
    axes.set_ylim(centre - reach, centre + reach)
    outside = np.flatnonzero(np.abs(signals[-1][:first] - centre) > reach)
    return min(int(1.5 * outside[-1]) + 10, first) if len(outside) else 0


def _draw_input(axes: Any, log: Log, path: str) -> None:
    x, title = log[path], path.removeprefix("actuators.u.").replace("_", " ")
    draw_line(axes, log.t, x, color=BLUE, lw=0.9)
    _style_panel(axes, title, f"{x.min():.4g} to {x.max():.4g}" if len(x) else "", log.unit(path))


def _rms(log: Log, error: np.ndarray) -> str:
    """Return the text of the RMS error after the first tenth of the run."""
    late = error[len(log) // 10 :]
    if not np.isfinite(late).all():
        return "lost"
    return f"rms {np.sqrt(np.mean(late**2)):.3g} after {log.t[len(log) // 10]:.0f} s" if len(late) else ""


def _style_panel(axes: Any, title: str, note: str, unit: str) -> None:
    from matplotlib.ticker import FuncFormatter

    style_axes(axes, title, note, unit)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.6g}"))
