"""Monitor that evaluates formulas in signal temporal logic during the flight. An optional part of the Autopilot.

The monitor evaluates the formulas once per monitor period. Each evaluation is called a row, because it corresponds to a
row of the log. The value of a formula that looks ahead is known only later, so the monitor's output at a row is the
value for an earlier row. The delay is the number of rows by which the formula looks ahead. The output equals, bit for
bit, the value that `logs.robustness` computes for the earlier row from the log. `always` or `eventually` without an end
must be the outermost operator. In this case the output is the smallest or largest value since the first row.

    always[a, b] F    at row i, the smallest of the last b - a + 1 values of F. This is the value for row i - b.
    F until[a, b] G   computed from a pair (u, m) for each window of rows: u is the value of until, m is the smallest
                      value of F. For an older window A and the following window B, the pair of the joined window is
                      u = max(uA, min(mA, uB))      m = min(mA, mB)

The value for a window of 2, 4, 8, … rows that ends now is combined from the values for two windows of half the length.
The two windows that are combined last may overlap. Therefore the computing time of a step does not depend on the data.
It grows with the logarithm of the number of rows in the window. The memory is one number for each row of the window.

Source: Maler, Nickovic, Pnueli, "From MITL to timed automata", FORMATS 2006, for the conversion of a formula about a
bounded future into one about the past; Bender, Farach-Colton, "The LCA problem revisited", LATIN 2000, for windows of
lengths that are powers of two; docs page, Monitor.
"""

import functools
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError, argument
from trimtab.core.formula import FUTURE, Connective, Predicate, Temporal, parse_formula
from trimtab.core.formula_units import Formula, fit_formula, look_ahead
from trimtab.core.record import Quantity, Scalar, leaves, option, part, period, quantity, record
from trimtab.core.time import format_time, ms
from trimtab.logs.robustness import HOLDS, PENDING, VERDICTS, VIOLATED, compare, evaluate_number, join

MOST_MEMORY = 100_000
"""Maximum number of values that a monitor may store for one formula."""
_NAMED = re.compile(r"\s*(?:(?P<name>[a-z][a-z0-9_]*)\s*:)?\s*(?P<formula>[^;]*?)\s*", re.DOTALL)
EXAMPLE = "always(abs(estimate.state.yaw_rate) < 4 rad/s)"
SMALLEST, LARGEST = (jnp.minimum, math.inf), (jnp.maximum, -math.inf)
EXTREMES = {"always": SMALLEST, "historically": SMALLEST, "eventually": LARGEST, "once": LARGEST}


@record
class MonitorInput:
    """Signals that a formula may use. A formula names a signal by the signal's path in the log.

    Source:  docs page, Monitor.
    """

    estimate: Any = part("Output of the estimator.")
    law: Any = part("Output of the law.")
    command: Any = part("Command as issued by the autopilot.")
    downlink: Any = part("Newest received sample of each sensor.")
    supervisor: Any = part("Output of the supervisor, or empty without a supervisor.", default=())


@record
class MonitorOutput:
    """Verdict on a formula. Frames: none. Source: docs page, Monitor."""

    robustness: Scalar = quantity(
        "U",
        "Robustness margin of the formula, in the unit of its comparison. Negative: violated. 0 as long as the value "
        "is not known.",
    )
    verdict: Scalar = quantity("1", "Verdict on the formula: pending, holds or violated.", kind="mode", modes=VERDICTS)


@record
class MonitorState:
    """Memory and last outputs of a monitor. Frames: none. Source: docs page, Monitor."""

    rows: Scalar = quantity("1", "Number of evaluations of the formulas since the start of the run.", kind="count")
    memory: Any = quantity(
        "U", "Values stored for formulas that refer to other times. The delay lines of all formulas follow one another."
    )
    outputs: Mapping[str, MonitorOutput] = part("Last verdict on each formula, by the formula's name.")


