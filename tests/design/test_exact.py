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


def test_definiteness_agrees_with_clear_eigenvalues():
    for seed in range(20):
        M = symmetric(5, seed) + 1.5 * np.eye(5)
        assert exact.prove_definite(M).holds == (np.linalg.eigvalsh(M)[0] > 0)


@pytest.mark.parametrize("n", [3, 9, 13, 20])
def test_distinguishes_matrices_that_differ_by_rounding(n):
    """L L' is positive of determinant 1; a last entry less by 1 + 1e-13 makes it indefinite, by 1 - 1e-13 not."""
    M = gram(n)
    assert exact.prove_definite(M).holds
    for off, holds in ((1 - 1e-13, True), (1.0, False), (1 + 1e-13, False)):
        less = exact.as_fractions(M)
        less[-1, -1] -= Fraction(off)
        proof = exact.prove_definite(less)
        assert proof.holds == holds
        if not holds:
            assert proof.pivot == n - 1
            assert proof.value == pytest.approx(float(1 - Fraction(off)), rel=1e-12, abs=1e-30)


def test_rejects_matrix_indefinite_by_1e_13_relative():
    """Eigenvalues 1 and -1e-13: a rotation of floats, exactly symmetric."""
    c, s = 0.6, 0.8
    M = np.outer([c, s], [c, s]) - 1e-13 * np.outer([-s, c], [-s, c])
    assert not exact.prove_definite(M).holds
    assert exact.prove_definite(M + 3e-13 * np.eye(2)).holds


@pytest.mark.thorough("60")
@pytest.mark.parametrize("n", [33, 47, 60])
def test_distinguishes_nearly_singular_matrices_of_any_size(n):
    """A Laplacian of integers, singular by construction: more by 2^-60 proves it, the same less makes it indefinite.

    Both are one and the same matrix for floats; a factorisation in floats that forgets its rounding takes the wrong
    one, or the singular one itself.
    """
    weight = np.random.default_rng(n).integers(1, 9, (n, n))
    weight = np.triu(weight, 1) + np.triu(weight, 1).T
    singular = exact.as_fractions(np.diag(weight.sum(axis=1)) - weight)
    assert np.linalg.eigvalsh(np.array(singular, float))[0] == pytest.approx(0, abs=1e-10)
    tiny = exact.as_fractions(np.eye(n)) * (Fraction(1) / 2**60)
    assert exact.prove_definite(singular + tiny).holds
    for M in (singular, singular - tiny):
        proof = exact.prove_definite(M)
        assert (proof.holds, proof.pivot) == (False, n - 1)
        assert proof.value <= 0
    assert exact.prove_definite(singular).value == 0.0


def test_reports_first_negative_pivot_and_rejects_asymmetry():
    assert exact.prove_definite(np.diag([1.0, -2.0, 3.0]))[2:] == (1, -2.0)
    with pytest.raises(ValueError, match="symmetric"):
        exact.prove_definite(np.array([[1.0, 2e-16], [0.0, 1.0]]))


def test_badly_scaled_matrix_keeps_sign_and_pivot():
    """Scaling by powers of two inside changes neither; the pivot is in the matrix's own unit."""
    size = np.array([1e-150, 1.0, 1e150, 3.0, 1e-20])
    M = exact.as_fractions(gram(5)) * np.outer(exact.as_fractions(size), exact.as_fractions(size))
    assert exact.prove_definite(M).holds
    M[4, 4] -= Fraction(2) * Fraction(1e-20) ** 2
    proof = exact.prove_definite(M)
    assert (proof.holds, proof.pivot) == (False, 4)
    assert proof.value == pytest.approx(-1e-40, rel=1e-12)


def test_large_integers_do_not_overflow():
    """NumPy's integers of 64 bits would: the determinant of each is 1."""
    L = np.array([[1, 0, 0], [3 * 10**8, 1, 0], [10**8, 7 * 10**8, 1]])
    assert exact.prove_definite(L @ L.T).holds
    assert not exact.prove_definite(L @ L.T - np.diag([0, 0, 1])).holds


def test_exact_inverse_and_rank():
    M = exact.as_fractions(gram(4))
    assert (exact.exact_inverse(M) @ M == exact.as_fractions(np.eye(4))).all()
    with pytest.raises(ZeroDivisionError, match="no inverse"):
        exact.exact_inverse(exact.as_fractions(np.ones((2, 2))))
    rng = np.random.default_rng(1)
    low = rng.integers(-5, 6, (7, 3)).astype(float) @ rng.integers(-5, 6, (3, 5)).astype(float)
    assert exact.exact_rank(low) == 3
    nearly = np.array([[1.0, 1.0], [1.0, 1.0 + 2**-52]])
    assert exact.exact_rank(nearly) == 2
    assert exact.exact_rank(np.zeros((2, 3))) == 0
