"""State feedback from a linear matrix inequality, with the least bound on the closed loop's covariance.

Find P > 0 and K with

    P (A + B K) + (A + B K)'P + P B R_e^-1 B'P + Q_e + 2 decay P < 0                                       [1, eq. 14]

The substitution X = P^-1, Y = K X makes the inequality linear:

    [A X + X A' + B Y + Y'B' + B R_e^-1 B' + 2 decay X, X; X, -Q_e^-1] < 0         X > 0

Of all solutions, the one with the least tr(Q_e X) + tr(R_e Y X^-1 Y') is chosen; otherwise the gain would be arbitrary.
Clarabel, from the extra `design`, solves the problem in scaled states and in inputs for which R_e = I. The inequalities
are given as functions. These functions are affine, so that their values at zero and at the unit vectors define them.
This code runs offline and uses LAPACK and Clarabel.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206; [2] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, "Linear matrix inequalities
in system and control theory", SIAM 1994, sections 7.2, 7.4; [3] P. J. Goulart, Y. Chen, "Clarabel: an interior-point
solver for conic programs with quadratic objectives", arXiv 2405.12762, 2024; cone of positive semidefinite triangles as
in its manual.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csc_matrix

from trimtab.core.errors import InputError, install_command
from trimtab.design.lqr import check_matrices, state_sizes
from trimtab.design.poles import format_pole, sorted_poles, uncontrollable_poles

STRICT = 1e-7
"""Smallest eigenvalue accepted for X, and for the negative left side of the scaled inequality in X and Y."""
STATES_SOLVED = 8
"""Length of the longest chain of integrators for which the solver finds a gain, as shown by a test."""
MatrixBlock = Callable[[Any], Any]
"""Affine function from variables (k,) to a symmetric matrix that must be positive semidefinite."""


class LmiGain(NamedTuple):
    """Gain K of v = +K e, from a linear matrix inequality.

    K: (m, n).  P: (n, n), the solution of the inequality.  poles: poles of A + B K (n,), by falling real part.  margin:
    smallest eigenvalue of minus the inequality's left side, in the scaled X, Y.  least: smallest eigenvalue of the
    scaled X.  objective: minimised value.  status: the solver's status.
    """

    K: Any
    P: Any
    poles: Any
    margin: float
    least: float
    objective: float
    status: str


class SemidefiniteSolution(NamedTuple):
    """Solution of a semidefinite program.

    x: variables (k,).  status: the solver's status, e.g. "Solved", "PrimalInfeasible".  objective: value at x.
    margins: smallest eigenvalue of each block at x.
    """

    x: Any
    status: str
    objective: float
    margins: tuple[float, ...]

    @property
    def is_solved(self) -> bool:
        """Return True if the solver reports a solution, to its full or to its reduced tolerance."""
        return self.status in ("Solved", "AlmostSolved")


def lmi_gain(A: Any, B: Any, Qe: Any, Re: Any, *, scale: Any = None, decay: float = 0.0) -> LmiGain:
    """Return the gain K of v = +K e, and the P that proves stability. Raise InputError with the reasons on failure.

    Args:
        A: (n, n).
        B: (n, m).
        Qe: weight in the inequality (n, n), positive definite.
        Re: weight of the inputs (m, m), positive definite.
        scale: sizes of the states (n,); default: 1/sqrt of Qe's diagonal.
        decay: required decay rate (1/s); errors decay faster than exp(-decay t).

    Source: [1] eq. 14, as a scaled semidefinite program.
    """
    A, B, Qe, Re = check_matrices("lmi_gain", A, B, Qe, Re)
    d = state_sizes("lmi_gain.scale", scale, Qe)
    if not (np.isfinite(decay) and decay >= 0):
        raise InputError("lmi_gain.decay", f"must be at least 0 1/s, got {decay}", fix="decay=0.0")
    Qs = Qe * np.outer(d, d)
    lowest = float(np.linalg.eigvalsh(Qs)[0])
    if lowest <= 0:
        problem = f"must be positive definite; the smallest scaled eigenvalue is {lowest:.6g}"
        raise InputError("lmi_gain.Qe", problem, fix="give a positive weight to every state")
    root = cholesky(Re, lower=True)
    As, Bs = A * d / d[:, None], solve_triangular(root, (B / d[:, None]).T, lower=True).T
    n, m = Bs.shape
    inequality, positive, cost = _inequality_blocks(As, Bs, Qs, decay)
    k = n * (n + 1) // 2 + m * n + m * (m + 1) // 2
    strict: list[MatrixBlock] = [lambda z, f=f: f(z) - STRICT * np.eye(len(f(z))) for f in (inequality, positive)]
    solution = minimise(lambda z: _objective(z, Qs, m), [*strict, cost], k)
    X, Y, _ = _unpack_variables(solution.x, n, m)
    stuck = _stuck_poles(As, Bs, decay)
    is_strict = solution.is_solved and min(solution.margins[:2]) > -STRICT
    if not (is_strict or stuck or "Infeasible" in solution.status):
        problem = f"the solver reported {solution.status} for {n} states and {m} inputs ({k} unknowns), which does"
        problem += f" not show if a gain exists. Chains of up to {STATES_SOLVED} integrators can be solved"
        fix = "use the method lqr, remove states, or choose the scale of the states"
        raise InputError("lmi_gain", problem, fix=fix)
    if not is_strict:
        fix = "add an input, or choose the scale of the states"
        if decay:
            fix = "choose a smaller decay, or add an input"
        raise InputError("lmi_gain", _explain_infeasibility(solution, strict, As, Bs, decay), fix=fix)
    inner = np.linalg.inv(X)
    inner = (inner + inner.T) / 2
    K = solve_triangular(root.T, Y @ inner) / d
    margin, least = (float(np.linalg.eigvalsh(f(solution.x))[0]) for f in (inequality, positive))
    poles = sorted_poles(As + (B / d[:, None]) @ (K * d))
    return LmiGain(K, inner / np.outer(d, d), poles, margin, least, solution.objective, solution.status)


def _inequality_blocks(A: Any, B: Any, Q: Any, decay: float) -> tuple[MatrixBlock, MatrixBlock, MatrixBlock]:
    """Return the scaled matrices that must be positive: minus the inequality's left side, X, and the bound of R Y X^-1
    Y'."""
    n, m = B.shape
    inner = np.linalg.inv(Q)

    def inequality(z: Any) -> Any:
        X, Y, _ = _unpack_variables(z, n, m)
        rate = A @ X + B @ Y + decay * X
        return -np.block([[rate + rate.T + B @ B.T, X], [X, -(inner + inner.T) / 2]])

    def cost(z: Any) -> Any:
        X, Y, Z = _unpack_variables(z, n, m)
        return np.block([[Z, Y], [Y.T, X]])

    return inequality, lambda z: _unpack_variables(z, n, m)[0], cost


