"""State feedback by the linear quadratic regulator, and its dual, the steady Kalman-Bucy filter.

Both are computed in scaled states. This code runs offline and uses LAPACK and scipy.

Source: [1] B. D. O. Anderson, J. B. Moore, "Optimal control: linear quadratic methods", Prentice Hall 1990, chapters 2,
3; [2] W. F. Arnold, A. J. Laub, "Generalized eigenproblem algorithms and software for algebraic Riccati equations",
Proc. IEEE 72 (1984), for the solver and the need to scale; [3] D. L. Kleinman, "On an iterative technique for Riccati
equation computations", IEEE Trans. AC-13 (1968).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_continuous_are, solve_continuous_lyapunov, solve_triangular

from trimtab.core.errors import InputError, argument
from trimtab.design import exact
from trimtab.design.poles import format_pole, sorted_poles, uncontrollable_poles

AXIS = 1e-9
"""Largest real part of a pole that counts as zero, as a fraction of the largest entry of the scaled A."""
EXACT = 1e-11
"""Relative residual of the Riccati equation at which Newton's method stops."""
RESIDUAL_MAX = 1e-9
"""Largest relative residual of the Riccati equation at which a gain is accepted."""
BESIDE_WEIGHT = 3e-10
"""Residual of the Riccati equation, as a fraction of Q, above which Newton's method makes one last step with an exact
residual. In long chains of integrators the other terms of the equation are millions of times larger than Q, but a
certificate compares the residual with Q."""
STEPS_MAX = 8
"""Largest number of steps of Newton's method [3]."""
SEEN = 1e-12
"""Smallest eigenvalue of Q, scaled to a unit diagonal, that counts as positive."""


class Lqr(NamedTuple):
    """Regulator v = +K e that minimises the integral of e'Q e + v'R v.

    K: (m, n), -R^-1 B'P, sign included.  P: (n, n); e'P e is the cost of a motion that starts at e.  poles: poles of
    A + B K (n,), by falling real part.  residual: largest entry of A'P + P A - P B R^-1 B'P + Q in scaled states,
    relative to the largest term.
    """

    K: Any
    P: Any
    poles: Any
    residual: float


class KalmanBucy(NamedTuple):
    """Filter x^' = A x^ + L (y - C x^) with the smallest steady covariance.

    L: (n, p), P C'R^-1.  P: (n, n) steady covariance.  poles: poles of A - L C (n,).  residual: relative residual of
    the Riccati equation, as in `Lqr`.
    """

    L: Any
    P: Any
    poles: Any
    residual: float


def lqr(A: Any, B: Any, Q: Any, R: Any, *, scale: Any = None) -> Lqr:
    """Compute the gain K of v = +K e, from the algebraic Riccati equation.

    Args:
        A: (n, n).
        B: (n, m).
        Q: weight of the states (n, n), positive semidefinite.
        R: weight of the inputs (m, m), positive definite.
        scale: sizes of the states (n,), in units of which the equation is solved. Default: 1/sqrt of Q's diagonal, and
            1 where the diagonal is zero.

    Source: [1] chapters 2, 3.
    """
    A, B, Q, R = check_matrices("lqr", A, B, Q, R)
    d = state_sizes("lqr.scale", scale, Q)
    root = cholesky(R, lower=True)
    As, Bs, Qs = A * d / d[:, None], solve_triangular(root, (B / d[:, None]).T, lower=True).T, Q * np.outer(d, d)
    _refuse_pair(
        "lqr",
        "no input moves",
        As,
        Bs,
        (
            "add an input, leave out the state of this pole, or choose a point at which an input "
            f"acts: {argument('at', 'NAME=VALUE')}"
        ),
    )
    unseen = "give a weight in Q to a state that this pole moves"
    _refuse_pair("lqr", "the weight Q is zero for the motion of", As.T, _weight_columns(Qs), unseen)
    X, residual = _solve_riccati(As, Bs, Qs, (np.ones(len(d)), 1 / d))
    P = X / np.outer(d, d)
    K = -np.linalg.solve(R, B.T @ P)
    poles = sorted_poles(As + (B / d[:, None]) @ (K * d))
    if not residual <= RESIDUAL_MAX or poles[0].real >= 0:
        problem = f"no stabilising solution was found: residual {residual:.3g}, rightmost pole {format_pole(poles[0])}"
        raise InputError("lqr", problem, fix="choose another `scale` of the states, or change Q or R")
    return Lqr(K, P, poles, residual)


def _solve_riccati(A: Any, B: Any, Q: Any, sizes: tuple[Any, ...]) -> tuple[Any, float]:
    """Return P of the scaled Riccati equation with R = I, and its relative residual.

    The equation is solved in several scalings of the states, until the residual is small. Newton's method [3] improves
    each solution. The residual is infinite if no stabilising solution is found.
    """
    best, least = np.zeros_like(Q), float("inf")
    for d in sizes:
        a, b, q = A * d / d[:, None], B / d[:, None], Q * np.outer(d, d)
        try:
            with np.errstate(invalid="ignore"):  # SciPy's balancing overflows a 64-bit integer
                X = solve_continuous_are(a, b, q, np.eye(b.shape[1]))
        except (np.linalg.LinAlgError, ValueError):
            continue
        for _ in range(STEPS_MAX):
            P = (X + X.T) / 2 / np.outer(d, d)
            closed = a - b @ (b.T @ X)
            if not (np.isfinite(X).all() and np.linalg.eigvals(closed).real.max() < 0):
                break
            residual = _riccati_residual(A, B, Q, P)
            if residual >= least:
                break
            best, least = P, residual
            if least <= EXACT:
                return _refine_beside_weight(A, B, Q, best, least)
            gain = b.T @ X
            X = solve_continuous_lyapunov(closed.T, -(q + gain.T @ gain))
            X = (X + X.T) / 2
    return best, least


