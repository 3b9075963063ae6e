"""Eigenvalues of a matrix: sorting, formatting as text, participation of the states, and uncontrollable eigenvalues.

This code runs offline and uses LAPACK. It does not use JAX, because certificates are proved without JAX.

Source: [1] I. J. Pérez-Arriaga, G. C. Verghese, F. C. Schweppe, "Selective modal analysis", IEEE Trans. PAS 101 (1982).
"""

from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs, schur, solve_sylvester

UNCONTROLLABLE = 1e-9
"""Ratio of smallest to largest singular value of the scaled [s I - A, B] below which the pole s is uncontrollable."""

COLUMN = 1e-12
"""Length of a column of B, as a fraction of the longest column, below which the column may be a rounding error."""


def sorted_poles(A: Any) -> Any:
    """Return the eigenvalues of A (n, n) as complex numbers, sorted by falling real part."""
    poles = np.linalg.eigvals(A).astype(complex)
    return poles[np.lexsort((-poles.imag, -poles.real))]


def format_pole(pole: complex) -> str:
    """Format a pole, or its conjugate pair, as text (1/s)."""
    return f"{pole.real:+.6g}{f' ± {abs(pole.imag):.6g}i' if pole.imag else ''} 1/s"


def balance_matrix(A: Any) -> Any:
    """Return A with its states scaled by powers of two, so that its rows and columns have similar sizes."""
    if not np.size(A):
        return np.asarray(A, float)
    balance: Any = get_lapack_funcs("gebal", (np.asarray(A, float),))
    return balance(A, scale=1, permute=0)[0]  # matrix_balance would warn about scale factors above 2^63


def participation(A: Any, pole: complex, distance: float) -> Any:
    """Return the participation (n,) of each state in the poles within `distance` of a given pole.

    The participation is the diagonal of the spectral projector, scaled to a sum of 1. For a single pole it is the
    product of left and right eigenvectors [1]. Coinciding poles, for which eigenvectors fail, are treated together.
    """
    ordered: Any = schur(A, output="complex", sort=lambda s: abs(s - pole) <= distance)
    T, Q, k = ordered
    R = solve_sylvester(T[:k, :k], -T[k:, k:], T[:k, k:]) if 0 < k < len(A) else np.zeros((k, len(A) - k))
    share = np.abs(np.einsum("ni,ij,nj->n", Q[:, :k], np.hstack([np.eye(k), R]), Q.conj()))
    return share / share.sum()


def uncontrollable_poles(A: Any, B: Any) -> tuple[complex, ...]:
    """Return the eigenvalues of the scaled A (n, n) that are uncontrollable by B (n, m). Source: Popov, Belevitch,
    Hautus.

    The result does not depend on the units of the inputs, because each column of B is scaled to the size of A. A column
    shorter than COLUMN times the longest column may be a rounding error, and is therefore not scaled up fully.
    """
    n = len(A)
    columns = np.linalg.norm(B, axis=0)
    least = COLUMN * columns.max(initial=0.0)
    B = B / np.where(columns > 0, np.maximum(columns, least), 1.0) * max(np.abs(A).max(initial=0.0), 1e-300)
    poles = []
    for s in np.linalg.eigvals(A):
        # rows of unit length, so that a slow state does not count as uncontrollable
        rows = np.hstack([s * np.eye(n) - A, B])
        length = np.linalg.norm(rows, axis=1)
        singular = np.linalg.svd(rows / np.where(length > 0, length, 1.0)[:, None], compute_uv=False)
        if singular[-1] <= UNCONTROLLABLE * max(singular[0], np.finfo(float).tiny):
            poles.append(complex(s))
    return tuple(poles)
