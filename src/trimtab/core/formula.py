"""Formulas of signal temporal logic: their syntax, and the parser that turns the text of a formula into a tree.

    FORMULA    always(F)  eventually(F)  F until F     from now on; with [5 s, 15 s] 5 to 15 s from now
               historically(F)  once(F)  F since F     the same for the past
               not F   F and F   F or F   F implies F   (F)
               NUMBER <= NUMBER                         also <, >=, >, == and !=
    NUMBER     a signal by its path, with [0] a component of it; 3, or with a unit 3 deg/s; + - * / abs( ) ( )

Operators from the loosest to the tightest: implies; or; and; until, since; not, always and the like; comparisons; + and
-; * and /. Times without a unit are in seconds, and numbers in SI units and radians.

Source: Maler, Nickovic, "Monitoring temporal properties of continuous signals", FORMATS 2004; docs page, Temporal
logic.
"""

import math
import re
from decimal import Decimal
from typing import Any, NamedTuple, NoReturn

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.core.time import UNITS_PER_SECOND
from trimtab.core.units import UNITS, find_sizes

FUTURE, PAST = ("always", "eventually"), ("historically", "once")
TEMPORAL = (*FUTURE, *PAST, "until", "since")
WORDS = (*TEMPORAL, "not", "and", "or", "implies", "abs", "inf")
RELATIONS = ("<=", ">=", "==", "!=", "<", ">")
EXAMPLE = "always[5 s, 15 s](abs(truth.yaw_rate - 3 rad/s) < 0.15 rad/s)"
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|(?P<name>[A-Za-z_]\w*(?:\.\w+)*)"
    r"|(?P<sign><=|>=|==|!=|[-+*/()\[\],<>]))"
)
_UNIT = re.compile(r"\s*([%°A-Za-zµμ][A-Za-z0-9/^²*µμ°]*)")


class Literal(NamedTuple):
    """A number as written. unit: "" if no unit is written. column: position in the text, counted from 1."""

    value: float
    unit: str
    column: int


class SignalPath(NamedTuple):
    """A signal in a formula. component: index of the used component of a vector; None for a scalar signal."""

    path: str
    component: int | None
    column: int


class Arithmetic(NamedTuple):
    """Arithmetic operation. operator: + - * / for two numbers, "abs" or "negative" for one."""

    operator: str
    numbers: tuple[Any, ...]
    column: int


class Predicate(NamedTuple):
    """A comparison of two numbers."""

    left: Any
    relation: str
    right: Any
    column: int


class Connective(NamedTuple):
    """Logical connective. word: not, and, or, implies."""

    word: str
    formulas: tuple[Any, ...]
    column: int


class Temporal(NamedTuple):
    """Temporal operator. word: one of TEMPORAL. low, high: interval (100 ns); high is None if the interval has no end.
    formulas: operands."""

    word: str
    low: int
    high: int | None
    formulas: tuple[Any, ...]
    column: int


def parse_formula(text: str) -> Any:
    """Return the tree of a formula.

    Raises:
        InputError: if the syntax is wrong. The error names the column and the fix.
    """
    reader = _Reader(text)
    tree = reader.read_implication()
    reader.refuse_rest()
    return reader.check_formula(tree)


def is_temporal(text: str) -> bool:
    """Return True if a text contains a word that only occurs in formulas."""
    return re.search(rf"(?<![\w.:])({'|'.join(TEMPORAL)})(?![\w.:])", text) is not None


def refuse_column(text: str, column: int, problem: str, *, choices: Any = (), fix: str = "") -> NoReturn:
    """Raise InputError for a problem at the given column of a formula."""
    raise InputError(f"formula {text!r}", f"at column {column}: {problem}", choices=choices, fix=fix or EXAMPLE)


class Token(NamedTuple):
    """Token: a part of the text of a formula. kind: number, name, sign or end."""

    kind: str
    text: str
    column: int


