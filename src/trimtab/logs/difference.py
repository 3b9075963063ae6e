"""Where two logs of the same run part: the first sample that differs, and whether a switch on data came before it."""

from typing import NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.logs.log import Log

ROUNDINGS = 8
"""Of the largest signal in the same unit: an error of 0.01 ft at 85 000 ft has no more digits than the altitude has.
Most seen in the hypersonic climb: 5, in 100 runs of a second and 6 whole ones."""
DISCRETE = ("mode", "flag", "count", "word", "time")


class Difference(NamedTuple):
    """Two logs beside each other.

    instants: how many are the same in time.  switch: (time, path, one, other) of the first whole number or truth value
    that differs, or None: from there on two sound backends may part, since a rounding tipped a threshold.
    number: the same of the first real number before that which is off by more than the tolerance, or None.
    worst: path -> largest difference before the switch, as a part of the signal's largest size.
    """

    instants: int
    switch: tuple[float, str, float, float] | None
    number: tuple[float, str, float, float] | None
    worst: dict[str, float]

    @property
    def equal(self) -> bool:
        """Whether all real numbers agree up to the first switch."""
        return self.number is None


def difference(one: Log, other: Log, tolerance: float = 1e-10) -> Difference:
    """Compare two logs signal by signal.

    Args:
        one, other: logs of the same instants and signals.
        tolerance: of real numbers, as a part of the largest size that the signal has in `one` (or of 1e-3, if larger).
            A signal may also be off by ROUNDINGS of the largest in the same unit: it may be the difference of two such.

    Raises:
        InputError: logs of other instants or other signals.
    """
    if not np.array_equal(one.ticks, other.ticks):
        raise InputError("difference", "the logs have other instants", fix="log both with the same log_period")
    if one.paths != other.paths:
        apart = sorted({*one.paths} ^ {*other.paths})
        raise InputError("difference", f"only one of the logs has {apart[0]!r}", fix="log the same signals")
    real = [p for p in one.paths if one[p].dtype.kind == "f"]
    whole = [p for p in one.paths if p not in real]
    switch = _first(one, other, [(p, _apart(one[p], other[p])) for p in whole], len(one))
    until = len(one) if switch is None else int(np.searchsorted(one.t, switch[0]))
    worst, off, largest = {}, [], _largest(one, real)
    for path in real:
        gap = _gap(one[path][:until], other[path][:until])
        size = max(float(np.nanmax(np.abs(one[path]), initial=0.0)), 1e-3)
        worst[path] = float(gap.max(initial=0.0)) / size
        rounding = ROUNDINGS * float(np.spacing(largest[one.unit(path)]))
        off.append((path, gap > max(tolerance * size, rounding)))
    return Difference(until, switch, _first(one, other, off, until), worst)


def _largest(log: Log, paths: list[str]) -> dict[str, float]:
    """Unit -> largest finite size of the signals that have it."""
    found: dict[str, float] = {}
    for path in paths:
        finite = np.abs(log[path][np.isfinite(log[path])])
        found[log.unit(path)] = max(found.get(log.unit(path), 0.0), float(finite.max(initial=0.0)))
    return found


def _gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest difference at each instant; NaN equals NaN and nothing else."""
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        gap = np.where(same, 0.0, np.abs(a - b))
    return np.where(np.isnan(gap), np.inf, gap).reshape(len(a), -1).max(axis=1, initial=0.0)


def _apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a != b).reshape(len(a), -1).any(axis=1)


def _first(
    one: Log, other: Log, apart: list[tuple[str, np.ndarray]], until: int
) -> tuple[float, str, float, float] | None:
    found = [(int(bad.argmax()), path) for path, bad in apart if bad[:until].any()]
    if not found:
        return None
    k, path = min(found)
    a, b = np.ravel(one[path][k]), np.ravel(other[path][k])
    j = int(np.argmax(a != b))
    return float(one.t[k]), path, float(a[j]), float(b[j])
