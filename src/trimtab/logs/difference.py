"""Comparison of two logs: first difference and largest difference of each signal.

Values at common instants are compared exactly, and NaN equals NaN. The two logs may be of different flights. Use
`run.replay.compare_logs` to check if two backends computed the same flight up to rounding errors.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.logs.log import Log


class SignalDifference(NamedTuple):
    """Difference of one number, a signal or an element of a signal, between two logs.

    path: path of the number, e.g. "truth.velocity[0]".  first_s: time (s) of the first difference.  one, other: values
    at this time in the first and in the second log.  largest: largest difference at any time.
    """

    path: str
    first_s: float
    one: float
    other: float
    largest: float


class LogDifference(NamedTuple):
    """Differences of two logs.

    instants: number of common instants.  compared: number of common signals.  signals: numbers that differ, elements of
    signals, sorted by the time of their first difference.  only_one: paths of signals that only the first log has.
    only_other: paths of signals that only the second log has.
    """

    instants: int
    compared: int
    signals: tuple[SignalDifference, ...]
    only_one: tuple[str, ...]
    only_other: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Return True if all common signals are equal at all common instants."""
        return not self.signals


def find_difference(one: Log, other: Log) -> LogDifference:
    """Return the differences between two logs.

    Raises: InputError if the logs have no common instant or no common signal.
    """
    ticks, rows, others = np.intersect1d(one.ticks, other.ticks, assume_unique=True, return_indices=True)
    both = [path for path in one.paths if path in other.signals and one[path].shape[1:] == other[path].shape[1:]]
    if not len(ticks) or not both:
        problem = "the logs have no instant in common" if both else "the logs have no signal in common"
        raise InputError(
            "compare", problem, fix=f"compare logs of one scenario, with the same {argument_name('log_period')}"
        )
    found = []
    for path in both:
        for name in one.numbers(path):
            difference = _differ(name, one.t[rows], one[name][rows], other[name][others])
            found += [] if difference is None else [difference]
    shared = set(both)
    return LogDifference(
        instants=len(ticks),
        compared=len(both),
        signals=tuple(sorted(found, key=lambda difference: difference.first_s)),
        only_one=tuple(path for path in one.paths if path not in shared),
        only_other=tuple(path for path in other.paths if path not in shared),
    )


def _differ(path: str, t: Any, one: Any, other: Any) -> SignalDifference | None:
    a, b = (np.asarray(x, np.float64).reshape(len(t), -1) for x in (one, other))
    apart = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    if not apart.any():
        return None
    row = int(apart.any(axis=1).argmax())
    column = int(apart[row].argmax())
    with np.errstate(invalid="ignore"):
        gaps = np.abs(a - b)[apart]
    largest = float(np.max(np.where(np.isnan(gaps), np.inf, gaps)))
    return SignalDifference(path, float(t[row]), float(a[row, column]), float(b[row, column]), largest)