class _Reader:
    """Parser of a formula. It reads from left to right, with one token of lookahead."""

    def __init__(self, text: str) -> None:
        self.text, self.position = text, 0
        self.next = self._scan()

    def _scan(self) -> Token:
        match = _TOKEN.match(self.text, self.position)
        if match is None:
            rest = self.text[self.position :].lstrip()
            column = len(self.text) - len(rest) + 1
            if rest:
                fix = f"write words for operators: and, or, not, implies; e.g. {EXAMPLE}"
                refuse_column(self.text, column, f"{rest[0]!r} is not allowed in a formula", fix=fix)
            return Token("end", "", column)
        self.position = match.end()
        kind = str(match.lastgroup)
        return Token(kind, match[kind], match.start(kind) + 1)

    def advance(self) -> Token:
        token, self.next = self.next, self._scan()
        return token

    def take(self, *texts: str) -> Token | None:
        """Return the next token and move on, if its text is one of `texts`; else return None."""
        return self.advance() if self.next.text in texts and self.next.kind != "number" else None

    def expect(self, text: str, after: str) -> Token:
        found = self.take(text)
        if found is None:
            said = repr(self.next.text) if self.next.text else "the end"
            fix = f"write {text!r} there; e.g. {EXAMPLE}"
            refuse_column(self.text, self.next.column, f"expected {text!r} {after}, got {said}", fix=fix)
        return found

    def refuse_rest(self) -> None:
        token = self.next
        if token.text in RELATIONS:
            problem = f"{token.text!r} cannot follow a comparison"
            refuse_column(self.text, token.column, problem, fix="write 0 m < x and x < 3 m")
        if token.kind != "end":
            problem = f"{token.text!r} cannot follow a complete formula"
            near = closest(token.text, WORDS, 1)
            fix = f"write {near[0]!r}" if near else "join formulas with and, or, implies, until; e.g. F and G"
            refuse_column(self.text, token.column, problem, fix=fix)

    def check_formula(self, tree: Any) -> Any:
        """Return the tree if it is a formula. Raise InputError if it is a number."""
        if not isinstance(tree, Predicate | Connective | Temporal):
            problem = "this is a number, but a formula needs a comparison"
            refuse_column(self.text, tree.column, problem, choices=RELATIONS, fix=f"write e.g. {EXAMPLE}")
        return tree

    def check_number(self, tree: Any) -> Any:
        """Return the tree if it is a number. Raise InputError if it is a formula."""
        if isinstance(tree, Predicate | Connective | Temporal):
            problem = "this is a formula, but a number is needed"
            refuse_column(
                self.text, tree.column, problem, fix="write x > 0 and y > 0 for two conditions, x + y for a sum"
            )
        return tree

    def read_implication(self) -> Any:
        left = self.read_joined("or", self.read_conjunction)
        if (token := self.take("implies")) is None:
            return left
        right = self.check_formula(self.read_implication())
        return Connective("implies", (self.check_formula(left), right), token.column)

    def read_conjunction(self) -> Any:
        return self.read_joined("and", self.read_until)

    def read_joined(self, word: str, read: Any) -> Any:
        tree = read()
        while (token := self.take(word)) is not None:
            tree = Connective(word, (self.check_formula(tree), self.check_formula(read())), token.column)
        return tree

    def read_until(self) -> Any:
        left = self.read_prefix()
        if (token := self.take("until", "since")) is None:
            return left
        low, high = self.read_interval()
        both = self.check_formula(left), self.check_formula(self.read_prefix())
        if self.next.text in ("until", "since"):
            fix = "write (F until G) until H"
            refuse_column(self.text, self.next.column, "until or since twice in a row needs brackets", fix=fix)
        return Temporal(token.text, low, high, both, token.column)

    def read_prefix(self) -> Any:
        if (token := self.take("not")) is not None:
            return Connective("not", (self.check_formula(self.read_prefix()),), token.column)
        if (token := self.take(*FUTURE, *PAST)) is not None:
            low, high = self.read_interval()
            return Temporal(token.text, low, high, (self.check_formula(self.read_prefix()),), token.column)
        return self.read_comparison()

    def read_comparison(self) -> Any:
        left = self.read_sum()
        if (token := self.take(*RELATIONS)) is None:
            return left
        return Predicate(self.check_number(left), token.text, self.check_number(self.read_sum()), token.column)

    def read_sum(self) -> Any:
        return self.read_series(("+", "-"), self.read_product)

    def read_product(self) -> Any:
        return self.read_series(("*", "/"), self.read_factor)

    def read_series(self, operators: tuple[str, ...], read: Any) -> Any:
        tree = read()
        while (token := self.take(*operators)) is not None:
            tree = _compute(token, self.check_number(tree), self.check_number(read()))
        return tree

    def read_factor(self) -> Any:
        if (token := self.take("-")) is not None:
            inside = self.check_number(self.read_factor())
            if isinstance(inside, Literal):
                return Literal(-inside.value, inside.unit, token.column)
            return Arithmetic("negative", (inside,), token.column)
        if (token := self.take("abs")) is not None:
            self.expect("(", "after abs")
            inside = self.check_number(self.read_implication())
            self.expect(")", "after the argument of abs")
            return Arithmetic("abs", (inside,), token.column)
        if self.take("(") is not None:
            inside = self.read_implication()
            self.expect(")", "that closes '('")
            return inside
        if self.next.kind == "number":
            return self.read_literal()
        return self.read_signal()

    def read_literal(self) -> Literal:
        """Return a number, with its unit if one follows directly."""
        number = self.next
        unit = self._read_unit()
        self.next = self._scan()
        return Literal(float(number.text), unit, number.column)

    def _read_unit(self) -> str:
        match = _UNIT.match(self.text, self.position)
        if match is None or re.split(r"\W", match[1])[0] in WORDS:
            return ""
        written = match[1]
        ends = [len(written), *(m.start() for m in reversed(list(re.finditer(r"[/^*]", written))))]
        for end in ends:
            if find_sizes(written[:end]):
                self.position = match.start(1) + end
                return written[:end]
        known = dict.fromkeys(name for sizes in UNITS.values() for name in sizes)
        near = closest(written, [*known, *WORDS], 4)
        fix = "write a unit, or an operator between the two: 3 * x"
        if near:
            word = next((name for name in near if name in WORDS), None)
            fix = f"write {word!r}" if word else f"write 3 {near[0]}"
        refuse_column(self.text, match.start(1) + 1, f"unknown unit {written!r}", choices=near, fix=fix)

    def read_signal(self) -> SignalPath:
        token = self.next
        if token.kind != "name" or token.text in WORDS:
            said = repr(token.text) if token.text else "the end"
            refuse_column(self.text, token.column, f"expected a signal, a number or '(', got {said}")
        self.advance()
        if self.next.text == "(":
            near = closest(token.text, WORDS, 1)
            fix = f"write {near[0]}(…)" if near else ""
            refuse_column(self.text, token.column, f"unknown function {token.text!r}", choices=WORDS, fix=fix)
        if self.take("[") is None:
            return SignalPath(token.text, None, token.column)
        index = self.advance()
        if index.kind != "number" or not index.text.isdecimal():
            fix = f"write {token.text}[0]; an interval of time is written after always, eventually, until, …"
            refuse_column(self.text, index.column, f"{index.text!r} is not an index of a component", fix=fix)
        self.expect("]", "after the index of the component")
        return SignalPath(token.text, int(index.text), token.column)

    def read_interval(self) -> tuple[int, int | None]:
        """Return the ends of an interval [a, b] (100 ns), or 0 and None if no interval is written."""
        opening = self.take("[")
        if opening is None:
            return 0, None
        low = self._read_time()
        self.expect(",", "between the ends of an interval")
        high = None if self.take("inf") else self._read_time()
        self.expect("]", "after an interval")
        if high is not None and high < low:
            refuse_column(
                self.text, opening.column, "the interval must begin before it ends", fix="exchange the two times"
            )
        return low, high

    def _read_time(self) -> int:
        if self.next.kind != "number":
            fix = "write e.g. [5 s, 15 s], [0, 200 ms], or [5 s, inf] for no end"
            refuse_column(self.text, self.next.column, f"{self.next.text!r} is not a time of at least 0", fix=fix)
        token = self.next
        literal = self.read_literal()
        size = find_sizes(literal.unit).get("s") if literal.unit else 1.0
        if size is None:
            problem = f"{literal.unit!r} is not a unit of time"
            refuse_column(self.text, token.column, problem, choices=UNITS["s"], fix="write e.g. [5 s, 15 s]")
        ticks = Decimal(token.text) * Decimal(str(size)) * UNITS_PER_SECOND
        if ticks != ticks.to_integral_value() or not math.isfinite(ticks):
            problem = "the time must be a whole number of 100 ns"
            refuse_column(self.text, token.column, problem, fix="round it to 100 ns, e.g. 6.5536 ms")
        return int(ticks)


def _compute(operator: Token, one: Any, other: Any) -> Any:
    """Return the tree of an operation on two numbers, or its result if both are literals without a unit."""
    bare = isinstance(one, Literal) and isinstance(other, Literal) and not (one.unit or other.unit)
    if not bare or (operator.text == "/" and other.value == 0):
        return Arithmetic(operator.text, (one, other), operator.column)
    values = {"+": one.value + other.value, "-": one.value - other.value, "*": one.value * other.value}
    return Literal(values[operator.text] if operator.text in values else one.value / other.value, "", one.column)
