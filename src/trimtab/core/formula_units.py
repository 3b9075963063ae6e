"""Check of a formula against the signals of a log: paths must exist and units must match. Numbers are converted to SI.

Numbers that are added, subtracted or compared must have the same unit. A number without a unit takes the unit of the
other operand. The robustness of a formula has the unit of its comparisons, if all comparisons have the same unit.

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
"""Unit of a formula whose comparisons have different units. The formula's robustness combines values in these units."""
_FACTOR = re.compile(r"([A-Za-z%]+)(?:\^(-?[0-9]+))?")
Dimension = tuple[tuple[str, int], ...]
"""A unit as sorted pairs of symbol and power; () for a number without a unit."""


class Formula(NamedTuple):
    """A checked formula. root: tree with numbers in SI. unit: unit of the robustness. paths: paths of the formula's
    signals."""

    text: str
    root: Any
    unit: str
    paths: tuple[str, ...]


def parse_dimension(unit: str) -> Dimension:
    """Return symbols and powers of a declared unit. A unit that cannot be split becomes one symbol."""
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
    """Return the text of a unit, e.g. "m/s^2"; "1" for a number without a unit."""
    above = [s if p == 1 else f"{s}^{p}" for s, p in dimension if p > 0]
    below = [s if p == -1 else f"{s}^{-p}" for s, p in dimension if p < 0]
    return "/".join([" ".join(above) or "1", *below])


def fit_formula(
    text: str, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str], full: Callable[[str], str] = str
) -> Formula:
    """Read a formula, and check it against the given signals.

    Args:
        text: the formula.
        shapes: path -> shape of each signal at one instant.
        units: path -> unit of the signal.
        full: function that returns the full path of a short name.

    Raises:
        InputError: for a syntax error, an unknown signal, or units that do not match. The error names the column and
            the fix.
    """
    fitting = _Fitting(text, shapes, units, full)
    root, found = fitting.fit(parse_formula(text))
    unit = format_dimension(found.pop()) if len(found) == 1 else MIXED
    return Formula(text, root, unit, tuple(dict.fromkeys(fitting.paths)))


class _Fitting:
    """Check of the units in a tree. It finds the units of a formula's comparisons, and the unit of a number."""

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
                refuse_column(
                    self.text, tree.column, "both sides of the comparison are constants", fix="put a signal on one side"
                )
            return tree._replace(left=left, right=right), {dimension}
        assert isinstance(tree, Connective | Temporal)
        below = [self.fit(formula) for formula in tree.formulas]
        return tree._replace(formulas=tuple(t for t, _ in below)), set().union(*(found for _, found in below))

    def fit_pair(self, left: Any, right: Any, column: int, how: str) -> tuple[Any, Any, Dimension]:
        """Return two numbers in the same unit, and the unit. A literal is converted to the unit of the other number."""
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
            units = [format_dimension(d) if d else "no unit" for d in dimensions]
            problem = f"the units differ: {units[0]} and {units[1]} are {how}"
            one = format_dimension(dimensions[0] or dimensions[1])
            fix = f"give both sides the unit {one}, or multiply one side by a number with a unit"
            refuse_column(self.text, column, problem, fix=fix)
        return left, right, dimensions[0]

    def fit_literal(self, literal: Literal, wanted: Dimension) -> tuple[Literal, Dimension]:
        """Return a number converted to a unit, if possible. A number without a unit is taken to be in this unit."""
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
    """Return a unit without the symbols "flag" and "count", which are treated as no unit."""
    return tuple((symbol, power) for symbol, power in dimension if symbol not in ("flag", "count"))


def look_ahead(tree: Any) -> int | None:
    """Return how far a formula looks into the future (100 ns), or None if an interval has no end."""
    if isinstance(tree, Predicate):
        return 0
    assert isinstance(tree, Connective | Temporal)
    below = [look_ahead(formula) for formula in tree.formulas]
    if isinstance(tree, Temporal) and tree.word in ("always", "eventually", "until"):
        below.append(0)
        below = [None if b is None or tree.high is None else b + tree.high for b in below]
    return None if None in below else max(b for b in below if b is not None)


def least_length(tree: Any) -> int:
    """Return the shortest duration (100 ns) of a log that covers all intervals of a formula.

    For an interval without an end, the log must reach the beginning of the interval.
    """
    if isinstance(tree, Predicate):
        return 0
    assert isinstance(tree, Connective | Temporal)
    below = max(least_length(formula) for formula in tree.formulas)
    if isinstance(tree, Temporal) and tree.word in ("always", "eventually", "until"):
        return below + (tree.low if tree.high is None else tree.high)
    return below
