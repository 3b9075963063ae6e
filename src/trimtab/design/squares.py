"""Why a polynomial is nowhere negative: as a sum of squares, checked exactly, without a solver.

    scale * conclusion = sum of weight * form^2 [* hypothesis]  +  sum of z'G z [* hypothesis]

Weights and scale are positive, for all positive values of the names in them, as all their coefficients are; each G is
positive definite, proved without rounding. So the conclusion is not negative wherever every hypothesis is positive.
A file may claim any such sum: whether the two sides are the same polynomial is computed here.

Source: [1] P. A. Parrilo, "Semidefinite programming relaxations for semialgebraic problems", Math. Programming 96
(2003); definiteness as in `exact`.
"""

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any, NamedTuple

from trimtab.design import exact
from trimtab.design.polynomial import Polynomial, constant, symbol
from trimtab.design.zero_set import ZeroBranch, solve_equations

DEFINITE, NONNEGATIVE, POSITIVE = "zero at rest only", "not negative", "positive"
"""What a claim says of its conclusion."""
SHOWN = 90
"""Characters of a polynomial that a message shows."""


class WeightedSquares(NamedTuple):
    """The sum of weight form^2, times a hypothesis where `times` names one.

    times: name of a hypothesis, or "".  weights, forms: polynomials, as many of each.
    """

    times: str
    weights: tuple[Polynomial, ...]
    forms: tuple[Polynomial, ...]

    def value(self) -> Polynomial:
        """The sum, without the hypothesis."""
        return sum((w * f * f for w, f in zip(self.weights, self.forms, strict=True)), constant(0))


class GramForm(NamedTuple):
    """z'G z, times a hypothesis where `times` names one.

    times: name of a hypothesis, or "".  forms: z, k polynomials.  matrix: G, Fractions (k, k).
    """

    times: str
    forms: tuple[Polynomial, ...]
    matrix: Any

    def value(self) -> Polynomial:
        """The form, without the hypothesis."""
        z, total = self.forms, constant(0)
        for i, row in enumerate(self.matrix):
            total = total + z[i] * sum((constant(c) * b for c, b in zip(row, z, strict=True)), constant(0))
        return total


Term = WeightedSquares | GramForm


class SquaresProof(NamedTuple):
    """scale: polynomial that the conclusion is multiplied by.  terms: what that is the sum of."""

    scale: Polynomial
    terms: tuple[Term, ...]


class Claim(NamedTuple):
    """What is to be proved, all of it from code.

    name: of the claim.  conclusion: the polynomial.  hypotheses: name -> polynomial that is positive, where the
    conclusion is asserted.  says: DEFINITE, NONNEGATIVE or POSITIVE.
    """

    name: str
    conclusion: Polynomial
    hypotheses: Mapping[str, Polynomial]
    says: str


class Region(NamedTuple):
    """Where polynomials live: which names are states, which are positive, and where the loop rests.

    states, positive: names.  rest: state -> polynomial in the positive names.
    """

    states: tuple[str, ...]
    positive: tuple[str, ...]
    rest: Mapping[str, Polynomial]


def find_fault(claim: Claim, proof: SquaresProof, region: Region) -> str:
    """What is wrong with a proof of a claim, in words; nothing where it holds."""
    if proof.scale.sign(region.positive) != 1:
        return f"the scale {_shorten(proof.scale)} need not be positive"
    total = constant(0)
    for term in proof.terms:
        fault = _find_term_fault(term, region)
        if fault:
            return fault
        if term.times and term.times not in claim.hypotheses:
            return f"there is no hypothesis {term.times!r}"
        total = total + term.value() * (claim.hypotheses[term.times] if term.times else constant(1))
    apart = proof.scale * claim.conclusion - total
    if apart:
        return f"the sum differs from the claim by {_shorten(apart)}"
    if claim.says == DEFINITE:
        return _find_zero_fault(proof, region)
    if claim.says == POSITIVE and not any(_is_strict(term, region) for term in proof.terms):
        return "no term of the sum is positive by itself"
    return ""


