"""What a linear system does while a command from an exosystem lasts: X with X S = A X + G.

    omega' = S omega        zeta' = A zeta + G omega        zeta = X omega is the solution that follows omega alone

It needs omega now and nothing else: causal, and indifferent to the signs of the poles of A. Offline code: LAPACK.

Source: [1] B. A. Francis, "The linear multivariable regulator problem", SIAM Journal on Control and Optimization 15(3),
1977; A. Isidori, "Nonlinear Control Systems", Springer 1995, section 8.4, for the equation's place in regulation.
"""

from typing import Any

import numpy as np
from scipy.linalg import solve_sylvester

from trimtab.core.errors import InputError

APART = 1e-9
"""Poles of A and S nearer than this part of the largest magnitude are the same."""


def following(A: Any, S: Any, G: Any) -> Any:
    """X (k, m) with X S = A X + G.

    Args:
        A: of the system (k, k).
        S: of the exosystem (m, m), no pole of A's among its own.
        G: how the exosystem drives the system (k, m).

    Source: [1].
    """
    A, S, G = (np.asarray(M, float) for M in (A, S, G))
    k, m = len(A), len(S)
    for name, M, wanted in (("A", A, (k, k)), ("S", S, (m, m)), ("G", G, (k, m))):
        if M.shape != wanted or not np.isfinite(M).all():
            problem = f"shape {M.shape}, wanted is {wanted}, all finite"
            raise InputError(f"following.{name}", problem, fix="give A (k, k), S (m, m), G (k, m)")
    inside, outside = np.linalg.eigvals(A), np.linalg.eigvals(S)
    gaps = np.abs(inside[:, None] - outside)
    i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
    if gaps[i, j] <= APART * max(np.abs(inside).max(), np.abs(outside).max()):
        problem = f"the system's pole {inside[i]:.6g} is one of the exosystem's: the command excites it for ever"
        raise InputError("following.S", problem, fix="change the command's poles")
    return solve_sylvester(A, -S, -G)


def filter_matrix(w: float, order: int) -> Any:
    """S (order, order) of (y - y_final, y', …) behind a filter of `order` equal poles at -w (rad/s)."""
    S = np.eye(order, k=1)
    S[-1] = [-float(c) * w ** (order - i) for i, c in enumerate(_binomial(order))]
    return S


def _binomial(order: int) -> list[int]:
    """Coefficients of (s + 1)^order from s^0 to s^(order-1)."""
    row = [1]
    for i in range(order):
        row.append(row[-1] * (order - i) // (i + 1))
    return row[:-1]
