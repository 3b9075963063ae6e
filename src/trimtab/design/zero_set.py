"""Common zeros of polynomials, and the largest invariant set within them (LaSalle).

Equations are solved by elimination if possible, and every step is recorded in words. If elimination fails, an
ArithmeticError is raised. Names declared positive are never zero.

Source: [1] J. P. LaSalle, "Some extensions of Liapunov's second method", IRE Trans. Circuit Theory 7 (1960), theorem 3.
Motions of a polynomial field are analytic. Therefore a motion that stays in a union of algebraic sets stays in one of
these sets, and the branches can be treated one by one.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from trimtab.design.polynomial import Monomial, Polynomial, constant, lie_derivative_of, symbol

MOST_ROUNDS = 12
"""Maximum number of derivatives in the search for an invariant set."""


class ZeroBranch(NamedTuple):
    """Branch of a set of common zeros, on which some unknowns are free and all others are functions of the free
    unknowns.

    values: unknown -> polynomial in the free unknowns and the positive names. free: the free unknowns.  steps: steps of
    the solution, in words.
    """

    values: dict[str, Polynomial]
    free: tuple[str, ...]
    steps: tuple[str, ...] = ()

    @property
    def dimension(self) -> int:
        """Return the dimension of the branch: 0 for a point, 1 for a line or curve."""
        return len(self.free)

    def __str__(self) -> str:
        return ", ".join(f"{name} = {value}" for name, value in sorted(self.values.items())) or "everything"


def solve_equations(
    equations: Iterable[Polynomial], unknowns: Sequence[str], positive: Iterable[str]
) -> tuple[ZeroBranch, ...]:
    """Return all common zeros of polynomials, as branches; raise ArithmeticError if elimination can't find them.

    Args:
        equations: polynomials that must be zero.
        unknowns: names that may have any real value.
        positive: names whose values are above 0.
    """
    branches = _solve(tuple(equations), ZeroBranch({}, tuple(unknowns)), frozenset(positive))
    return tuple({str(b): b for b in branches}.values())


def largest_invariant_set(
    field: Mapping[str, Polynomial], equations: Iterable[Polynomial], positive: Iterable[str]
) -> tuple[ZeroBranch, ...]:
    """Return the largest invariant set of x' = field(x) within the common zeros of the equations, by [1].

    If an expression stays zero, its derivatives are zero too. The constraints of each branch are differentiated along
    the field, and the results are added to the equations, until no new equation appears.
    """
    positive, pending, whole = frozenset(positive), list(solve_equations(equations, tuple(field), positive)), []
    for _ in range(MOST_ROUNDS):
        moving: list[ZeroBranch] = []
        for branch in pending:
            rates = _leaving_rates(branch, field)
            if not rates:
                whole.append(branch)
            for rate, why in rates[:1]:
                moving += _solve((rate,), branch._replace(steps=(*branch.steps, why)), positive)
        if not moving:
            return _drop_contained(whole)
        pending = list({str(b): b for b in moving}.values())
    raise ArithmeticError(f"no invariant set was found within {MOST_ROUNDS} derivatives")


def _leaving_rates(branch: ZeroBranch, field: Mapping[str, Polynomial]) -> list[tuple[Polynomial, str]]:
    """Return the polynomials that must be zero for a motion to stay on a branch, each with the reason in words."""
    rates = []
    for name, value in branch.values.items():
        constraint = symbol(name) - value
        rate = lie_derivative_of(constraint, field).substitute(branch.values)
        if rate:
            rates.append((rate, f"d({constraint})/dt is {rate} on this branch"))
    return rates


def _drop_contained(branches: Sequence[ZeroBranch]) -> tuple[ZeroBranch, ...]:
    """Return the branches that do not lie within another branch."""
    kept = []
    for i, b in enumerate(branches):
        others = [o for j, o in enumerate(branches) if j != i and (o.dimension > b.dimension or j < i)]
        inside = [all(not (symbol(n) - v).substitute(b.values) for n, v in other.values.items()) for other in others]
        if not any(inside):
            kept.append(b)
    return tuple(kept)


def _solve(equations: tuple[Polynomial, ...], branch: ZeroBranch, positive: frozenset[str]) -> list[ZeroBranch]:
    rest = [e for e in (e.substitute(branch.values) for e in equations) if e]
    if not rest:
        return [branch]
    for e in rest:
        if not e.names & frozenset(branch.free):
            if e.sign(positive):
                return []
            raise ArithmeticError(f"the values of the parameters decide if {e} is zero")
    undecided = ""
    for e in sorted(rest, key=lambda e: len(e.terms)):
        for name, value in _linear_pivots(e, branch.free, positive):
            try:
                return _solve(tuple(rest), _put(branch, name, value), positive)
            except ArithmeticError as error:  # another order of elimination may succeed
                undecided = str(error)
    if undecided:
        raise ArithmeticError(undecided)
    for e in rest:
        others = tuple(o for o in rest if o is not e)
        alternatives = _split(e, branch.free, positive)
        if alternatives is not None:
            return [b for extra in alternatives for b in _solve((*others, *extra), branch, positive)]
    raise ArithmeticError(f"elimination cannot find the zeros of {rest[0]}")


def _put(branch: ZeroBranch, name: str, value: Polynomial) -> ZeroBranch:
    values = {n: v.substitute({name: value}) for n, v in branch.values.items()} | {name: value}
    free = tuple(n for n in branch.free if n != name)
    return ZeroBranch(values, free, (*branch.steps, f"{name} = {value}"))


def _linear_pivots(e: Polynomial, free: Sequence[str], positive: frozenset[str]) -> Iterator[tuple[str, Polynomial]]:
    """Yield the unknowns that an equation determines, with their values.

    Such an unknown occurs in one term only, linearly, with a coefficient that is never zero.
    """
    for name in reversed(free):
        parts = e.collect((name,))
        slope = parts.get(((name, 1),))
        if slope is not None and set(parts) <= {(), ((name, 1),)} and len(slope.terms) == 1 and slope.names <= positive:
            yield name, -parts.get((), constant(0)) / slope


def _split(e: Polynomial, free: Sequence[str], positive: frozenset[str]) -> list[tuple[Polynomial, ...]] | None:
    """Split an equation into alternatives, each a set of simpler equations; None if it can't be split."""
    powers = [dict(m) for m in e.collect(free)]
    common = {n: min(p.get(n, 0) for p in powers) for n in free}
    content = {n: k for n, k in common.items() if k > 0}
    if content:
        cofactor = e
        for n, k in content.items():
            cofactor = cofactor / symbol(n) ** k
        roots: list[tuple[Polynomial, ...]] = [(symbol(n),) for n in content]
        return roots + ([(cofactor,)] if cofactor.names & frozenset(free) else [])
    coefficients = e.collect(free)
    signs = {c.sign(positive) for c in coefficients.values()}
    even = all(k % 2 == 0 for m in coefficients for _, k in m)
    if even and len(signs) == 1 and signs != {0}:  # no term can be negative, so each term is zero
        if () in coefficients:
            return []
        return [tuple(Polynomial({m: Fraction(1)}) for m in coefficients)]
    roots_of_terms = [_square_root(m, abs(c)) for m, c in e.terms.items()]
    if len(e.terms) == 2 and sum(1 if c > 0 else -1 for c in e.terms.values()) == 0 and None not in roots_of_terms:
        p, q = (root for root in roots_of_terms if root is not None)
        return [(p - q,), (p + q,)]
    return None


def _square_root(m: Monomial, c: Fraction) -> Polynomial | None:
    """Return the square root of a positive term; None if the root is not a term."""
    root = Fraction(math.isqrt(c.numerator), math.isqrt(c.denominator))
    if root * root != c or any(power % 2 for _, power in m):
        return None
    return Polynomial({tuple((name, power // 2) for name, power in m): root})
