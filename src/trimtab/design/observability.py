"""What a filter can see: the observability Gramian along a trajectory, in units of what is known beforehand, and the
rank of a pair that does not change.

Offline code: LAPACK.

Source: [7] Maybeck, "Stochastic models, estimation, and control", vol. 1, Academic Press 1979, section 5.7; [8] Ham,
Brown, "Observability, eigenvalues, and Kalman filtering", IEEE Trans. AES 19 (1983), for scaling by the prior.

Where on the floor a constellation of beacons locates well: dilution of precision.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record

CONE = math.pi / 4
REACH = 9.144


@record
class DilutionMap:
    """Horizontal dilution of precision over the floor: error of a fix over error of a range.

    Frames:  W.    Source:  Langley, "Dilution of precision", GPS World, May 1999; cone and reach: [1] section 5.5.
    """

    north: Any = quantity("m", "Of the rows (a,).", frame="W")
    east: Any = quantity("m", "Of the columns (b,).", frame="W")
    dilution: Any = quantity("1", "sqrt(trace((H'H)^-1)) (a, b); infinite where there is no fix.")
    visible: Any = quantity("1", "How many beacons are in reach and cone (a, b).", kind="count")
    beacons: Any = quantity("m", "The beacons (n, 3).", frame="W")
    down: Scalar = quantity("m", "Down coordinate of the unit.", frame="W")

    def coverage(self, limit: float = 2.0) -> float:
        """Part of the map, 0 to 1, where the dilution is `limit` or less."""
        return float(np.mean(np.asarray(self.dilution) <= limit))


def dilution(directions: Any, visible: Any, *, common_error: bool = False) -> Any:
    """sqrt(trace((H'H)^-1)) of the horizontal position, for unit error of each range.

    Args:
        directions: rate of each range with north and east (..., n, 2): the horizontal part of the unit vectors.
        visible: which ranges there are (..., n).
        common_error: whether a range error common to all is estimated too, as the closed form does.

    Returns: (...), infinite where the ranges don't fix a position.
    """
    H = np.where(visible[..., None], directions, 0.0)
    if common_error:
        H = np.concatenate([H, visible[..., None].astype(np.float64)], axis=-1)
    information = np.swapaxes(H, -1, -2) @ H
    solvable = np.linalg.matrix_rank(information, hermitian=True, tol=1e-9) == information.shape[-1]
    safe = np.where(solvable[..., None, None], information, np.eye(information.shape[-1]))
    covariance = np.linalg.inv(safe)
    found = np.sqrt(covariance[..., 0, 0] + covariance[..., 1, 1])
    return np.where(solvable, found, np.inf)


def dilution_map(
    beacons: Any,
    north: Any,
    east: Any,
    *,
    down: float = 0.0,
    cone: float = CONE,
    reach: float = REACH,
    common_error: bool = False,
) -> DilutionMap:
    """The dilution over a grid of places on the floor.

    Args:
        beacons: positions in W (m), shape (n, 3).
        north: of the rows (m), shape (a,).
        east: of the columns (m), shape (b,).
        down: down coordinate of the unit (m).
        cone: half the opening angle of beacons that look straight down (rad).
        reach: longest range (m).
        common_error: as `dilution`.
    """
    beacons = np.asarray(beacons, np.float64)
    if beacons.ndim != 2 or beacons.shape[1] != 3:
        raise InputError(
            "dilution_map.beacons", f"has shape {beacons.shape}", fix="give one row north, east, down each"
        )
    north, east = np.asarray(north, np.float64), np.asarray(east, np.float64)
    N, E = np.meshgrid(north, east, indexing="ij")
    line = np.stack([N, E, np.full_like(N, down)], axis=-1)[:, :, None] - beacons
    distance = np.linalg.norm(line, axis=-1)
    safe = np.maximum(distance, 1e-9)
    visible = (distance <= reach) & (np.arccos(np.clip(line[..., 2] / safe, -1, 1)) <= cone)
    found = dilution(line[..., :2] / safe[..., None], visible, common_error=common_error)
    return DilutionMap(north, east, found, visible.sum(-1).astype(np.int32), beacons, down)


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
    hidden_directions: Any
    remaining_sigmas: Any


class ConstantRank(NamedTuple):
    """What was found of a pair that does not change.

    rank: of the scaled observability matrix.  singular: its singular values, falling.  ratio: last of them over first.
    hidden: (n - rank, n), directions that no measurement shows, in units of the scale.  time: the unit of time (s) in
    which derivatives are counted.
    """

    rank: int
    singular: Any
    ratio: float
    hidden_directions: Any
    time: float


def constant_rank(A: Any, C: Any, *, scale: Any = None, tolerance: float = 1e-9) -> ConstantRank:
    """Rank of [C; C A; C A^2; …] for x' = A x, y = C x, in units in which its rows compare.

    Without scaling powers of fast poles bury the rows: time is counted in 1/|A|, states in their scale, and
    rows of C by their length.

    Args:
        A: (n, n).
        C: (p, n).
        scale: sizes of the states (n,); those that balance A where not given.
        tolerance: singular values below this part of the largest count as zero.

    Source: Kalman's rank condition.
    """
    A, C = np.atleast_2d(np.asarray(A, float)), np.atleast_2d(np.asarray(C, float))
    n = len(A)
    if A.shape != (n, n) or C.shape[1] != n or not (np.isfinite(A).all() and np.isfinite(C).all()):
        problem = f"A {A.shape} and C {C.shape} don't fit each other, or are not finite"
        raise InputError("constant_rank", problem, fix="give (n, n) and (p, n)")
    with np.errstate(invalid="ignore"):  # it casts scalings to integers on its way
        balance: Any = matrix_balance(A, permute=False, separate=True)
    d = np.asarray(balance[1][0] if scale is None else scale, float)
    if d.shape != (n,) or not (np.isfinite(d) & (d > 0)).all():
        raise InputError("constant_rank.scale", f"{d}", fix=f"give {n} finite sizes above 0")
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
        transitions: as in `observability_gramian`.
        rows: as in `observability_gramian`.
        noises: as in `observability_gramian`.
        sigmas: standard deviation of each state before the first measurement (n,).
        tolerance: singular values below this part of the largest count as zero.
    """
    scale = np.asarray(sigmas, float)
    if (scale <= 0).any() or not np.isfinite(scale).all():
        raise InputError("observability", f"prior sigmas {scale}", fix="give finite ones above 0")
    G = observability_gramian(transitions, rows, noises) * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(G)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1].T
    rank = int((values > tolerance * max(values[0], np.finfo(float).tiny)).sum())
    left = np.sqrt(np.einsum("in,i,in->n", vectors, 1 / (1 + values), vectors)) * scale
    return Observability(G, values, vectors, rank, vectors[rank:], left)