@record
class Monitor:
    """Monitor of formulas in signal temporal logic. It computes the margin of each formula once per `period`.

    Frames:  none; each formula has its own unit.
    Not modelled: skipped periods of a real-time flight. The formulas are not evaluated in a skipped period.
    Source:  docs page, Monitor.
    """

    formulas: str = option(
        "Formulas separated by semicolons, each with an optional name, e.g. 'turn: always(…); rest: always(…)'.",
        default="",
    )
    period: int = period(
        "Time between two evaluations of the formulas. It must be a multiple of the control period.", default=ms(10)
    )

    def check(self) -> None:
        """Raise InputError for invalid formulas, and for formulas that cannot be decided during a flight."""
        for name, text in self.texts().items():
            tree = parse_formula(text)
            inside = tree.formulas[0] if _is_without_end(tree) else tree
            if look_ahead(inside) is None:
                problem = f"{name}: {text!r} looks ahead without a time limit, so its value is never known in flight"
                fix = "add an end to each interval, e.g. eventually[0, 2 s](…); only the outermost may have no end"
                raise InputError("formulas", problem, fix=fix)
            _check_intervals(tree, name, self.period)
            online = _Online(self.period)
            online.assess(tree)
            if (size := online.used) > MOST_MEMORY:
                problem = f"{name}: {text!r} needs to store {size} values, but the maximum is {MOST_MEMORY}"
                raise InputError(
                    "formulas",
                    problem,
                    fix=f"{argument('settings', '100 ms', 'autopilot.monitor.period')}, or shorter intervals",
                )

    def texts(self) -> dict[str, str]:
        """Return the formulas by name.

        A formula without a name is named "requirement" or, if there are several formulas, by its position:
        "requirement_2" for the second formula.
        """
        texts: dict[str, str] = {}
        pieces = self.formulas.split(";")
        for k, piece in enumerate(pieces):
            match = _NAMED.fullmatch(piece)
            if match is None or not match["formula"]:
                problem = (
                    f"{piece.strip()!r} must be FORMULA or NAME: FORMULA; NAME may contain small letters, digits and _"
                )
                raise InputError("formulas", problem, fix=argument("settings", EXAMPLE, "autopilot.monitor.formulas"))
            name = match["name"] or ("requirement" if len(pieces) == 1 else f"requirement_{k + 1}")
            if name in texts:
                raise InputError("formulas", f"two formulas are named {name!r}", fix=f"rename one of them: {name}_2: …")
            texts[name] = match["formula"]
        return texts

    def fit(self, input: MonitorInput) -> dict[str, Formula]:
        """Return the formulas by name. Raise InputError for an unknown signal path or an unsuitable unit in a formula.

        input: example of the autopilot's signals.
        """
        known = [(path, np.shape(value), d.unit) for path, value, d in leaves(input) if isinstance(d, Quantity)]
        return self.fit_signals({path: shape for path, shape, _ in known}, {path: unit for path, _, unit in known})

    def fit_signals(self, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str]) -> dict[str, Formula]:
        """Return the formulas by name. Raise InputError for an unknown signal path or an unsuitable unit in a formula.

        shapes: path of a signal -> shape.  units: path of a signal -> unit.
        """
        try:
            return {name: fit_formula(text, shapes, units) for name, text in self.texts().items()}
        except InputError as error:
            problem = f"{error.part}: {error.problem}"
            raise InputError("autopilot.monitor", problem, choices=error.choices, fix=error.fix) from None

    def init(self, input: MonitorInput) -> MonitorState:
        """Return the initial state. input: example of the input of step()."""
        online = _Online(self.period)
        for formula in self.fit(input).values():
            online.assess(formula.root)
        outputs = {name: MonitorOutput(np.float64(0), np.int32(PENDING)) for name in self.texts()}
        memory = np.concatenate([np.zeros(1), *online.fills])
        return MonitorState(rows=np.int32(0), memory=memory, outputs=outputs)

    def step(self, t: Any, s: MonitorState, input: MonitorInput) -> MonitorState:
        """Return the monitor's state, which includes the outputs, at integer time t."""
        return lax.cond(t % self.period == 0, lambda: self._take_row(s, input), lambda: s)

    def _take_row(self, s: MonitorState, input: MonitorInput) -> MonitorState:
        values = {path: value for path, value, _ in leaves(input)}
        online = _Online(self.period, s.memory, s.rows, lambda path: jnp.asarray(values[path], np.float64))
        outputs = {name: online.assess(formula.root) for name, formula in self.fit(input).items()}
        return MonitorState(rows=s.rows + 1, memory=online.memory, outputs=outputs)


