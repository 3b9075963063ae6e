"""Small linear algebra, unrolled: flight code calls no LAPACK, so it exports and batches like everything else.

A matrix that is not positive definite gives NaN: a signal, never an exception.
"""

from typing import Any

import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)


def cholesky(A: Any) -> Any:
    """Lower triangular L with A = L Lᵀ for symmetric positive definite A (n, n); NaN where it is not.

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


def solve_lower(L: Any, B: Any) -> Any:
    """X with L X = B for lower triangular L (n, n) and B (n,) or (n, m), by forward substitution."""
    rows: list[Any] = []
    for i in range(L.shape[0]):
        rows.append((B[i] - sum((L[i, k] * rows[k] for k in range(i)), jnp.zeros_like(B[i]))) / L[i, i])
    return jnp.stack(rows)


def solve_upper(U: Any, B: Any) -> Any:
    """X with U X = B for upper triangular U (n, n) and B (n,) or (n, m), by back substitution."""
    n = U.shape[0]
    rows: list[Any] = [None] * n
    for i in reversed(range(n)):
        rows[i] = (B[i] - sum((U[i, k] * rows[k] for k in range(i + 1, n)), jnp.zeros_like(B[i]))) / U[i, i]
    return jnp.stack(rows)


def solve_spd(A: Any, B: Any) -> Any:
    """X with A X = B for symmetric positive definite A (n, n) and B (n,) or (n, m); NaN where A is not.

    Source: Golub & Van Loan, "Matrix computations", section 4.2.
    """
    L = cholesky(A)
    return solve_upper(L.T, solve_lower(L, B))


def symmetric(A: Any) -> Any:
    """The symmetric part of a square matrix."""
    return (A + A.T) / 2
