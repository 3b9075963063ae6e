"""Gram matrices found by a solver: exact after rounding, and an error where none exists."""

import pytest

from trimtab.design.gram_search import GramSearch, find_gram_proof
from trimtab.design.polynomial import constant, symbol
from trimtab.design.squares import NONNEGATIVE, Claim, Region, find_fault

pytest.importorskip("clarabel")
x, y, X, Y = (symbol(n) for n in ("x", "y", "X", "Y"))
PLANE = Region(("x", "y"), (), {"x": constant(0), "y": constant(0)})
SHEAR = {"x": 2 * X, "y": Y + X}
BACK = {"X": x / 2, "Y": y - x / 2}


def search(*forms, **others):
    return GramSearch(SHEAR, BACK, {"": forms, **others})


def test_finds_proof_of_a_positive_quartic():
    """Parrilo 2003, example 3.5, is positive by more than any rounding."""
    claim = Claim("p", 2 * x**4 + 2 * x**3 * y - x**2 * y**2 + 5 * y**4, {}, NONNEGATIVE)
    proof = find_gram_proof(claim, search(X * X, X * Y, Y * Y))
    assert find_fault(claim, proof, PLANE) == ""


def test_finds_proof_valid_only_inside_a_circle():
    """2 x^2 + 2 y^2 - x^3 is not positive everywhere, but within x^2 + y^2 < 1."""
    claim = Claim("p", 2 * x**2 + 2 * y**2 - x**3, {"disc": 1 - x**2 - y**2}, NONNEGATIVE)
    forms = (X, Y, X * X, X * Y, Y * Y)
    proof = find_gram_proof(claim, search(*forms, disc=(X, Y)))
    assert find_fault(claim, proof, PLANE) == ""
    with pytest.raises(ArithmeticError, match="no positive definite Gram matrices"):
        find_gram_proof(claim._replace(hypotheses={}), search(*forms))


def test_motzkin_polynomial_is_not_a_sum_of_squares():
    """x^4 y^2 + x^2 y^4 - 3 x^2 y^2 + 1 is nowhere negative, and no sum of squares (Motzkin 1967)."""
    claim = Claim("p", x**4 * y**2 + x**2 * y**4 - 3 * x**2 * y**2 + 1, {}, NONNEGATIVE)
    plain = GramSearch({"x": X, "y": Y}, {"X": x, "Y": y}, {"": (constant(1), X * Y, X * X * Y, X * Y * Y)})
    with pytest.raises(ArithmeticError):
        find_gram_proof(claim, plain)


def test_rejects_term_outside_products_of_forms():
    with pytest.raises(ArithmeticError, match="is not a product of two forms"):
        find_gram_proof(Claim("p", x**6 + y**2, {}, NONNEGATIVE), search(X, Y))
