"""Sums of squares: completed, checked, and rejected where the polynomial is not one."""

from fractions import Fraction

import numpy as np
import pytest

from trimtab.design.polynomial import constant, symbol
from trimtab.design.squares import (
    DEFINITE,
    NONNEGATIVE,
    POSITIVE,
    Claim,
    GramForm,
    Region,
    SquaresProof,
    WeightedSquares,
    complete_squares,
    find_fault,
    has_growing_forms,
)

x, y, a, b = (symbol(n) for n in "xyab")
ONE = constant(1)
PLANE = Region(("x", "y"), ("a", "b"), {"x": constant(0), "y": constant(0)})


def fraction_matrix(rows):
    return np.array([[Fraction(v) for v in row] for row in rows], object)


def by_squares(*pairs, times=""):
    return WeightedSquares(times, *(tuple(column) for column in zip(*pairs, strict=True)))


def proof(*terms, scale=ONE):
    return SquaresProof(scale, terms)


def test_completes_squares_exactly_and_rejects_indefinite_forms():
    p = a * x**2 + 2 * a * x * y + (a + b) * y**2 + 3
    squares = complete_squares(p, PLANE)
    assert squares.value() == p
    claim = Claim("p", p, {}, POSITIVE)
    assert find_fault(claim, proof(squares), PLANE) == ""
    for indefinite in (x**2 - y**2, x * y, x**2 + 3 * x * y + y**2, x**3, x**2 - 1):
        with pytest.raises(ArithmeticError):
            complete_squares(indefinite, PLANE)


def test_completes_squares_about_a_nonzero_point():
    there = Region(("x", "y"), ("a",), {"x": a, "y": constant(2)})
    p = (x - a) ** 2 + a * (y - 2 + x - a) ** 2
    squares = complete_squares(p, there)
    assert squares.value() == p
    assert find_fault(Claim("p", p, {}, DEFINITE), proof(squares), there) == ""
    assert "not only at rest" in find_fault(Claim("p", p, {}, DEFINITE), proof(squares), PLANE)


def test_definite_claim_requires_zero_only_at_rest():
    flat = Claim("flat", (x - y) ** 2, {}, DEFINITE)
    whole = proof(by_squares((ONE, x - y)))
    assert find_fault(flat, whole, PLANE) == "the sum is zero not only at rest but at y = x"
    assert find_fault(flat._replace(says=NONNEGATIVE), whole, PLANE) == ""
    assert not has_growing_forms(whole, PLANE)


def test_detects_forms_that_do_not_grow_everywhere():
    """x^2 + (x y - 1)^2 is positive everywhere, but its infimum is zero."""
    assert not has_growing_forms(proof(by_squares((ONE, x), (ONE, x * y - 1))), PLANE)
    assert has_growing_forms(proof(by_squares((ONE, x + y), (a, y), (ONE, x**3))), PLANE)


def test_gram_matrix_proves_a_positive_quartic():
    """Parrilo 2003, example 3.5: 2 x^4 + 2 x^3 y - x^2 y^2 + 5 y^4."""
    p = 2 * x**4 + 2 * x**3 * y - x**2 * y**2 + 5 * y**4
    z = (x * x, y * y, x * y)
    good = GramForm(
        "", z, fraction_matrix([[2, -3 + Fraction(1, 10), 1], [-3 + Fraction(1, 10), 5, 0], [1, 0, "24/5"]])
    )
    assert good.value() == p
    assert find_fault(Claim("p", p, {}, DEFINITE), proof(good), PLANE) == ""
    bad = GramForm("", z, fraction_matrix([[2, 0, 1], [0, 5, 0], [1, 0, -1]]))
    assert bad.value() == p
    assert "not positive definite" in find_fault(Claim("p", p, {}, DEFINITE), proof(bad), PLANE)


def test_proof_uses_given_hypotheses():
    """1 - x > 0 and 1 + x > 0 imply 1 - x^2 > 0: (1 - x)^2 (1 + x) + (1 + x)^2 (1 - x) = 2 (1 - x^2)."""
    claim = Claim("inside", 1 - x * x, {"right": 1 - x, "left": 1 + x}, NONNEGATIVE)
    terms = (by_squares((ONE, 1 - x), times="left"), by_squares((ONE, 1 + x), times="right"))
    assert find_fault(claim, proof(*terms, scale=constant(2)), PLANE) == ""
    assert "differs from the claim" in find_fault(claim, proof(*terms), PLANE)
    assert "unknown hypothesis" in find_fault(claim._replace(hypotheses={"left": 1 + x}), proof(*terms), PLANE)
    assert "no strictly positive term" in find_fault(
        claim._replace(says=POSITIVE), proof(*terms, scale=constant(2)), PLANE
    )


def test_rejects_nonpositive_weights_and_scales():
    claim = Claim("p", a * x**2, {}, NONNEGATIVE)
    assert find_fault(claim, proof(by_squares((a, x))), PLANE) == ""
    assert "weight" in find_fault(claim, proof(by_squares((a + b, x), (-b, x))), PLANE)
    assert "weight" in find_fault(claim, proof(by_squares((a * x**2, ONE))), PLANE)
    assert "scale" in find_fault(claim, proof(by_squares((a, x)), scale=constant(0)), PLANE)
    assert "unknown name" in find_fault(claim, proof(by_squares((a, symbol("z")))), PLANE)
