"""A formula held against the signals that there are: every path known, every unit fitting, every number in SI.

What is added, subtracted or compared must be of one unit; a bare number has the unit of what it meets. What the number
of a whole formula is in: the unit of its comparisons, where they all have one.

Source: docs page, Temporal logic.
"""

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from trimtab.core.formula import (
    Arithmetic,
    Connective,
    Literal,
    Predicate,
    SignalPath,
    Temporal,
    parse_formula,
    refuse_column,
)
from trimtab.core.suggestions import closest
from trimtab.core.units import find_sizes

MIXED = "mixed units"
"""Unit of a formula whose comparisons have several units. Its value is the smallest, in SI units."""
_FACTOR = re.compile(r"([A-Za-z%]+)(?:\^(-?[0-9]+))?")
Dimension = tuple[tuple[str, int], ...]
"""Symbols of units with their powers, sorted; () for a plain number."""


class Formula(NamedTuple):
    """A formula that fits its signals. root: its tree, numbers in SI.  unit: of its robustness.  paths: of signals."""

    text: str
    root: Any
    unit: str
    paths: tuple[str, ...]


def parse_dimension(unit: str) -> Dimension:
    """Return symbols and powers of a declared unit; one of an unusual form is a symbol itself."""
    powers: dict[str, int] = {}
    for k, part in enumerate(unit.split("/")):
        for factor in part.split():
            match = _FACTOR.fullmatch(factor)
            if match is None and factor != "1":
                return ((unit, 1),)
            if match is not None:
                powers[match[1]] = powers.get(match[1], 0) + int(match[2] or 1) * (-1 if k else 1)
    return tuple(sorted((symbol, power) for symbol, power in powers.items() if power))


def format_dimension(dimension: Dimension) -> str:
    """As one writes it, e.g. "m/s^2"; "1" for a plain number."""
    above = [s if p == 1 else f"{s}^{p}" for s, p in dimension if p > 0]
    below = [s if p == -1 else f"{s}^{-p}" for s, p in dimension if p < 0]
    return "/".join([" ".join(above) or "1", *below])


def fit_formula(
    text: str, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str], full: Callable[[str], str] = str
) -> Formula:
    """Read a formula of given signals.

    Args:
        text: the formula.
        shapes: path -> shape of each signal at one instant.
        units: path -> its unit.
        full: path of a name that may be a short one.

    Raises:
        InputError: what is no formula, an unknown signal, units that don't fit; with the column, and what to type.
    """
    fitting = _Fitting(text, shapes, units, full)
    root, found = fitting.fit(parse_formula(text))
    unit = format_dimension(found.pop()) if len(found) == 1 else MIXED
    return Formula(text, root, unit, tuple(dict.fromkeys(fitting.paths)))


