"""Lyapunov conditions for state feedback that uses an observer for some of the states.

    e' = (A + B K) e - B K E e_eta        e_eta' = (A_eta - L C) e_eta        V = e'P e/2 + weight e_eta'P_eta^-1 e_eta

E selects the estimated states. The weight of the observer in V is a free parameter. There are two conditions. The first
is

    z(weight) = [Q_e, W E/2; E'W/2, weight Pi] > 0     W = P B R_e^-1 B'P     Pi = P_eta^-1 Q_eta P_eta^-1 + C'R^-1 C

i.e. (15) of [1], corrected and with a weight. The second condition is `decrease_matrix` > 0, i.e. -dV/dt > 0, for any
gain. Both use coordinates w with e_eta = P_eta w, which avoid the inverse of P_eta and do not change the conditions.
All functions accept float arrays, or arrays of fractions for exact results.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 14, 15; corrections: docs page.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh, sqrtm

from trimtab.core.errors import InputError


class Feedback(NamedTuple):
    """Matrices of the state feedback v = +K e.

    A: (n, n).  B: (n, m).  K: (m, n).  P: (n, n).  Qe: (n, n).  Re_inverse: R_e^-1 (m, m).
    """

    A: Any
    B: Any
    K: Any
    P: Any
    Qe: Any
    Re_inverse: Any


class Observer(NamedTuple):
    """Matrices of a filter that estimates k of the n states.

    A: A_eta (k, k).  C: (p, k).  Q: Q_eta (k, k).  P: P_eta (k, k).  L: (k, p).  R_inverse: R^-1 (p, p).
    at: indices of the estimated states in e (k,).
    """

    A: Any
    C: Any
    Q: Any
    P: Any
    L: Any
    R_inverse: Any
    at: Any


def lyapunov_matrix(f: Feedback) -> Any:
    """Return -(P (A + B K) + (A + B K)'P) (n, n). If P and this matrix are positive definite, A + B K is Hurwitz."""
    rate = f.P @ (f.A + f.B @ f.K)
    return -(rate + rate.T)


def coupling_matrix(f: Feedback) -> Any:
    """Return the matrix W = P B R_e^-1 B'P (n, n) in inequalities (14) and (15)."""
    reach = f.P @ f.B
    return reach @ f.Re_inverse @ reach.T


def inequality_matrix(f: Feedback) -> Any:
    """Return minus the left side of (14), a matrix (n, n) that is positive definite if (14) holds."""
    return lyapunov_matrix(f) - coupling_matrix(f) - f.Qe


def dissipation_matrix(o: Observer) -> Any:
    """Return the matrix P_eta Pi P_eta = Q_eta + P_eta C'R^-1 C P_eta (k, k)."""
    across = o.P @ o.C.T
    return o.Q + across @ o.R_inverse @ across.T


def observer_lyapunov_matrix(o: Observer) -> Any:
    """Return the matrix -((A_eta - L C) P_eta + P_eta (A_eta - L C)') (k, k) of the filter's Lyapunov inequality.

    For the steady P_eta and L, the result equals `dissipation_matrix`.
    """
    rate = (o.A - o.L @ o.C) @ o.P
    return -(rate + rate.T)


def weighted_matrix(f: Feedback, o: Observer, weight: Any) -> Any:
    """Return the matrix z(weight) (n + k, n + k) of the corrected inequality (15)."""
    return _block_matrix(f.Qe, coupling_matrix(f)[:, o.at] @ o.P / 2, weight * dissipation_matrix(o))


def decrease_matrix(f: Feedback, o: Observer, weight: Any, robust: Any = 0) -> Any:
    """Return the matrix (n + k, n + k) of the quadratic form -dV/dt in (e, w), for the gain K + robust R_e^-1 B'P.

    Args:
        f: the feedback.
        o: the observer.
        weight: weight of the observer's part of V.
        robust: factor of the robust term u_h: 0 for no term, +1/2 as published, -1/2 with reversed sign.
    """
    whole = f._replace(K=f.K + robust * (f.Re_inverse @ f.B.T @ f.P))
    across = (f.P @ f.B @ whole.K)[:, o.at] @ o.P / 2
    return _block_matrix(lyapunov_matrix(whole) / 2, across, weight * observer_lyapunov_matrix(o))


def least_weight(f: Feedback, o: Observer) -> float:
    """Return lambda*, the largest generalised eigenvalue of (E'W Q_e^-1 W E/4, Pi). The matrix z(weight) is positive
    definite for every weight above lambda*."""
    return _least_block_weight(weighted_matrix(f, o, 1.0), len(f.A))


def least_decrease_weight(f: Feedback, o: Observer, robust: float = 0.0) -> float:
    """Return the weight above which `decrease_matrix` is positive definite, so that V falls. The weight is infinite if
    the feedback without an observer can't be proved stable."""
    return _least_block_weight(decrease_matrix(f, o, 1.0, robust), len(f.A))


def printed_inequality(f: Feedback, o: Observer) -> Any:
    """Return the matrix of (15) as printed in [1] (k + m, k + m), in the only reading in which the shapes fit.

    The matrix is [-2 sqrt(Q_e Pi), P B; B'P, -R_e] with Q_e and P B reduced to the estimated states. (15) holds if the
    matrix is negative definite. The function only serves for comparison with the publication: the matrix contains the
    symmetric part of the square root of a non-symmetric product, and lacks the weight.
    """
    inner = np.linalg.inv(o.P)
    Pi = inner @ dissipation_matrix(o) @ inner
    root = np.real(sqrtm(f.Qe[np.ix_(o.at, o.at)] @ Pi))
    reach = (f.P @ f.B)[o.at]
    return np.block([[-(root + root.T), reach], [reach.T, -np.linalg.inv(f.Re_inverse)]])


def _least_block_weight(M: Any, n: int) -> float:
    """Return the least w for which [a, S; S', w b] is positive semidefinite: the largest generalised eigenvalue of
    (S'a^-1 S, b)."""
    size = np.sqrt(np.abs(np.diag(M)))
    scaled = M / np.where(size > 0, np.outer(size, size), 1.0)
    a, S, b = scaled[:n, :n], scaled[:n, n:], scaled[n:, n:]
    if np.linalg.eigvalsh(a)[0] <= 0:
        return float("inf")
    lowest = float(np.linalg.eigvalsh(b)[0])
    if lowest <= 0:
        problem = f"the scaled observer matrix has the eigenvalue {lowest:.3g}, and must be positive definite"
        raise InputError(
            "composite.weight", problem, fix="give every estimated state process noise, and compute P_eta again"
        )
    values: Any = eigh(S.T @ np.linalg.solve(a, S), b, eigvals_only=True)
    return float(values[-1])


def _block_matrix(a: Any, across: Any, b: Any) -> Any:
    return np.vstack([np.hstack([a, across]), np.hstack([across.T, b])])
