"""Linear algebra for small matrices, with unrolled loops. It does not call LAPACK, so that it can be exported as C.

If a matrix is not positive definite, the result is NaN, and no exception is raised.
"""

from typing import Any

import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)


def cholesky(A: Any) -> Any:
    """Return lower triangular L with A = L Lᵀ for symmetric positive definite A (n, n); NaN if A is not positive
    definite.

    Only the lower triangle of A is read. Source: Golub & Van Loan, "Matrix computations", section 4.2.
    """
    n = A.shape[0]
    L: list[list[Any]] = [[jnp.zeros((), A.dtype)] * n for _ in range(n)]
    for j in range(n):
        d = A[j, j] - sum((L[j][k] * L[j][k] for k in range(j)), jnp.zeros((), A.dtype))
        L[j][j] = jnp.sqrt(jnp.where(d > 0, d, jnp.nan))
        for i in range(j + 1, n):
            L[i][j] = (A[i, j] - sum((L[i][k] * L[j][k] for k in range(j)), jnp.zeros((), A.dtype))) / L[j][j]
    return jnp.stack([jnp.stack(row) for row in L])


def semidefinite_root(A: Any) -> Any:
    """Return lower triangular L with A = L Lᵀ for a covariance A (n, n) that may be singular, as for zero noise.

    A pivot of 0, or below 0 by rounding, results in a column of zeros. Source: Golub & Van Loan, "Matrix computations",
    section 4.2.8.
    """
    n = A.shape[0]
    L: list[list[Any]] = [[jnp.zeros((), A.dtype)] * n for _ in range(n)]
    for j in range(n):
        d = A[j, j] - sum((L[j][k] * L[j][k] for k in range(j)), jnp.zeros((), A.dtype))
        is_positive = d > 0
        root = jnp.sqrt(jnp.where(is_positive, d, 1.0))
        L[j][j] = jnp.where(is_positive, root, 0.0)
        for i in range(j + 1, n):
            rest = A[i, j] - sum((L[i][k] * L[j][k] for k in range(j)), jnp.zeros((), A.dtype))
            L[i][j] = jnp.where(is_positive, rest / root, 0.0)
    return jnp.stack([jnp.stack(row) for row in L])


def solve_lower(L: Any, B: Any) -> Any:
    """Return X with L X = B for lower triangular L (n, n) and B (n,) or (n, m), by forward substitution."""
    rows: list[Any] = []
    for i in range(L.shape[0]):
        rows.append((B[i] - sum((L[i, k] * rows[k] for k in range(i)), jnp.zeros_like(B[i]))) / L[i, i])
    return jnp.stack(rows)


def solve_upper(U: Any, B: Any) -> Any:
    """Return X with U X = B for upper triangular U (n, n) and B (n,) or (n, m), by back substitution."""
    n = U.shape[0]
    rows: list[Any] = [None] * n
    for i in reversed(range(n)):
        rows[i] = (B[i] - sum((U[i, k] * rows[k] for k in range(i + 1, n)), jnp.zeros_like(B[i]))) / U[i, i]
    return jnp.stack(rows)


def solve_spd(A: Any, B: Any) -> Any:
    """Return X with A X = B for symmetric A (n, n) and B (n,) or (n, m); NaN if A is not positive definite.

    Source: Golub & Van Loan, "Matrix computations", section 4.2.
    """
    L = cholesky(A)
    return solve_upper(L.T, solve_lower(L, B))


def inverse_spd(A: Any) -> Any:
    """Return the inverse of a large symmetric matrix A (n, n) by loops; NaN if A is not positive definite.

    Source: the sweep operator, J. Goodnight, "A tutorial on the SWEEP operator", American Statistician 33 (1979) 149.
    """

    def sweep(k: Any, A: Any) -> Any:
        pivot, row, column = A[k, k], A[k], A[:, k]
        pivot = jnp.where(pivot > 0, pivot, jnp.nan)
        A = A - column[:, None] * (row / pivot)
        A = A.at[k].set(row / pivot).at[:, k].set(column / pivot)
        return A.at[k, k].set(-1 / pivot)

    return -jax.lax.fori_loop(0, A.shape[0], sweep, A)


def symmetric(A: Any) -> Any:
    """Return the symmetric part of a square matrix."""
    return (A + A.T) / 2


def invert(A: Any) -> Any:
    """Return the inverse of a square matrix (n, n), by Gauss–Jordan elimination with the largest pivot of each column.

    For a singular matrix, the result contains infinities or NaN. Source: Golub & Van Loan, "Matrix computations",
    sections 3.4 and 3.5.
    """
    n = A.shape[0]
    rows = jnp.arange(n)[:, None]
    M = jnp.concatenate([A, jnp.eye(n, dtype=A.dtype)], axis=1)
    for k in range(n):
        largest = k + jnp.argmax(jnp.abs(M[k:, k]))
        swapped = jnp.sum(jnp.where(rows == largest, M, 0.0), axis=0)
        M = jnp.where(rows == largest, M[k], M)
        pivot = swapped / swapped[k]
        M = jnp.where(rows == k, pivot, M - M[:, k : k + 1] * pivot)
    return M[:, n:]
