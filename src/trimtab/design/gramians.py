"""Gramians of controllability and observability of any linear model, over a finite time.

    Wc = integral of exp(A t) B B' exp(A' t)        Wo = integral of exp(A' t) C' C exp(A t)        t from 0 to T

in units that make the rows and columns of the matrices comparable. The time T is finite, because a vehicle's position
and heading have poles at zero, for which the infinite integrals diverge. This code runs offline and uses LAPACK.

Source: C.-T. Chen, "Linear System Theory and Design", Oxford 1999, sections 6.2, 6.3; C. F. Van Loan, "Computing
integrals involving the matrix exponential", IEEE Trans. Automatic Control 23 (1978).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.design.linearise import LinearModel
from trimtab.design.model import format_combination
from trimtab.design.zero_dynamics import scale_system


class WeakestDirection(NamedTuple):
    """Least controllable or least observable direction of the state.

    size: smallest eigenvalue of the Gramian, relative to the largest.  direction: (n,), of unit length, in states
    divided by their sizes.  words: the direction as text, e.g. "0.8 FX - 0.6 FY".
    """

    size: float
    direction: Any
    words: str


class Gramians(NamedTuple):
    """Gramians of a linear model, and the weakest directions.

    controllability, observability: matrices (n, n), for states divided by their sizes.  hardly_moved: least
    controllable direction.  hardly_seen: least observable direction.  sizes: size of each state (n,).
    """

    controllability: Any
    observability: Any
    hardly_moved: WeakestDirection
    hardly_seen: WeakestDirection
    sizes: Any


def find_gramians(linear: LinearModel, horizon: float) -> Gramians:
    """Compute the controllability and observability Gramians over the time `horizon` (s)."""
    if not (np.isfinite(horizon) and horizon > 0):
        raise InputError(argument_name("horizon"), f"must be above 0 s, got {horizon:g} s", fix=argument("horizon", 10))
    A, B, C, _, (sizes, _) = scale_system(linear)
    moved, seen = integrate_gramian(A, B, horizon), integrate_gramian(A.T, C.T, horizon)
    return Gramians(moved, seen, _find_weakest(moved, linear.states), _find_weakest(seen, linear.states), sizes)


def integrate_gramian(A: Any, B: Any, horizon: float) -> Any:
    """Integrate exp(A t) B B' exp(A' t) (n, n) over the time `horizon` (s), by doubling a short step repeatedly."""
    n = len(A)
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(A).sum(axis=1).max(initial=0.0) * horizon, 1.0)))))
    step = horizon / 2**halvings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -A, B @ B.T, A.T
    E = expm(block * step)
    F = E[n:, n:].T
    W = F @ E[:n, n:]
    for _ in range(halvings):
        W, F = W + F @ W @ F.T, F @ F
    return (W + W.T) / 2


def _find_weakest(W: Any, names: tuple[str, ...]) -> WeakestDirection:
    values, vectors = np.linalg.eigh(W)
    top = max(values[-1], np.finfo(float).tiny)
    return WeakestDirection(float(max(values[0], 0.0) / top), vectors[:, 0], format_combination(vectors[:, 0], names))
