"""Discretisation of a linear model, exact for an input held over the step. Pure functions without LAPACK, for flight
code.

Source: Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. AC 23 (1978); Moler, Van Loan,
"Nineteen dubious ways to compute the exponential of a matrix", SIAM Review 20 (1978), method 3.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from trimtab.core.linalg import symmetric

SQUARINGS, TERMS = 6, 12
"""Number of squarings, and order of the Taylor series of A/2^6. They are sufficient for row sums of |A| below 32."""


class DiscreteModel(NamedTuple):
    """Discrete model x_k+1 = Ad x_k + Bd b + w with constant b. Bd: integral of expm(A s). Qd: covariance (n, n) of
    w."""

    Ad: Any
    Bd: Any
    Qd: Any


def matrix_exponential(A: Any) -> Any:
    """Return expm(A) (n, n) by scaling, a Taylor series and squaring. The largest row sum of |A| must be below 32."""
    n = A.shape[0]
    X, one = A / 2.0**SQUARINGS, jnp.eye(n)

    def taylor(i: Any, E: Any) -> Any:
        return one + X @ E / (TERMS - i)

    series = jax.lax.fori_loop(0, TERMS, taylor, one)
    return jax.lax.fori_loop(0, SQUARINGS, lambda _, E: E @ E, series)


def discretise(A: Any, Q: Any, dt: Any) -> DiscreteModel:
    """Return the discrete model of x' = A x + b + w over a step.

    A: (n, n).  Q: power spectral density of w (n, n), symmetric.  dt: step (s); row sums of |A dt| must be below 32.
    """
    n = A.shape[0]
    zero, one = jnp.zeros((n, n)), jnp.eye(n)
    E = matrix_exponential(jnp.block([[A, one], [zero, zero]]) * dt)
    V = matrix_exponential(jnp.block([[-A, Q], [zero, A.T]]) * dt)
    return DiscreteModel(Ad=E[:n, :n], Bd=E[:n, n:], Qd=symmetric(V[n:, n:].T @ V[:n, n:]))