def _refine_beside_weight(A: Any, B: Any, Q: Any, P: Any, residual: float) -> tuple[Any, float]:
    """Return P after a step of Newton's method with an exact residual, and the relative residual.

    P is returned unchanged if its residual is already small compared with Q.
    """
    limit = BESIDE_WEIGHT * np.abs(Q).max()
    if np.abs(_riccati_sum(A, B, Q, P)).max() <= limit:
        return P, residual
    off = np.array(_riccati_sum(*(exact.as_fractions(M) for M in (A, B, Q, P))), float)
    step = solve_continuous_lyapunov((A - B @ (B.T @ P)).T, -off)
    better = P + (step + step.T) / 2
    return better, _riccati_residual(A, B, Q, better)


def _riccati_sum(A: Any, B: Any, Q: Any, P: Any) -> Any:
    return A.T @ P + P @ A - (P @ B) @ (B.T @ P) + Q


def _riccati_residual(A: Any, B: Any, Q: Any, P: Any) -> float:
    terms = (A.T @ P, P @ A, -(P @ B) @ (B.T @ P), Q)
    return float(np.abs(sum(terms)).max() / max(np.abs(t).max() for t in terms))


def _weight_columns(Q: Any) -> Any:
    """Return H (n, k) with H H' = Q, without columns for directions of zero weight."""
    d = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))
    values, vectors = np.linalg.eigh(Q / np.outer(d, d))
    seen = values > SEEN * max(values[-1], 0.0)
    return d[:, None] * vectors[:, seen] * np.sqrt(values[seen])


def kalman_bucy(A: Any, C: Any, Q: Any, R: Any, *, scale: Any = None) -> KalmanBucy:
    """Compute the steady filter of x' = A x + w, y = C x + n, as the dual of the regulator.

    Args:
        A: (n, n).
        C: (p, n).
        Q: density of the process noise w (n, n).
        R: density of the measurement noise n (p, p).
        scale: sizes of the states (n,); default: 1.

    Source: [1] chapter 7, duality.
    """
    d = np.ones(len(np.atleast_2d(Q))) if scale is None else np.asarray(scale, float)
    dual = lqr(np.asarray(A, float).T, np.atleast_2d(np.asarray(C, float)).T, Q, R, scale=1 / d)
    return KalmanBucy(-dual.K.T, dual.P, dual.poles, dual.residual)


def augment_integrals(A: Any, B: Any, rows: Any) -> tuple[Any, Any]:
    """Return A (n + k, n + k) and B (n + k, m) after the integrals of the k states with the indices `rows` are appended
    to the states."""
    A, B, rows = np.asarray(A, float), np.asarray(B, float), np.asarray(rows, int)
    n, k = len(A), len(rows)
    longer, wider = np.zeros((n + k, n + k)), np.zeros((n + k, B.shape[1]))
    longer[:n, :n], wider[:n] = A, B
    longer[n + np.arange(k), rows] = 1.0
    return longer, wider


def check_matrices(part: str, A: Any, B: Any, Q: Any, R: Any) -> tuple[Any, Any, Any, Any]:
    """Return the matrices as floats; raise InputError if a shape is wrong, an entry is not finite, Q or R is not
    symmetric, or R is not positive definite."""
    A, B, Q, R = (np.atleast_2d(np.asarray(M, float)) for M in (A, B, Q, R))
    n, m = len(A), B.shape[1]
    for name, M, shape in (("A", A, (n, n)), ("B", B, (n, m)), ("Q", Q, (n, n)), ("R", R, (m, m))):
        if M.shape != shape:
            raise InputError(f"{part}.{name}", f"must have shape {shape}, got {M.shape}", fix=f"give {shape}")
        bad = np.argwhere(~np.isfinite(M))
        if len(bad):
            i, j = bad[0].tolist()
            raise InputError(
                f"{part}.{name}", f"entry [{i}, {j}] must be finite, got {M[i, j]}", fix="give finite numbers"
            )
    for name, M, least in (("Q", Q, -1e-12), ("R", R, 0.0)):
        if not np.allclose(M, M.T, rtol=1e-12, atol=0):
            raise InputError(
                f"{part}.{name}",
                f"must be symmetric; entries differ by up to {np.abs(M - M.T).max():.3g}",
                fix="give (M + M')/2",
            )
        lowest = float(np.linalg.eigvalsh(M)[0])
        if lowest < least * np.abs(M).max() or (name == "R" and lowest <= 0):
            raise InputError(
                f"{part}.{name}",
                f"must be positive definite; smallest eigenvalue {lowest:.6g}",
                fix="give every input a positive weight",
            )
    return A, B, Q, R


def state_sizes(part: str, scale: Any, Q: Any) -> Any:
    """Return the sizes of the states (n,): the given sizes, or 1/sqrt of Q's diagonal by default."""
    if scale is None:
        weight = np.diag(Q)
        return 1 / np.sqrt(np.where(weight > 0, weight, 1.0))
    d = np.asarray(scale, float)
    if d.shape != (len(Q),) or not (np.isfinite(d) & (d > 0)).all():
        raise InputError(part, f"must be {len(Q)} finite sizes above 0, got {d}", fix="give one size for each state")
    return d


def _refuse_pair(part: str, what: str, A: Any, B: Any, fix: str) -> None:
    edge = -AXIS * max(np.abs(A).max(initial=0.0), np.finfo(float).tiny)
    for pole in uncontrollable_poles(A, B):
        if pole.real >= edge:
            raise InputError(part, f"{what} the pole {format_pole(pole)}", fix=fix)
