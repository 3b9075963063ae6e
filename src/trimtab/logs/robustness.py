"""Robustness of a formula of signal temporal logic at each row of a log, for several runs at once.

A formula is evaluated only at the times of rows. For a row at time t, the interval [a, b] is the set of rows at times
t' with t + a <= t' <= t + b. The minimum over no rows is +inf, the maximum is -inf. The robustness of a formula is:

    x <= c, x < c    c - x         x == c   -|x - c|       always[a, b] F       min of F over the interval
    x >= c, x > c    x - c         x != c   |x - c|        F until[a, b] G      max over t' in the interval of
    not F  -F        F and G  min(F, G)                                            min(G(t'), min of F over [t, t'))

The formula holds if the robustness is above 0, and does not hold if it is below 0. A comparison of equal numbers has
the robustness +EQUALITY_ROBUSTNESS if it holds and -EQUALITY_ROBUSTNESS otherwise, so that the sign always decides. A
comparison with NaN and its negation both have the robustness -inf. The time to compute a minimum or maximum over a
sliding window is proportional to the number of rows, for any length of the window: each window is split at a boundary,
and the running extremes on both sides of the boundary are combined.

Source: Donze, Maler, "Robust satisfaction of temporal logic over real-valued signals", FORMATS 2010; bounded until from
an unbounded one: Donze, Ferrere, Maler, "Efficient robust monitoring for STL", CAV 2013, section 4; the windows: van
Herk, Pattern Recognition Letters 13 (1992), and Gil, Werman, IEEE PAMI 15 (1993), here for rows at any times; docs
page, Temporal logic.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.formula import Arithmetic, Connective, Literal, Predicate, SignalPath, Temporal
from trimtab.core.formula_units import Formula, fit_formula, least_length
from trimtab.core.time import format_time
from trimtab.logs.log import Log
from trimtab.logs.metrics import full_path

EQUALITY_ROBUSTNESS = 1e-30
"""Magnitude of the robustness of a comparison of equal numbers. Its sign shows if the comparison holds."""
EXTREMES = {"always": np.minimum, "historically": np.minimum, "eventually": np.maximum, "once": np.maximum}
PENDING, HOLDS, VIOLATED = range(3)
VERDICTS = ("pending", "holds", "violated")
"""Names of the possible verdicts on a formula during a flight."""
OPPOSITE = {"historically": "always", "once": "eventually", "since": "until"}
"""Temporal operator about the past -> operator about the future that is equivalent if the time is reversed."""


class Assessment(NamedTuple):
    """Verdict on a formula for a log.

    robustness: robustness at the first row of the log, in the unit `unit`. It is above 0 if the formula holds.
    """

    formula: str
    robustness: float
    unit: str

    @property
    def holds(self) -> bool:
        """Return True if the log satisfies the formula."""
        return self.robustness > 0

    def __str__(self) -> str:
        """Return the verdict as one line of text, e.g. "holds, robustness 0.12 rad/s: always(…)"."""
        return f"{'holds' if self.holds else 'VIOLATED'}, robustness {format_robustness(self)}: {self.formula}"


def format_robustness(assessment: Assessment) -> str:
    """Return the robustness with its unit as text. The value of a comparison of equal numbers is shown as 0."""
    value = 0.0 if abs(assessment.robustness) <= EQUALITY_ROBUSTNESS else assessment.robustness
    return f"{value:.4g}" + (f" {assessment.unit}" if assessment.unit != "1" else "")


def fit_to_log(text: str, log: Log) -> Formula:
    """Parse a formula about the signals of a log. Raise InputError if a signal is missing or a unit is wrong."""
    shapes = {path: values.shape[1:] for path, values in log.signals.items()}
    return fit_formula(text, shapes, {path: log.unit(path) for path in log.signals}, full_path)


def assess_formula(log: Log, text: str) -> Assessment:
    """Evaluate a formula at the first row of a log.

    Raises:
        InputError: the formula is invalid, or the log ends before the last instant that the formula needs.
    """
    formula = fit_to_log(text, log)
    end = log.metadata.get("duration_s")
    last = int(log.ticks[-1]) if len(log) else 0
    check_length(formula, max(last, round(end * 1e7)) if end is not None else last)
    rows = robustness(formula, log.ticks, lambda path: log[path][None])
    return Assessment(text, float(rows[0, 0]), formula.unit)


def check_length(formula: Formula, duration: int) -> None:
    """Raise InputError if a formula looks ahead by more than the duration of a run (100 ns)."""
    needed = least_length(formula.root)
    if needed > duration:
        problem = f"the formula looks {format_time(needed)} ahead, but the run lasts {format_time(duration)}"
        fix = f"{argument('settings', format_time(needed), 'duration')}, or end the formula's intervals earlier"
        raise InputError(f"formula {formula.text!r}", problem, fix=fix)


def robustness(formula: Formula, ticks: Any, read: Callable[[str], Any]) -> Any:
    """Return the robustness of a formula at each of m rows of n runs, shape (n, m).

    Args:
        formula: formula that fits the signals.
        ticks: times of the rows, int64 (m,), strictly increasing.
        read: function that returns the values (n, m) or (n, m, k) of a path.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        rows = _Rows(np.asarray(ticks, np.int64), lambda path: np.swapaxes(np.asarray(read(path), np.float64), 0, 1))
        return np.ascontiguousarray(rows.evaluate(formula.root, 1).T)


