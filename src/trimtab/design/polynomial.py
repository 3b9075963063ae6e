"""Polynomials with exact coefficients, on which the code of a control law can run.

The code of a law or a vehicle that only adds, multiplies, and divides by single terms can run on polynomials instead of
numbers. The result is the polynomial that the code computes, so that a proof about the polynomial is a proof about the
code. Names that are never zero may have negative powers, e.g. k1/m u. A float is converted to the decimal number in
which it is written: 2.6 is 13/5.

Source: this module.
"""

import ast
from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from trimtab.core.errors import InputError

Monomial = tuple[tuple[str, int], ...]
"""Product of powers: pairs (name, power), sorted by name, without power 0."""
LONGEST_TEXT = 4000
"""Maximum length of a text that is read as a polynomial, in characters."""
HIGHEST_POWER, MOST_TERMS = 12, 20
"""Maximum power in a text, and maximum number of terms with powers above 2, to limit the time of expansion."""


class Polynomial:
    """Polynomial: a sum of terms, each a Fraction times powers of names. Polynomials are immutable and compared by
    value.

    terms: monomial -> coefficient, without zero coefficients.
    """

    __slots__ = ("terms",)
    __array_ufunc__ = None  # so that NumPy's numbers use this class's operators

    def __init__(self, terms: Mapping[Monomial, Fraction]) -> None:
        self.terms = {m: c for m, c in terms.items() if c != 0}

    def __add__(self, other: Any) -> "Polynomial":
        terms = dict(self.terms)
        for m, c in as_polynomial(other).terms.items():
            terms[m] = terms.get(m, Fraction(0)) + c
        return Polynomial(terms)

    def __neg__(self) -> "Polynomial":
        return Polynomial({m: -c for m, c in self.terms.items()})

    def __sub__(self, other: Any) -> "Polynomial":
        return self + -as_polynomial(other)

    def __rsub__(self, other: Any) -> "Polynomial":
        return as_polynomial(other) - self

    def __mul__(self, other: Any) -> "Polynomial":
        terms: dict[Monomial, Fraction] = {}
        for n, b in as_polynomial(other).terms.items():
            for m, a in self.terms.items():
                product = multiply_monomials(m, n)
                terms[product] = terms.get(product, Fraction(0)) + a * b
        return Polynomial(terms)

    def __truediv__(self, other: Any) -> "Polynomial":
        return self * as_polynomial(other).reciprocal()

    def __rtruediv__(self, other: Any) -> "Polynomial":
        return as_polynomial(other) / self

    def __pow__(self, power: Any) -> "Polynomial":
        if isinstance(power, bool) or power != int(power):
            raise ArithmeticError(f"the power of a polynomial must be a whole number, got {power!r}")
        base, product = self if power >= 0 else self.reciprocal(), constant(1)
        for _ in range(abs(int(power))):
            product = product * base
        return product

    __radd__ = __add__
    __rmul__ = __mul__

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Polynomial) and self.terms == other.terms

    def __hash__(self) -> int:
        return hash(frozenset(self.terms.items()))

    def __bool__(self) -> bool:
        """Return True if the polynomial is not zero."""
        return bool(self.terms)

    def __repr__(self) -> str:
        return format_polynomial(self)

    @property
    def names(self) -> frozenset[str]:
        """Return all names that occur in the polynomial."""
        return frozenset(name for m in self.terms for name, _ in m)

    def reciprocal(self) -> "Polynomial":
        """Return 1/p; raise ArithmeticError if the polynomial p does not consist of a single term."""
        if len(self.terms) != 1:
            raise ArithmeticError(f"1/({self}) is not a polynomial; only a single term can be a divisor")
        ((m, c),) = self.terms.items()
        return Polynomial({tuple((name, -power) for name, power in m): 1 / c})

    def derivative(self, name: str) -> "Polynomial":
        """Return the partial derivative with respect to the variable `name`."""
        terms: dict[Monomial, Fraction] = {}
        for m, c in self.terms.items():
            power = dict(m).get(name, 0)
            if power:
                lower = multiply_monomials(m, ((name, -1),))
                terms[lower] = terms.get(lower, Fraction(0)) + c * power
        return Polynomial(terms)

    def substitute(self, values: Mapping[str, "Polynomial"]) -> "Polynomial":
        """Return the polynomial with names replaced by polynomials, all at the same time."""
        total = constant(0)
        for m, c in self.terms.items():
            kept = tuple((name, power) for name, power in m if name not in values)
            product = Polynomial({kept: c})
            for name, power in m:
                if name in values:
                    product = product * values[name] ** power
            total = total + product
        return total

    def collect(self, names: Iterable[str]) -> dict[Monomial, "Polynomial"]:
        """Return the coefficient of each monomial in the given names, as a polynomial in the other names."""
        chosen, parts = frozenset(names), {}
        for m, c in self.terms.items():
            inner = tuple(p for p in m if p[0] in chosen)
            outer = tuple(p for p in m if p[0] not in chosen)
            parts.setdefault(inner, {})[outer] = c
        return {inner: Polynomial(terms) for inner, terms in parts.items()}

    def sign(self, positive: Iterable[str]) -> int:
        """Return the common sign of all coefficients, 1 or -1, if all names are positive; otherwise 0 (undecided)."""
        signs = {1 if c > 0 else -1 for c in self.terms.values()}
        return signs.pop() if len(signs) == 1 and self.names <= frozenset(positive) else 0


