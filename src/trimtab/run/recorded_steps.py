"""The control steps that a log holds: which of its rows they are, and what the autopilot was given in each."""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.time import show, to_seconds
from trimtab.logs.log import Log

COUNTERS = ("log.dropped", "log.unwritten")
"""What a flight's log counts: rows that it lacks."""


class Steps(NamedTuple):
    """Control steps, from the first on and without a gap.

    rows: of the log (n,).  inputs: float64 (n, width), what each step was given.  rest: why it ends, or nothing.
    """

    rows: Any
    inputs: Any
    rest: str


def recorded_steps(log: Log, frames: list[str], period: int) -> Steps:
    """The steps of a log, as far as it holds all of them.

    Args:
        log: of a simulation, or of a flight, whose rows are its steps.
        frames: paths of the inputs, ``t`` and ``samples.…``, in order.
        period: between two control instants.

    Raises:
        InputError: a log whose rows are not the control instants from the first on, or that lacks a signal.
    """
    if not len(log):
        raise InputError("replay", "the log holds no step", fix="give a log with at least one row")
    rows, rest = _flown(log) if COUNTERS[0] in log else _simulated(log, period)
    if log.metadata.get("truncated") and not rest:
        rest = f"the log is cut at {log.t[-1]:g} s"
    columns = [np.asarray(_column(log, path)[rows], np.float64).reshape(len(rows), -1) for path in frames]
    return Steps(rows, np.concatenate(columns, axis=1), rest)


def _column(log: Log, path: str) -> Any:
    if path == "t":
        return log.ticks
    name = "downlink" + path.removeprefix("samples")
    if name not in log:
        problem = f"the log lacks {name!r}, which the autopilot reads"
        fix = "record with all signals, or fly an autopilot that reads what was recorded"
        sensors = sorted({p.split(".")[1] for p in log.paths if p.startswith("downlink.")})
        raise InputError("replay", problem, choices=sensors, fix=fix)
    return log[name]


def _flown(log: Log) -> tuple[Any, str]:
    """Every row is a step; where rows are missing, what follows can't be repeated."""
    missing = np.sum([log[name] for name in COUNTERS if name in log], axis=0)
    if missing[0]:
        raise InputError("replay", f"the log lacks its first {missing[0]} steps", fix="give a log from the start on")
    whole = int(np.argmax(missing > 0)) if missing.any() else len(log)
    rest = f"the log lacks steps after {log.t[whole - 1]:g} s" if whole < len(log) else ""
    return np.arange(whole), rest


def _simulated(log: Log, period: int) -> tuple[Any, str]:
    """Of each control instant there must be a row."""
    rows = np.flatnonzero(log.ticks % period == 0)
    ticks = log.ticks[rows]
    if log.ticks[0] != 0:
        problem = f"the log begins at {to_seconds(int(log.ticks[0])):g} s, when the state is not known"
        raise InputError("replay", problem, fix="give the log from the start of the run on")
    if (np.diff(ticks) != period).any() or (len(rows) == 1 and len(log) > 1):
        usual = int(np.median(np.diff(log.ticks)))
        problem = f"the log has a row each {show(usual)}, the autopilot makes a step each {show(period)}"
        raise InputError("replay", problem, fix=f"record again with --log-period '{show(period)}'")
    return rows, ""
