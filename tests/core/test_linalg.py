"""Unrolled linear algebra against numpy, and NaN where a matrix is not positive definite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.linalg import cholesky, inverse_spd, invert, solve_lower, solve_spd, solve_upper, symmetric

SIZES = (1, 2, 3, 6)


def _spd(n, seed=0):
    a = np.random.default_rng(seed).normal(size=(n, n))
    return a @ a.T + n * np.eye(n)


@pytest.mark.parametrize("n", SIZES)
def test_cholesky_matches_numpy(n):
    A = _spd(n)
    L = cholesky(jnp.asarray(A))
    np.testing.assert_allclose(L, np.linalg.cholesky(A), rtol=1e-12, atol=1e-13)
    assert np.array_equal(L, np.tril(L))


def test_cholesky_reads_only_the_lower_triangle():
    A = _spd(3)
    np.testing.assert_array_equal(cholesky(jnp.asarray(A)), cholesky(jnp.asarray(np.tril(A))))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("columns", [(), (1,), (4,)])
def test_solve_functions_match_numpy(n, columns):
    A = _spd(n, 1)
    B = np.random.default_rng(2).normal(size=(n, *columns))
    L = np.linalg.cholesky(A)
    np.testing.assert_allclose(solve_spd(jnp.asarray(A), jnp.asarray(B)), np.linalg.solve(A, B), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(
        solve_lower(jnp.asarray(L), jnp.asarray(B)), np.linalg.solve(L, B), rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(
        solve_upper(jnp.asarray(L.T), jnp.asarray(B)), np.linalg.solve(L.T, B), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize(
    "A",
    [[[0.0]], [[-1.0]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]],
    ids=["zero", "negative", "indefinite", "singular", "nan"],
)
def test_non_positive_definite_matrix_gives_nan_without_exception(A):
    A = jnp.asarray(A)
    assert np.isnan(cholesky(A)).any()
    assert np.isnan(solve_spd(A, jnp.ones(A.shape[0]))).all()


def test_negative_pivot_makes_only_dependent_entries_nan():
    L = np.asarray(cholesky(jnp.asarray([[4.0, 0.0], [0.0, -1.0]])))
    assert L[0, 0] == 2.0
    assert np.isnan(L[1, 1])


@pytest.mark.thorough
def test_solve_spd_supports_vmap_and_derivatives():
    A = jnp.stack([jnp.asarray(_spd(3, s)) for s in range(4)])
    b = jnp.arange(3.0)
    x = jax.vmap(lambda a: solve_spd(a, b))(A)
    np.testing.assert_allclose(x, np.stack([np.linalg.solve(a, b) for a in np.asarray(A)]), rtol=1e-10)
    slope = jax.jvp(lambda s: solve_spd(s * A[0], b), (1.0,), (1.0,))[1]
    np.testing.assert_allclose(slope, -np.linalg.solve(np.asarray(A[0]), b), rtol=1e-10)


def test_symmetric_averages_matrix_and_transpose():
    A = jnp.array([[1.0, 2.0], [4.0, 3.0]])
    np.testing.assert_array_equal(symmetric(A), [[1.0, 3.0], [3.0, 3.0]])


def test_solve_spd_calls_no_lapack():
    text = str(jax.make_jaxpr(solve_spd)(jnp.eye(3), jnp.ones(3)))
    assert not any(word in text for word in ("cholesky", "triangular_solve", "lu", "custom_call"))


@pytest.mark.thorough("9", "5")
@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_invert_pivots_and_matches_numpy(n):
    A = np.random.default_rng(n).normal(size=(n, n))
    A[0, 0] = 0.0 if n > 1 else A[0, 0]  # which no elimination without pivots survives
    np.testing.assert_allclose(invert(jnp.asarray(A)), np.linalg.inv(A), rtol=1e-10, atol=1e-12)
    assert not np.isfinite(np.asarray(invert(jnp.zeros((n, n))))).any()


@pytest.mark.parametrize("n", SIZES)
def test_inverse_spd_matches_numpy(n):
    A = _spd(n, 3)
    np.testing.assert_allclose(inverse_spd(jnp.asarray(A)), np.linalg.inv(A), rtol=1e-10, atol=1e-12)


def test_inverse_of_non_positive_definite_matrix_is_nan():
    assert np.isnan(np.asarray(inverse_spd(jnp.asarray([[1.0, 2.0], [2.0, 1.0]])))).any()
