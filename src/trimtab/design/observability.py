"""What a trajectory lets a filter see: the observability Gramian along it, in units of what is known beforehand.

Offline code: LAPACK.

Source: [7] Maybeck, "Stochastic models, estimation, and control", vol. 1, Academic Press 1979, section 5.7; [8] Ham,
Brown, "Observability, eigenvalues, and Kalman filtering", IEEE Trans. AES 19 (1983), for scaling by the prior.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError


class Observability(NamedTuple):
    """What was found.

    gramian: scaled (n, n).  singular: its singular values, falling; 1: the measurements tell as much about that
    direction as was known before.  directions: (n, n), row i belongs to singular[i], in units of the prior's sigmas.
    rank: how many are above the tolerance.  hidden: (n - rank, n), the directions that are not seen.
    remaining: sigma of each state that is left when prior and measurements are put together, in its own unit (n,).
    """

    gramian: Any
    singular: Any
    directions: Any
    rank: int
    hidden: Any
    remaining: Any


def gramian(transitions: Any, rows: Any, noises: Any) -> Any:
    """Sum over k of Phi_k' H_k' R_k^-1 H_k Phi_k (n, n), Phi_k from the first instant to instant k.

    Args:
        transitions: (instants - 1, n, n), from each instant to the next.
        rows: H at each instant (instants, m, n); zeros where nothing is measured.
        noises: R at each instant (instants, m, m).

    Source: [7] section 5.7, the information about the first state.
    """
    F, H, R = (np.asarray(x, float) for x in (transitions, rows, noises))
    if F.ndim != 3 or H.ndim != 3 or len(F) != len(H) - 1 or len(R) != len(H) or F.shape[2] != H.shape[2]:
        problem = f"transitions {F.shape}, rows {H.shape} and noises {R.shape} don't fit each other"
        raise InputError("gramian", problem, fix="give (k-1, n, n), (k, m, n) and (k, m, m)")
    n = F.shape[1]
    Phi, G = np.eye(n), np.zeros((n, n))
    for k in range(len(H)):
        seen = H[k] @ Phi
        if seen.any():
            G += seen.T @ np.linalg.solve(R[k], seen)
        if k < len(F):
            Phi = F[k] @ Phi
    return (G + G.T) / 2


def observability(transitions: Any, rows: Any, noises: Any, sigmas: Any, *, tolerance: float = 1e-9) -> Observability:
    """Singular values of the Gramian scaled by the prior sigmas, and what stays unseen.

    Scaling makes rad, m and m/s^2 comparable: a singular value s leaves 1/sqrt(1 + s) of the prior sigma along its
    direction. Process noise is left out, so over long flights this says what could be seen, not what will be.

    Args:
        transitions: as in `gramian`.
        rows: as in `gramian`.
        noises: as in `gramian`.
        sigmas: standard deviation of each state before the first measurement (n,).
        tolerance: singular values below this part of the largest count as zero.
    """
    scale = np.asarray(sigmas, float)
    if (scale <= 0).any() or not np.isfinite(scale).all():
        raise InputError("observability", f"prior sigmas {scale}", fix="give finite ones above 0")
    G = gramian(transitions, rows, noises) * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(G)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1].T
    rank = int((values > tolerance * max(values[0], np.finfo(float).tiny)).sum())
    left = np.sqrt(np.einsum("in,i,in->n", vectors, 1 / (1 + values), vectors)) * scale
    return Observability(G, values, vectors, rank, vectors[rank:], left)
