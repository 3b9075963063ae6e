"""Proofs in exact arithmetic, where floats can no longer tell."""

from fractions import Fraction

import numpy as np
import pytest

from trimtab.design import exact


def symmetric(n, seed=0):
    M = np.random.default_rng(seed).standard_normal((n, n))
    return (M + M.T) / 2


def gram(n, seed=0):
    """Positive definite with an exactly known factor of small integers."""
    L = np.tril(np.random.default_rng(seed).integers(-3, 4, (n, n)).astype(float), -1) + np.eye(n)
    return L @ L.T


def test_agrees_with_eigenvalues_where_these_are_sure():
    for seed in range(20):
        M = symmetric(5, seed) + 1.5 * np.eye(5)
        assert exact.prove_definite(M).holds == (np.linalg.eigvalsh(M)[0] > 0)


@pytest.mark.parametrize("n", [3, 9, 13])
def test_tells_apart_what_differs_by_rounding(n):
    """L L' is positive of determinant 1; a last entry less by 1 + 1e-13 makes it indefinite, by 1 - 1e-13 not."""
    M = gram(n)
    assert exact.prove_definite(M).holds
    for off, holds in ((1 - 1e-13, True), (1.0, False), (1 + 1e-13, False)):
        less = exact.as_fractions(M)
        less[-1, -1] -= Fraction(off)
        found = exact.prove_definite(less)
        assert found.holds == holds
        if not holds:
            assert found.pivot == n - 1
            assert found.value == pytest.approx(float(1 - Fraction(off)), rel=1e-12, abs=1e-30)


def test_rejects_what_is_indefinite_by_1e_13_relative():
    """Eigenvalues 1 and -1e-13: a rotation of floats, exactly symmetric."""
    c, s = 0.6, 0.8
    M = np.outer([c, s], [c, s]) - 1e-13 * np.outer([-s, c], [-s, c])
    assert not exact.prove_definite(M).holds
    assert exact.prove_definite(M + 3e-13 * np.eye(2)).holds


def test_first_diagonal_entry_and_asymmetry():
    assert exact.prove_definite(np.diag([1.0, -2.0, 3.0]))[2:] == (1, -2.0)
    with pytest.raises(ValueError, match="symmetric"):
        exact.prove_definite(np.array([[1.0, 2e-16], [0.0, 1.0]]))


def test_large_matrices_are_proved_with_bounds(monkeypatch):
    M = gram(6) / 7  # scales and rounding
    M = (M + M.T) / 2
    monkeypatch.setattr(exact, "LARGEST", 4)
    found = exact.prove_definite(M + 1e-3 * np.eye(6))
    assert (found.holds, found.how) == (True, exact.BOUNDED)
    lowest = np.linalg.eigvalsh(M)[0]
    assert not exact.prove_definite(M - 1.01 * lowest * np.eye(6)).holds
    assert not exact.prove_definite(M - lowest * np.eye(6)).holds  # singular to rounding: not proved, rightly
    wide = np.diag([1e-200, 1.0, 1e200, 4.0, 3.0, 2.0])
    assert exact.prove_definite(wide).holds


def test_inverse_and_rank():
    M = exact.as_fractions(gram(4))
    assert (exact.exact_inverse(M) @ M == exact.as_fractions(np.eye(4))).all()
    rng = np.random.default_rng(1)
    low = rng.integers(-5, 6, (7, 3)).astype(float) @ rng.integers(-5, 6, (3, 5)).astype(float)
    assert exact.exact_rank(low) == 3
    nearly = np.array([[1.0, 1.0], [1.0, 1.0 + 2**-52]])
    assert exact.exact_rank(nearly) == 2
    assert exact.exact_rank(np.zeros((2, 3))) == 0