class _Rows:
    """Evaluation of formulas at m rows of n runs. The results are arrays (m, n).

    sign: argument of the methods, -1 for a negated formula, else 1.
    """

    def __init__(self, ticks: Any, read: Callable[[str], Any]) -> None:
        self.ticks, self.read = ticks, read

    def evaluate(self, tree: Any, sign: int) -> Any:
        if isinstance(tree, Predicate):
            left, right = (evaluate_number(number, self.read) for number in (tree.left, tree.right))
            return compare(np, left, tree.relation, right, sign)
        if isinstance(tree, Connective):
            first = tree.word in ("not", "implies")
            below = [self.evaluate(f, -sign if first and k == 0 else sign) for k, f in enumerate(tree.formulas)]
            return join(np, tree.word, below)
        assert isinstance(tree, Temporal)
        below = [self.evaluate(formula, sign) for formula in tree.formulas]
        if tree.word not in OPPOSITE:
            return _look_ahead(self.ticks, tree.word, tree.low, tree.high, below)
        backwards = [x[::-1] for x in below]
        return _look_ahead(-self.ticks[::-1], OPPOSITE[tree.word], tree.low, tree.high, backwards)[::-1]


def evaluate_number(tree: Any, read: Callable[[str], Any]) -> Any:
    """Return the value of a numeric expression in a formula.

    read: function that returns the values (…, components) of the signal with a given path.
    """
    if isinstance(tree, Literal):
        return tree.value
    if isinstance(tree, SignalPath):
        return read(tree.path) if tree.component is None else read(tree.path)[..., tree.component]
    assert isinstance(tree, Arithmetic)
    numbers = [evaluate_number(number, read) for number in tree.numbers]
    if tree.operator == "abs":
        return abs(numbers[0])
    if tree.operator == "negative":
        return -numbers[0]
    one, other = numbers
    if tree.operator == "+":
        return one + other
    if tree.operator == "-":
        return one - other
    return one * other if tree.operator == "*" else one / other


def compare(xp: Any, left: Any, relation: str, right: Any, sign: int) -> Any:
    """Return the robustness of a comparison. xp: numpy or jax.numpy.

    sign: -1 if the comparison is negated, else 1. It is needed so that with NaN neither a comparison nor its negation
    holds.
    """
    room = right - left if relation in ("<", "<=") else left - right
    if relation in ("==", "!="):
        room = -abs(room) if relation == "==" else abs(room)
    equal = EQUALITY_ROBUSTNESS if relation in ("<=", ">=", "==") else -EQUALITY_ROBUSTNESS
    room = xp.where(room == 0, equal, room)
    return xp.where(xp.isnan(room), -sign * np.inf, room)


def join(xp: Any, word: str, below: list[Any]) -> Any:
    """Return the robustness of a formula with the operator not, and, or, implies.

    word: the operator.  below: robustness of the operands.
    """
    if word == "not":
        return -below[0]
    if word == "and":
        return xp.minimum(*below)
    return xp.maximum(-below[0] if word == "implies" else below[0], below[1])


def _look_ahead(ticks: Any, word: str, low: int, high: int | None, below: list[Any]) -> Any:
    """Return the robustness of always, eventually or until, applied to the robustness of the operands (m, n)."""
    first = np.searchsorted(ticks, ticks + low, "left")
    last = np.full(len(ticks), len(ticks) - 1) if high is None else np.searchsorted(ticks, ticks + high, "right") - 1
    if word != "until":
        return slide(below[0], first, last, EXTREMES[word])
    stays, comes = np.broadcast_arrays(*below)
    from_here = np.empty(stays.shape)
    value = np.full(stays.shape[1:], -np.inf)
    for i in range(len(ticks) - 1, -1, -1):
        value = np.maximum(comes[i], np.minimum(stays[i], value))
        from_here[i] = value
    until = np.concatenate([from_here, np.full((1, *stays.shape[1:]), -np.inf)])[first]
    if low > 0:
        until = np.minimum(until, slide(stays, np.arange(len(ticks)), first - 1, np.minimum))
    return until if high is None else np.minimum(until, slide(comes, first, last, np.maximum))


def slide(x: Any, first: Any, last: Any, extreme: Any) -> Any:
    """Return, for each row i, the minimum or maximum of x (m, n) over the window of rows first[i] … last[i], (m, n).

    first, last: indices of the first and last row of each window, both non-decreasing.  extreme: np.minimum or
    np.maximum. For a window without rows, the result is +inf or -inf.
    """
    result = np.full(x.shape, np.inf if extreme is np.minimum else -np.inf)
    full = np.flatnonzero(first <= last)
    if (first[full] == last[full]).all():
        result[full] = x[first[full]]
        return result
    first, last, k = first[full], last[full], 0
    while k < len(full):
        middle = last[k]  # in every window from window k up to the first that begins after this row
        end = int(np.searchsorted(first, middle, "right"))
        before = extreme.accumulate(x[first[k] : middle + 1][::-1])
        after = extreme.accumulate(x[middle : last[end - 1] + 1])
        result[full[k:end]] = extreme(before[middle - first[k:end]], after[last[k:end] - middle])
        k = end
    return result
