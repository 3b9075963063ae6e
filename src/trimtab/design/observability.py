"""Observability: the Gramian along a trajectory, scaled by the prior sigmas, and the rank of a constant pair (A, C).

This code runs offline and uses LAPACK.

Source: [7] Maybeck, "Stochastic models, estimation, and control", vol. 1, Academic Press 1979, section 5.7; [8] Ham,
Brown, "Observability, eigenvalues, and Kalman filtering", IEEE Trans. AES 19 (1983), for scaling by the prior.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

from trimtab.core.errors import InputError


class Observability(NamedTuple):
    """Observability along a trajectory.

    gramian: Gramian scaled by the prior sigmas (n, n).  singular: its singular values, falling; at a value of 1, the
    measurements contain as much information about a direction as the prior.  rank: number of singular values above the
    tolerance.  hidden_directions: (n - rank, n), unobservable directions, in units of the prior sigmas.
    remaining_sigmas: standard deviation of each state, given prior and measurements, in the state's unit (n,).
    """

    gramian: Any
    singular: Any
    rank: int
    hidden_directions: Any
    remaining_sigmas: Any


class ConstantRank(NamedTuple):
    """Observability of a constant pair (A, C).

    rank: rank of the scaled observability matrix.  singular: its singular values, falling.  ratio: smallest singular
    value divided by the largest.  hidden_directions: (n - rank, n), unobservable directions, in units of the states'
    sizes.  time: unit of time (s) in the scaled matrix.
    """

    rank: int
    singular: Any
    ratio: float
    hidden_directions: Any
    time: float


def constant_rank(A: Any, C: Any, *, scale: Any = None, tolerance: float = 1e-9) -> ConstantRank:
    """Return the rank of [C; C A; C A^2; …] for x' = A x, y = C x, in units that make the rows of this matrix
    comparable.

    Without scaling, the powers of fast poles hide the other rows. Therefore the unit of time is 1/|A|, the unit of each
    state is its size, and each row of C is divided by its length.

    Args:
        A: (n, n).
        C: (p, n).
        scale: sizes of the states (n,); default: the sizes that balance A.
        tolerance: largest singular value that counts as zero, as a fraction of the largest singular value.

    Source: Kalman's rank condition.
    """
    A, C = np.atleast_2d(np.asarray(A, float)), np.atleast_2d(np.asarray(C, float))
    n = len(A)
    if A.shape != (n, n) or C.shape[1] != n or not (np.isfinite(A).all() and np.isfinite(C).all()):
        problem = f"A {A.shape} and C {C.shape} must fit together and be finite"
        raise InputError("constant_rank", problem, fix="give (n, n) and (p, n)")
    with np.errstate(invalid="ignore"):  # SciPy casts scale factors to integers
        balance: Any = matrix_balance(A, permute=False, separate=True)
    d = np.asarray(balance[1][0] if scale is None else scale, float)
    if d.shape != (n,) or not (np.isfinite(d) & (d > 0)).all():
        raise InputError(
            "constant_rank.scale", f"must be {n} finite sizes above 0, got {d}", fix="give one size for each state"
        )
    As, rows = A * d / d[:, None], C * d
    fastest = np.linalg.norm(As, 2)
    time = 1 / fastest if fastest > 0 else 1.0
    As = As * time
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    blocks = [rows / np.where(length > 0, length, 1.0)]
    for _ in range(n - 1):
        blocks.append(blocks[-1] @ As)
    _, singular, right = np.linalg.svd(np.vstack(blocks))
    rank = int((singular > tolerance * max(singular[0], np.finfo(float).tiny)).sum())
    ratio = float(singular[-1] / max(singular[0], np.finfo(float).tiny))
    return ConstantRank(rank, singular, ratio, right[rank:], float(time))


def observability_gramian(transitions: Any, rows: Any, noises: Any) -> Any:
    """Return the Gramian, the sum over k of Phi_k' H_k' R_k^-1 H_k Phi_k (n, n). Phi_k is the transition from instant 0
    to k.

    Args:
        transitions: transition matrices from each instant to the next (instants - 1, n, n).
        rows: measurement matrix H at each instant (instants, m, n); zero at instants without a measurement.
        noises: measurement covariance R at each instant (instants, m, m).

    Source: [7] section 5.7, the information about the first state.
    """
    F, H, R = (np.asarray(x, float) for x in (transitions, rows, noises))
    if F.ndim != 3 or H.ndim != 3 or len(F) != len(H) - 1 or len(R) != len(H) or F.shape[2] != H.shape[2]:
        problem = f"the shapes of transitions {F.shape}, rows {H.shape} and noises {R.shape} must fit together"
        raise InputError("gramian", problem, fix="give (k-1, n, n), (k, m, n) and (k, m, m)")
    n = F.shape[1]
    Phi, G = np.eye(n), np.zeros((n, n))
    for k in range(len(H)):
        rows_then = H[k] @ Phi
        if rows_then.any():
            G += rows_then.T @ np.linalg.solve(R[k], rows_then)
        if k < len(F):
            Phi = F[k] @ Phi
    return (G + G.T) / 2


def observability(transitions: Any, rows: Any, noises: Any, sigmas: Any, *, tolerance: float = 1e-9) -> Observability:
    """Compute the singular values of the Gramian scaled by the prior sigmas, and the unobservable directions.

    Scaling makes rad, m and m/s^2 comparable: along a direction with singular value s, the measurements reduce the
    prior sigma by the factor 1/sqrt(1 + s). Process noise is left out. For long flights, the result is therefore an
    upper limit of the information that a filter gains.

    Args:
        transitions, rows, noises: as in `observability_gramian`.
        sigmas: standard deviation of each state before the first measurement (n,).
        tolerance: largest singular value that counts as zero, as a fraction of the largest singular value.
    """
    scale = np.asarray(sigmas, float)
    if (scale <= 0).any() or not np.isfinite(scale).all():
        raise InputError(
            "observability",
            f"prior sigmas must be finite and above 0, got {scale}",
            fix="give one sigma for each state",
        )
    G = observability_gramian(transitions, rows, noises) * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(G)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1].T
    rank = int((values > tolerance * max(values[0], np.finfo(float).tiny)).sum())
    left = np.sqrt(np.einsum("in,i,in->n", vectors, 1 / (1 + values), vectors)) * scale
    return Observability(G, values, rank, vectors[rank:], left)