class _Fitting:
    """One walk over a tree: formulas give the units of their comparisons, numbers their own."""

    def __init__(
        self,
        text: str,
        shapes: Mapping[str, tuple[int, ...]],
        units: Mapping[str, str],
        full: Callable[[str], str],
    ) -> None:
        self.text, self.shapes, self.units, self.full = text, shapes, units, full
        self.paths: list[str] = []

    def fit(self, tree: Any) -> tuple[Any, set[Dimension]]:
        """Return a formula with its numbers in SI, and the units of its comparisons."""
        if isinstance(tree, Predicate):
            count = len(self.paths)
            left, right, dimension = self.fit_pair(tree.left, tree.right, tree.column, f"compared by {tree.relation}")
            if len(self.paths) == count:
                refuse_column(self.text, tree.column, "two constants are compared", fix="name a signal on one side")
            return tree._replace(left=left, right=right), {dimension}
        assert isinstance(tree, Connective | Temporal)
        below = [self.fit(formula) for formula in tree.formulas]
        return tree._replace(formulas=tuple(t for t, _ in below)), set().union(*(found for _, found in below))

    def fit_pair(self, left: Any, right: Any, column: int, how: str) -> tuple[Any, Any, Dimension]:
        """Two numbers that must be of one unit; one that stands alone may be of several, and takes the other's."""
        literals = [isinstance(number, Literal) for number in (left, right)]
        if literals[0] and not literals[1]:
            (right, wanted), left_unit = self.fit_number(right), None
            left, left_unit = self.fit_literal(left, wanted)
            dimensions = (left_unit, wanted)
        else:
            left, wanted = self.fit_number(left)
            right, unit = self.fit_literal(right, wanted) if literals[1] else self.fit_number(right)
            dimensions = (wanted, unit)
        if dimensions[0] != dimensions[1]:
            units = [format_dimension(d) for d in dimensions]
            problem = f"{units[0]} and {units[1]} are {how}"
            refuse_column(self.text, column, problem, fix=f"give both the unit {units[0]}, or multiply one by a unit")
        return left, right, dimensions[0]

    def fit_literal(self, literal: Literal, wanted: Dimension) -> tuple[Literal, Dimension]:
        """Return a number that meets one of a unit: in that unit, where it can be; a bare one is in it."""
        if not literal.unit:
            return literal, wanted
        sizes = {parse_dimension(kept): size for kept, size in find_sizes(literal.unit).items()}
        kept = wanted if wanted in sizes else next(iter(sizes))
        return literal._replace(value=literal.value * sizes[kept], unit=""), _plain(kept)

    def fit_number(self, tree: Any) -> tuple[Any, Dimension]:
        """Return a number in SI, and its unit."""
        if isinstance(tree, Literal):
            return self.fit_literal(tree, ())
        if isinstance(tree, SignalPath):
            return self.fit_signal(tree)
        assert isinstance(tree, Arithmetic)
        if len(tree.numbers) == 1:
            inside, dimension = self.fit_number(tree.numbers[0])
            return tree._replace(numbers=(inside,)), dimension
        if tree.operator in ("+", "-"):
            how = "added" if tree.operator == "+" else "subtracted"
            left, right, dimension = self.fit_pair(tree.numbers[0], tree.numbers[1], tree.column, how)
            return tree._replace(numbers=(left, right)), dimension
        (left, one), (right, other) = (self.fit_number(number) for number in tree.numbers)
        powers = dict(one)
        for symbol, power in other:
            powers[symbol] = powers.get(symbol, 0) + (power if tree.operator == "*" else -power)
        dimension = tuple(sorted((symbol, power) for symbol, power in powers.items() if power))
        return tree._replace(numbers=(left, right)), dimension

    def fit_signal(self, tree: SignalPath) -> tuple[SignalPath, Dimension]:
        path = self.full(tree.path)
        if path not in self.shapes:
            below = [p for p in self.shapes if p.startswith(f"{path}.")]
            near = below[:6] or closest(path, self.shapes, 4) or list(self.shapes)[:6]
            problem = f"there is no signal {tree.path!r}"
            refuse_column(self.text, tree.column, problem, choices=near, fix=f"write {near[0]}")
        shape = self.shapes[path]
        wanted = shape[0] if len(shape) == 1 else None
        if len(shape) > 1 or not (wanted is None if tree.component is None else tree.component < (wanted or 0)):
            problem = f"{tree.path!r} has {shape[0] if shape else 'no'} components"
            fix = f"write {tree.path}[0]" if len(shape) == 1 else f"write {tree.path}"
            refuse_column(self.text, tree.column, problem, fix=fix)
        self.paths.append(path)
        return tree._replace(path=path), _plain(parse_dimension(self.units.get(path, "") or "1"))


def _plain(dimension: Dimension) -> Dimension:
    """Return the same, where flags and counts are plain numbers."""
    return tuple((symbol, power) for symbol, power in dimension if symbol not in ("flag", "count"))


def look_ahead(tree: Any) -> int | None:
    """Return how far a formula looks into the future (100 ns), or None if without end."""
    if isinstance(tree, Predicate):
        return 0
    assert isinstance(tree, Connective | Temporal)
    below = [look_ahead(formula) for formula in tree.formulas]
    if isinstance(tree, Temporal) and tree.word in ("always", "eventually", "until"):
        below.append(0)
        below = [None if b is None or tree.high is None else b + tree.high for b in below]
    return None if None in below else max(b for b in below if b is not None)


def least_length(tree: Any) -> int:
    """Return the shortest length of a log that covers all intervals of a formula.

    100 ns; an interval without an end has to begin in it.
    """
    if isinstance(tree, Predicate):
        return 0
    assert isinstance(tree, Connective | Temporal)
    below = max(least_length(formula) for formula in tree.formulas)
    if isinstance(tree, Temporal) and tree.word in ("always", "eventually", "until"):
        return below + (tree.low if tree.high is None else tree.high)
    return below