def _unpack_variables(z: Any, n: int, m: int) -> tuple[Any, Any, Any]:
    """Return X (n, n), Y (m, n) and Z (m, m) from the variables."""
    a, b = n * (n + 1) // 2, m * n
    return symmetric_matrix(z[:a], n), z[a : a + b].reshape(m, n), symmetric_matrix(z[a + b :], m)


def _objective(z: Any, Q: Any, m: int) -> float:
    X, _, Z = _unpack_variables(z, len(Q), m)
    return float(np.sum(Q * X) + np.trace(Z))


def _stuck_poles(A: Any, B: Any, decay: float) -> list[Any]:
    """Return the poles that no input can move and that decay more slowly than `decay`."""
    return [p for p in uncontrollable_poles(A, B) if p.real >= -decay - 1e-9 * np.abs(A).max()]


def _explain_infeasibility(
    solution: SemidefiniteSolution, blocks: list[MatrixBlock], A: Any, B: Any, decay: float
) -> str:
    """Return the reasons for failure as text: poles that no input moves, and the violation of the inequality."""
    reasons = [f"the solver reported {solution.status}"]
    stuck = _stuck_poles(A, B, decay)
    if stuck:
        reasons.append("no input moves the poles " + ", ".join(format_pole(p) for p in stuck if p.imag >= 0))
    missing = least_violation(blocks, len(solution.x))
    if missing > 0:
        reasons.append(
            f"with the margin {STRICT:g}, the scaled inequalities (14) and X > 0 are violated by at least {missing:.3g}"
        )
    return "no gain satisfies the inequality: " + "; ".join(reasons)


def minimise(objective: Callable[[Any], Any], blocks: Sequence[MatrixBlock], k: int) -> SemidefiniteSolution:
    """Return the variables (k,) that minimise an affine objective while every block is positive semidefinite.

    Args:
        objective: (k,) -> number, affine.
        blocks: the matrix inequalities.
        k: number of variables.

    Source: [3].
    """
    clarabel = _import_solver()
    zero, units = np.zeros(k), np.eye(k)
    constant = float(objective(zero))
    q = np.array([float(objective(e)) - constant for e in units])
    rows, right, cones = [], [], []
    for block in blocks:
        base = _pack_triangle(block(zero))
        rows.append(np.column_stack([base - _pack_triangle(block(e)) for e in units]))
        right.append(base)
        cones.append(clarabel.PSDTriangleConeT(len(block(zero))))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    A = csc_matrix(np.vstack(rows))
    solution = clarabel.DefaultSolver(csc_matrix((k, k)), q, A, np.concatenate(right), cones, settings).solve()
    x = np.array(solution.x)
    finite = bool(np.isfinite(x).all())
    margins = tuple(float(np.linalg.eigvalsh(block(x))[0]) if finite else float("nan") for block in blocks)
    return SemidefiniteSolution(x, str(solution.status), float(q @ x + constant), margins)


def least_violation(blocks: Sequence[MatrixBlock], k: int) -> float:
    """Return the least t for which all blocks plus t I can be positive semidefinite.

    A value above 0 means that the inequalities have no solution. The search is bounded below by -1.
    """
    lifted: list[MatrixBlock] = [lambda z, f=f: f(z[:-1]) + z[-1] * np.eye(len(f(z[:-1]))) for f in blocks]
    return minimise(lambda z: z[-1], [*lifted, lambda z: np.array([[z[-1] + 1.0]])], k + 1).objective


def symmetric_matrix(values: Any, n: int) -> Any:
    """Return the symmetric matrix (n, n) whose upper triangle, row by row, is values (n (n + 1)/2,)."""
    upper = np.zeros((n, n))
    upper[np.triu_indices(n)] = values
    return upper + np.triu(upper, 1).T


def _pack_triangle(M: Any) -> Any:
    """Return the upper triangle by columns, with off-diagonal entries times sqrt 2, in Clarabel's format."""
    columns, rows, factors = _triangle_entries(len(M))
    return np.asarray(M)[columns, rows] * factors


@lru_cache(maxsize=32)
def _triangle_entries(n: int) -> tuple[Any, Any, Any]:
    rows, columns = np.tril_indices(n)
    return columns, rows, np.where(rows == columns, 1.0, np.sqrt(2.0))


def _import_solver() -> Any:
    try:
        import clarabel
    except ImportError as error:
        fix = f"{install_command('design')}, or use the method lqr, which needs no solver"
        raise InputError("design", "the solver Clarabel is not installed", fix=fix) from error
    return clarabel
