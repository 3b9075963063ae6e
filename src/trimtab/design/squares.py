"""Proofs that a polynomial is nowhere negative, as a sum of squares, checked exactly and without a solver.

    scale * conclusion = sum of weight * form^2 [* hypothesis]  +  sum of z'G z [* hypothesis]

Weights and scale are positive for all positive values of their names, because all their coefficients are positive. Each
G is proved positive definite without rounding. The conclusion is therefore not negative wherever every hypothesis is
positive. A file may claim any such sum; this module checks that both sides are the same polynomial.

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
"""Possible statements of a claim about its polynomial (values of `Claim.says`)."""
SHOWN = 90
"""Maximum number of characters of a polynomial in a message."""


class WeightedSquares(NamedTuple):
    """Sum of terms weight * form^2, multiplied by a hypothesis.

    times: name of the hypothesis, or "" for none.  weights, forms: polynomials, one weight for each form.
    """

    times: str
    weights: tuple[Polynomial, ...]
    forms: tuple[Polynomial, ...]

    def value(self) -> Polynomial:
        """Return the sum of squares as a polynomial, without the factor of the hypothesis."""
        return sum((w * f * f for w, f in zip(self.weights, self.forms, strict=True)), constant(0))


class GramForm(NamedTuple):
    """Quadratic form z'G z, multiplied by a hypothesis.

    times: name of the hypothesis, or "" for none.  forms: z, k polynomials.  matrix: G, Fractions (k, k).
    """

    times: str
    forms: tuple[Polynomial, ...]
    matrix: Any

    def value(self) -> Polynomial:
        """Return z'G z as a polynomial, without the factor of the hypothesis."""
        z, total = self.forms, constant(0)
        for i, row in enumerate(self.matrix):
            total = total + z[i] * sum((constant(c) * b for c, b in zip(row, z, strict=True)), constant(0))
        return total


Term = WeightedSquares | GramForm


class SquaresProof(NamedTuple):
    """Proof by squares. scale: polynomial factor of the conclusion.  terms: terms whose sum must be scale times
    conclusion."""

    scale: Polynomial
    terms: tuple[Term, ...]


class Claim(NamedTuple):
    """Claim to be proved, which comes entirely from code.

    name: name of the claim.  conclusion: the polynomial.  hypotheses: name -> polynomial; the claim is only made where
    all hypotheses are positive.  says: statement about the polynomial, DEFINITE, NONNEGATIVE or POSITIVE.
    """

    name: str
    conclusion: Polynomial
    hypotheses: Mapping[str, Polynomial]
    says: str


class Region(NamedTuple):
    """Meaning of the names in polynomials, and the equilibrium of the loop.

    states: names of states.  positive: names of parameters that are positive.  rest: state -> its value at the
    equilibrium, a polynomial in the positive names.
    """

    states: tuple[str, ...]
    positive: tuple[str, ...]
    rest: Mapping[str, Polynomial]


def find_fault(claim: Claim, proof: SquaresProof, region: Region) -> str:
    """Return the reason why a proof of a claim fails, or an empty text if the proof is valid."""
    if proof.scale.sign(region.positive) != 1:
        return f"the scale {_shorten(proof.scale)} may be negative"
    total = constant(0)
    for term in proof.terms:
        fault = _find_term_fault(term, region)
        if fault:
            return fault
        if term.times and term.times not in claim.hypotheses:
            return f"unknown hypothesis {term.times!r}"
        total = total + term.value() * (claim.hypotheses[term.times] if term.times else constant(1))
    apart = proof.scale * claim.conclusion - total
    if apart:
        return f"the sum differs from the claim by {_shorten(apart)}"
    if claim.says == DEFINITE:
        return _find_zero_fault(proof, region)
    if claim.says == POSITIVE and not any(_is_strict(term, region) for term in proof.terms):
        return "the sum has no strictly positive term"
    return ""


def unconditional_forms(proof: SquaresProof) -> tuple[Polynomial, ...]:
    """Return the forms of all terms without a hypothesis. All of them vanish wherever the proof's sum vanishes."""
    return tuple(form for term in proof.terms if not term.times for form in term.forms)


def is_at_rest(branches: Sequence[ZeroBranch], region: Region) -> bool:
    """Return True if a zero set consists of the loop's equilibrium only."""
    return len(branches) == 1 and branches[0].values == dict(region.rest)


def has_growing_forms(proof: SquaresProof, region: Region) -> bool:
    """Return True if the linear forms vanish only at the equilibrium. The sum then grows without bound in every
    direction."""
    affine = [
        f
        for f in unconditional_forms(proof)
        if all(sum(power for _, power in m) <= 1 for m in f.collect(region.states))
    ]
    return is_at_rest(solve_equations(affine, region.states, region.positive), region)


def complete_squares(p: Polynomial, region: Region) -> WeightedSquares:
    """Write a polynomial of second degree in the states as a sum of squares, with weights in the positive names.

    Raises: ArithmeticError if this is not possible in any order of the states.
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
            raise ArithmeticError(f"the coefficient {_shorten(pivot)} of {name}^2 is not a positive term")
        form = symbol(name) + (cross / (2 * pivot) if cross else constant(0))
        weights, forms, rest = [*weights, pivot], [*forms, form], rest - pivot * form * form
    if rest:
        if rest.sign(region.positive) != 1:
            raise ArithmeticError(f"the remainder {_shorten(rest)} may be negative")
        weights, forms = [*weights, rest], [*forms, constant(1)]
    return WeightedSquares("", tuple(weights), tuple(forms))


def _find_term_fault(term: Term, region: Region) -> str:
    known = frozenset(region.states) | frozenset(region.positive)
    for form in term.forms:
        if not form.names <= known:
            return f"the form {_shorten(form)} has an unknown name"
    if isinstance(term, WeightedSquares):
        bad = [w for w in term.weights if w.sign(region.positive) != 1]
        return f"the weight {_shorten(bad[0])} may be negative" if bad else ""
    proof = exact.prove_definite(term.matrix)
    at = "" if proof.pivot is None else _shorten(term.forms[proof.pivot])
    return "" if proof.holds else f"the Gram matrix is not positive definite; pivot {proof.value:.6g} at {at}"


def _find_zero_fault(proof: SquaresProof, region: Region) -> str:
    branches = solve_equations(unconditional_forms(proof), region.states, region.positive)
    if is_at_rest(branches, region):
        return ""
    return "the sum is zero not only at rest but at " + "; or ".join(str(b) for b in branches)


def _is_strict(term: Term, region: Region) -> bool:
    """Return True if a term is positive wherever its hypothesis is positive."""
    constants = [bool(f) and len(f.terms) == 1 and f.names <= frozenset(region.positive) for f in term.forms]
    return any(constants) if isinstance(term, WeightedSquares) else False


def _shorten(p: Polynomial) -> str:
    text = str(p)
    return text if len(text) <= SHOWN else text[:SHOWN] + " …"