def constant(value: Any) -> Polynomial:
    """Convert a number to a constant polynomial: integers and Fractions exactly, floats as the decimal number Python
    prints."""
    if isinstance(value, Fraction):
        return Polynomial({(): value})
    number = np.asarray(value).item()
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ArithmeticError(f"must be a number, got {value!r}")
    return Polynomial({(): Fraction(number) if isinstance(number, int) else Fraction(repr(number))})


def symbol(name: str) -> Polynomial:
    """Return the polynomial that consists of one name."""
    return Polynomial({((name, 1),): Fraction(1)})


def as_polynomial(value: Any) -> Polynomial:
    """Return a polynomial unchanged; convert a number to a constant polynomial."""
    return value if isinstance(value, Polynomial) else constant(value)


def lie_derivative_of(p: Polynomial, field: Mapping[str, Polynomial]) -> Polynomial:
    """Return dp/dt along x' = field(x). Names without a derivative in the field are constant."""
    return sum((p.derivative(name) * rate for name, rate in field.items()), constant(0))


def format_polynomial(p: Polynomial) -> str:
    """Format a polynomial as text for `parse_polynomial`, e.g. "u^2 - 2*k1*r/d"."""
    text = ""
    for m, c in sorted(p.terms.items(), key=_place_of_term):
        above = [f"{name}^{power}" if power != 1 else name for name, power in m if power > 0]
        below = [f"/{name}^{-power}" if power != -1 else f"/{name}" for name, power in m if power < 0]
        size = [str(abs(c))] if abs(c) != 1 or not above else []
        sign = (" - " if c < 0 else " + ") if text else ("-" if c < 0 else "")
        text += sign + "*".join(size + above) + "".join(below)
    return text or "0"


def _place_of_term(term: tuple[Monomial, Fraction]) -> Any:
    """Return a sort key for printing: terms without negative powers first, high powers before low ones."""
    m, _ = term
    return any(power < 0 for _, power in m), -sum(abs(power) for _, power in m), m


def parse_polynomial(text: Any, part: str, names: Iterable[str]) -> Polynomial:
    """Parse a polynomial from text with + - * / ^ and parentheses.

    Args:
        text: e.g. "k2*(v - d*r)^2".
        part: name of the input, for error messages.
        names: allowed names.

    Raises: InputError for any other text. The text is never executed as code.
    """
    names = tuple(names)
    fix = "write e.g. k2*(v - d*r)^2"
    if not isinstance(text, str) or len(text) > LONGEST_TEXT:
        raise InputError(part, f"{str(text)[:60]!r} is not a polynomial", choices=names, fix=fix)
    try:
        return _evaluate(ast.parse(text.strip().replace("^", "**"), mode="eval").body, names)
    except (SyntaxError, ValueError, ArithmeticError, RecursionError, MemoryError) as error:
        raise InputError(part, f"{text[:60]!r} is not a polynomial: {error}", choices=names, fix=fix) from None


def _evaluate(node: ast.expr, names: tuple[str, ...]) -> Polynomial:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return constant(value)
        case ast.Name(id=name) if name in names:
            return symbol(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand, names)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            power = _evaluate(right, names).terms.get((), Fraction(0))
            base = _evaluate(left, names)
            if abs(power) > HIGHEST_POWER or (abs(power) > 2 and len(base.terms) > MOST_TERMS):
                raise ArithmeticError(f"power {power} of {len(base.terms)} terms is too large")
            return base**power
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=right):
            a, b = _evaluate(left, names), _evaluate(right, names)
            if isinstance(op, ast.Add | ast.Sub):
                return a + b if isinstance(op, ast.Add) else a - b
            return a * b if isinstance(op, ast.Mult) else a / b
        case _:
            raise ArithmeticError(f"{ast.unparse(node)!r} is not allowed in a polynomial")


def multiply_monomials(a: Monomial, b: Monomial) -> Monomial:
    """Return the product of two monomials."""
    powers = dict(a)
    for name, power in b:
        powers[name] = powers.get(name, 0) + power
    return tuple(sorted((name, power) for name, power in powers.items() if power))
