"""Integer time: units of 100 ns, so that 1 ms = 10 000 and the 6.5536 ms tick of an IMU = 65 536 are both exact.

A run steps through the instants at which a block is due, in order. Whether a block is due depends only on the time.
"""

import functools
import re
from collections.abc import Iterable
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError

UNITS_PER_SECOND = 10_000_000
SECONDS_PER_UNIT = 1e-7
NAMES = {"min": "60", "s": "1", "ms": "1e-3", "us": "1e-6", "µs": "1e-6", "ns": "1e-9"}
FOREVER = 2**62
"""Time later than all instants of a run."""
NEVER = -FOREVER
"""Time earlier than all instants of a run, for events that have not happened."""


def seconds(value: float | str | Decimal) -> int:
    """Return a time in seconds as integer units of 100 ns. Raise InputError if it is not a whole number of units.

    >>> from trimtab import seconds
    >>> seconds(2)
    20000000
    """
    try:
        units = Decimal(str(value)) * UNITS_PER_SECOND
    except ArithmeticError:
        problem = f"{value!r} is not a number of seconds"
        raise InputError("time", problem, fix="write e.g. 0.02 or '6.5536 ms'") from None
    if not units.is_finite() or units != units.to_integral_value():
        problem = f"{value} s is not a whole number of 100 ns units"
        raise InputError("time", problem, fix="round it to 1e-7 s, e.g. 0.0065536")
    return int(units)


def ms(value: float | str) -> int:
    """Return a time in milliseconds as integer units of 100 ns, e.g. ``ms(6.5536) == 65536``.

    >>> from trimtab import ms
    >>> ms(6.5536)
    65536
    """
    return parse_time(f"{value} ms")


def parse_time(text: str | float) -> int:
    """Return the integer time for a text such as ``20 ms``, ``150 us``, ``2 s``, ``3 min``, or a number of seconds."""
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*(min|s|ms|us|µs|ns)?\s*", str(text))
    if not match:
        raise InputError("time", f"{text!r} is not a time", choices=NAMES, fix="write e.g. '20 ms' or 0.02")
    try:
        value = Decimal(match[1]) * Decimal(NAMES[match[2] or "s"])
    except ArithmeticError:
        raise InputError("time", f"{text!r} is not a time", choices=NAMES, fix="write e.g. '20 ms' or 0.02") from None
    return seconds(value)


def nearest_time(text: str, usual: str) -> str:
    """Return the time that was probably meant, such as 3 min for 3 m, or `usual` if unknown."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(m|mins?|minutes?|h|hours?|secs?|seconds?)\s*", text, re.IGNORECASE)
    if match is None:
        return usual
    number, unit = Decimal(match[1]), match[2][0].lower()
    return f"{number * 60 if unit == 'h' else number:f} {'s' if unit == 's' else 'min'}"


def as_time(part: str, value: Any) -> int:
    """Return a time as integer units, from integer units or a text such as ``20 ms``. Raise InputError for any other
    value, including a float.

    part: name of the argument, for the error, e.g. ``duration``.
    """
    if isinstance(value, str):
        try:
            return parse_time(value)
        except InputError as error:
            raise InputError(
                part, error.problem, choices=error.choices, fix=f'{part}="{nearest_time(value, "20 s")}"'
            ) from None
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return int(value)
    problem = f"{value!r} is not a whole number of 100 ns"
    name, number = part.rpartition(".")[2], value if isinstance(value, float) else 20
    raise InputError(part, problem, fix=f'{name}="{number} s", or {name}=seconds({number})')


def format_time(units: int) -> str:
    """Return a time as readable text: ``6.5536 ms``, ``20 ms``, ``2 s``."""
    if units and units % UNITS_PER_SECOND == 0:
        return f"{units // UNITS_PER_SECOND} s"
    return f"{Decimal(int(units)).scaleb(-4).normalize():f} ms"


def to_seconds(units: Any) -> Any:
    """Return integer time in seconds, as a float. Also works for arrays and while a run is traced."""
    return units * SECONDS_PER_UNIT


class Instant(NamedTuple):
    """The present instant, and the periods of the blocks known to be due at every instant of the run."""

    t: Any
    always: frozenset[int] = frozenset()

    def due(self, period: int) -> Any:
        """Return True if a block of this period is due now: as a traced value, or as a plain True if always due."""
        return True if period in self.always else self.t % period == 0


class Timetable(NamedTuple):
    """Times at which the blocks of a run are computed. t[0] is 0; the last step ends at the end of the run.

    t: int64 (n,), strictly rising, without the end of the run.  h: int64 (n,), the time from each instant to the next,
    or to the end of the run.  always: periods of the blocks that are due at every instant.
    """

    t: np.ndarray[Any, np.dtype[np.int64]]
    h: np.ndarray[Any, np.dtype[np.int64]]
    always: frozenset[int]


def timetable(periods: Iterable[int], duration: int, max_step: int) -> Timetable:
    """Return all multiples of the periods in [0, duration), with gaps longer than max_step split evenly.

    Args:
        periods: periods of the blocks in 100 ns units, each at least 1, with or without common divisor.
        duration: end of the run. No block is computed at this time.
        max_step: longest integration step.
    """
    return _merge_instants(tuple(sorted({int(p) for p in periods})), int(duration), int(max_step))


@functools.lru_cache(maxsize=8)
def _merge_instants(distinct: tuple[int, ...], duration: int, max_step: int) -> Timetable:
    due = [np.arange(0, duration, p, dtype=np.int64) for p in distinct]
    t = np.unique(np.concatenate([np.zeros(1, np.int64), *due]))
    gaps = np.diff(np.append(t, duration))
    parts = -(-gaps // max_step)
    if (parts > 1).any():
        first = np.repeat(t, parts)
        index = np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)
        t = first + index * np.repeat(gaps, parts) // np.repeat(parts, parts)
    h = np.diff(np.append(t, duration))
    t.flags.writeable = h.flags.writeable = False
    return Timetable(t, h, frozenset(p for p in distinct if not (t % p).any()))