def unconditional_forms(proof: SquaresProof) -> tuple[Polynomial, ...]:
    """What vanishes where the sum does, of the terms without hypotheses."""
    return tuple(form for term in proof.terms if not term.times for form in term.forms)


def is_at_rest(branches: Sequence[ZeroBranch], region: Region) -> bool:
    """Whether a zero set is the point of rest, and nothing else."""
    return len(branches) == 1 and branches[0].values == dict(region.rest)


def has_growing_forms(proof: SquaresProof, region: Region) -> bool:
    """Whether forms of first degree alone vanish at rest only: then the sum grows without bound in every direction."""
    affine = [
        f
        for f in unconditional_forms(proof)
        if all(sum(power for _, power in m) <= 1 for m in f.collect(region.states))
    ]
    return is_at_rest(solve_equations(affine, region.states, region.positive), region)


def complete_squares(p: Polynomial, region: Region) -> WeightedSquares:
    """A polynomial of second degree in the states as a sum of squares, with weights in the positive names.

    ArithmeticError where no order of the states leads to one.
    """
    shifted = p.substitute({n: symbol(n) + region.rest[n] for n in region.states})
    back, why = {n: symbol(n) - region.rest[n] for n in region.states}, ""
    for order in permutations(region.states):
        try:
            squares = _complete_in_order(shifted, order, region)
        except ArithmeticError as error:
            why = why or str(error)
        else:
            return squares._replace(forms=tuple(f.substitute(back) for f in squares.forms))
    raise ArithmeticError(why)


def _complete_in_order(p: Polynomial, order: tuple[str, ...], region: Region) -> WeightedSquares:
    weights, forms, rest = [], [], p
    for name in order:
        parts = rest.collect((name,))
        powers = {power for m in parts for _, power in m}
        if not powers:
            continue
        if max(powers) != 2:
            raise ArithmeticError(f"{_shorten(rest)} is not of second degree in {name}")
        pivot, cross = parts[((name, 2),)], parts.get(((name, 1),), constant(0))
        if pivot.sign(region.positive) != 1 or (cross and len(pivot.terms) != 1):
            raise ArithmeticError(f"the coefficient {_shorten(pivot)} of {name}^2 is no positive term")
        form = symbol(name) + (cross / (2 * pivot) if cross else constant(0))
        weights, forms, rest = [*weights, pivot], [*forms, form], rest - pivot * form * form
    if rest:
        if rest.sign(region.positive) != 1:
            raise ArithmeticError(f"{_shorten(rest)} is left over, and need not be positive")
        weights, forms = [*weights, rest], [*forms, constant(1)]
    return WeightedSquares("", tuple(weights), tuple(forms))


def _find_term_fault(term: Term, region: Region) -> str:
    known = frozenset(region.states) | frozenset(region.positive)
    for form in term.forms:
        if not form.names <= known:
            return f"the form {_shorten(form)} has a name that is not known"
    if isinstance(term, WeightedSquares):
        bad = [w for w in term.weights if w.sign(region.positive) != 1]
        return f"the weight {_shorten(bad[0])} need not be positive" if bad else ""
    proof = exact.prove_definite(term.matrix)
    at = "" if proof.pivot is None else _shorten(term.forms[proof.pivot])
    return "" if proof.holds else f"the Gram matrix is not positive definite: pivot {proof.value:.6g} at {at}"


def _find_zero_fault(proof: SquaresProof, region: Region) -> str:
    branches = solve_equations(unconditional_forms(proof), region.states, region.positive)
    if is_at_rest(branches, region):
        return ""
    return "the sum vanishes elsewhere than at rest: " + "; or ".join(str(b) for b in branches)


def _is_strict(term: Term, region: Region) -> bool:
    """Whether a term is positive everywhere that its hypothesis is."""
    constants = [bool(f) and len(f.terms) == 1 and f.names <= frozenset(region.positive) for f in term.forms]
    return any(constants) if isinstance(term, WeightedSquares) else False


def _shorten(p: Polynomial) -> str:
    text = str(p)
    return text if len(text) <= SHOWN else text[:SHOWN] + " …"