def _is_without_end(tree: Any) -> bool:
    return isinstance(tree, Temporal) and tree.word in FUTURE and tree.high is None


def _rows_of(tree: Temporal, period: int) -> tuple[int, int | None]:
    """Return the first and the last row of a formula's time interval, relative to the evaluated row.

    The last row is None if the interval has no end.
    """
    return -(-tree.low // period), None if tree.high is None else tree.high // period


def _check_intervals(tree: Any, name: str, period: int) -> None:
    """Raise InputError for a time interval in which the monitor does not evaluate the formula once."""
    if isinstance(tree, Predicate):
        return
    if isinstance(tree, Temporal):
        low, high = _rows_of(tree, period)
        if high is not None and high < low:
            problem = (
                f"{name}: the interval of {tree.word} contains no evaluation, because the monitor's period is "
                f"{format_time(period)}"
            )
            raise InputError(
                "formulas",
                problem,
                fix=f"make the interval longer, or {argument('settings', '1 ms', 'autopilot.monitor.period')}",
            )
    for formula in tree.formulas:
        _check_intervals(formula, name, period)


class _Online:
    """Evaluation of a formula at the present row (one monitor period).

    All delay lines are stored in the array `memory`. If `memory` is None, nothing is evaluated, and only the required
    memory is counted.

    The methods return the value of a formula and the value's delay, a number of rows. Until this number of rows has
    been evaluated, the value has no meaning. sign: -1 in a negated formula, else 1.
    """

    def __init__(
        self, period: int, memory: Any = None, row: Any = 0, read: Callable[[str], Any] = lambda path: 0.0
    ) -> None:
        self.period, self.memory, self.row, self.read = period, memory, row, read
        self.used = 1
        self.fills: list[Any] = []

    def assess(self, tree: Any) -> MonitorOutput:
        """Return the verdict on a complete formula. tree: syntax tree of the formula."""
        if _is_without_end(tree):
            low, (extreme, none) = _rows_of(tree, self.period)[0], EXTREMES[tree.word]
            value, ago = self.evaluate(tree.formulas[0], 1)
            ago += low
            value = self._accumulate(extreme, self._since(ago, value, none), none)
            undecided = PENDING if tree.word == "eventually" else VIOLATED
        else:
            value, ago = self.evaluate(tree, 1)
            undecided = VIOLATED
        known = self.row >= ago
        verdict = jnp.where(value > 0, HOLDS, undecided)
        return MonitorOutput(
            robustness=jnp.where(known, value, 0.0), verdict=jnp.where(known, verdict, PENDING).astype(np.int32)
        )

    def evaluate(self, tree: Any, sign: int) -> tuple[Any, int]:
        if isinstance(tree, Predicate) and self.memory is None:
            return 0.0, 0
        if isinstance(tree, Predicate):
            left, right = (evaluate_number(number, self.read) for number in (tree.left, tree.right))
            return compare(jnp, left, tree.relation, right, sign), 0
        if isinstance(tree, Connective):
            first = tree.word in ("not", "implies")
            below = [self.evaluate(f, -sign if first and k == 0 else sign) for k, f in enumerate(tree.formulas)]
            values, ago = self._align(below)
            return join(jnp, tree.word, values), ago
        assert isinstance(tree, Temporal)
        values, ago = self._align([self.evaluate(formula, sign) for formula in tree.formulas])
        if tree.word in FUTURE:
            return self._look_back(tree, values), ago + (tree.high or 0) // self.period
        if tree.word == "until":
            return self._until(tree, *values), ago + (tree.high or 0) // self.period
        if tree.word == "since":
            none = (math.inf, -math.inf)
            stays, comes = (self._since(ago, x, n) for x, n in zip(values, none, strict=True))
            return self._since_interval(tree, stays, comes), ago
        low, high = _rows_of(tree, self.period)
        extreme, none = EXTREMES[tree.word]
        value = self._since(ago, values[0], none)
        if high is None:
            return self._delay(self._accumulate(extreme, value, none), low, none), ago
        return self._delay(self._slide_one(extreme, value, high - low + 1, none), low, none), ago

    def _look_back(self, tree: Temporal, values: list[Any]) -> Any:
        """Return the value of `always` or `eventually` over the last rows, as many as its interval contains."""
        low, high = _rows_of(tree, self.period)
        extreme, none = EXTREMES[tree.word]
        assert high is not None
        return self._slide_one(extreme, values[0], high - low + 1, none)

    def _until(self, tree: Temporal, stays: Any, comes: Any) -> Any:
        low, high = _rows_of(tree, self.period)
        assert high is not None
        width = high - low + 1
        until, _ = self._slide((comes, stays), width, (-math.inf, math.inf), _join_stretches)
        if low == 0:
            return until
        return jnp.minimum(until, self._delay(self._slide_one(jnp.minimum, stays, low, math.inf), width, math.inf))

    def _since_interval(self, tree: Temporal, stays: Any, comes: Any) -> Any:
        low, high = _rows_of(tree, self.period)
        if high is None:
            since = self._accumulate(lambda before, now: jnp.maximum(now, jnp.minimum(stays, before)), comes, -math.inf)
        else:
            turned = functools.partial(_swap, _join_stretches)
            since, _ = self._slide((comes, stays), high - low + 1, (-math.inf, math.inf), turned)
        if low == 0:
            return since
        return jnp.minimum(self._delay(since, low, -math.inf), self._slide_one(jnp.minimum, stays, low, math.inf))

    def _align(self, below: list[tuple[Any, int]]) -> tuple[list[Any], int]:
        """Return the values of subformulas, delayed so that all are for the same row, and the common delay in rows."""
        ago = max(own for _, own in below)
        return [self._delay(value, ago - own, 0.0) for value, own in below], ago

    def _since(self, first: int, value: Any, none: float) -> Any:
        """Return `value` from row number `first` on, and `none` at earlier rows."""
        return value if first == 0 else jnp.where(self.row >= first, value, none)

    def _slide_one(self, extreme: Any, value: Any, width: int, none: float) -> Any:
        """Return the smallest or largest of the last `width` values. extreme: the function minimum or maximum."""
        return self._slide((value,), width, (none,), lambda a, b: (extreme(a[0], b[0]),))[0]

    def _slide(self, now: tuple[Any, ...], width: int, none: tuple[float, ...], combine: Any) -> tuple[Any, ...]:
        """Return the value for the window of the last `width` rows, from the values `now` for the present row.

        combine: function that returns the value for a window of rows from the values for two shorter windows that
        together cover the window. The result must be correct also if the two shorter windows overlap.
        """
        length = 1
        while length < width:
            back = min(length, width - length)
            older = tuple(self._delay(x, back, n) for x, n in zip(now, none, strict=True))
            now, length = combine(older, now), length + back
        return now

    def _delay(self, x: Any, n: int, none: float) -> Any:
        """Store the value x. Return the value stored n rows ago, or `none` if fewer than n rows have been evaluated."""
        if n == 0:
            return x
        place = self.used + self.row % n
        self._reserve(n, none)
        if self.memory is None:
            return none
        old = lax.dynamic_index_in_dim(self.memory, place, keepdims=False)
        self.memory = lax.dynamic_update_index_in_dim(self.memory, jnp.asarray(x, self.memory.dtype), place, 0)
        return old

    def _accumulate(self, function: Any, x: Any, none: float) -> Any:
        """Return and store function(r, x), where r is the result stored at the previous row."""
        place = self.used
        self._reserve(1, none)
        if self.memory is None:
            return none
        new = function(self.memory[place], x)
        self.memory = lax.dynamic_update_index_in_dim(self.memory, jnp.asarray(new, self.memory.dtype), place, 0)
        return new

    def _reserve(self, n: int, none: float) -> None:
        self.used += n
        self.fills.append(np.full(n, none))


def _join_stretches(older: tuple[Any, Any], newer: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return the pair (value of until, smallest value of its left operand) for the union of two successive windows."""
    return jnp.maximum(older[0], jnp.minimum(older[1], newer[0])), jnp.minimum(older[1], newer[1])


def _swap(function: Any, older: Any, newer: Any) -> Any:
    return function(newer, older)
