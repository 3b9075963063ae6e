"""Internal dynamics while an output follows its command: the exact noncausal solution, and a causal linear solution.

`bounded_solution` solves zeta' = Psi(t, zeta) if the linearisation has stable and unstable poles. Forward integration
would follow an unstable mode to infinity. In the bounded solution, stable modes depend on the past and unstable modes
on the future, so that the motion begins before its cause. Picard's iteration: with A = dPsi/dzeta at one point, solve

    zeta' = A zeta + w(t)        w = Psi(t, previous zeta) - A (previous zeta)

exactly for w piecewise linear: the stable part forward from the first instant, the unstable part backward from the last
instant. Repeat until zeta no longer changes. A position is a coordinate, e.g. north, that enters no derivative except
those of other positions. It is integrated forward from the first instant.

`solve_steady_response` computes the steady response X, X S = A X + G, of a linear system to a command from an
exosystem.

    omega' = S omega        zeta' = A zeta + G omega        zeta = X omega is the solution without transients

The steady response depends only on the present omega. Therefore it is causal, for any signs of the poles of A. This
code runs offline and uses LAPACK.

Source: [1] S. Devasia, D. Chen, B. Paden, "Nonlinear inversion-based output tracking", IEEE Transactions on Automatic
Control 41(7), 1996, section III; [2] B. A. Francis, "The linear multivariable regulator problem", SIAM Journal on
Control and Optimization 15(3), 1977; A. Isidori, "Nonlinear Control Systems", Springer 1995, section 8.4, for the use
of this equation in regulation.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm, schur, solve_sylvester

from trimtab.core.errors import InputError

ON_AXIS = 1e-9
"""Size of a pole's real part, relative to the largest pole, up to which the pole counts as on the imaginary axis."""
FADED = 1e-40
"""Size of the entries of a transition matrix below which higher powers of the matrix are ignored."""
GROWN = 1e3
"""Largest change in an iteration, relative to the first change, at which the iteration is continued."""
PLACE = 1e-12
"""Largest entry of the matrix A that counts as zero, as a fraction of the largest entry of A."""
POLE_DISTANCE_MIN = 1e-9
"""Distance, relative to the largest pole, up to which a pole of A and a pole of S count as equal."""


class BoundedSolution(NamedTuple):
    """Bounded solution of the internal dynamics.

    zeta: solution (n, k) on the grid.  rates: Psi, the derivative of zeta (n, k).  iterations: number of iterations.
    changes: largest change in each iteration, relative to the scales.  poles: poles of A without the positions,
    unstable poles last.  unstable: number of unstable poles.  places: indices of the positions.
    """

    zeta: Any
    rates: Any
    iterations: int
    changes: tuple[float, ...]
    poles: Any
    unstable: int
    places: tuple[int, ...] = ()


class _Split(NamedTuple):
    """Split of A into a stable and an unstable block. basis: (k, k), columns that span the two subspaces.  stable,
    unstable: the diagonal blocks of A in this basis.
    """

    basis: Any
    stable: Any
    unstable: Any


def bounded_solution(
    psi: Callable[[Any], Any],
    A: Any,
    start: Any,
    dt: float,
    *,
    left: Any,
    right: Any,
    scales: Any,
    tolerance: float = 1e-10,
    most: int = 30,
) -> BoundedSolution:
    """Compute the bounded solution on a uniform grid of n instants. For k = 0 internal coordinates, it is empty.

    Args:
        psi: function from zeta (n, k) on the whole grid to its time derivative (n, k); it includes all time dependence.
        A: dPsi/dzeta at any point of the motion (k, k), with no poles on the imaginary axis except those of
            `find_places`. The choice of the point changes the speed of convergence, not the solution.
        start: first guess (n, k), such as the quasi-static solution.
        dt: step of the grid (s).
        left: zeta (k,) at the first instant. Only the part of zeta in stable modes is used.
        right: zeta (k,) at the last instant. Only the part of zeta in unstable modes is used.
        scales: (k,), natural size of each coordinate.
        tolerance: the iteration ends when no coordinate changes by more than this fraction of its scale.
        most: maximum number of iterations.

    Source: [1] section III; the exponential integration is exact for w piecewise linear.
    """
    A, guess, scales = np.asarray(A, float), np.asarray(start, float), np.asarray(scales, float)
    if not A.size:
        return BoundedSolution(guess, guess, 0, (), np.zeros(0), 0)
    _check_arguments(A, guess, dt, scales, left, right)
    scaled = A * scales / scales[:, None]
    places = find_places(scaled)
    rest = np.setdiff1d(np.arange(len(A)), places)
    inner = scaled[np.ix_(rest, rest)]
    split = _split_subspaces(inner)
    ends = [np.linalg.solve(split.basis, (np.asarray(end, float) / scales)[rest]) for end in (left, right)]
    zeta, changes = guess / scales, []
    for _ in range(most):
        rates = np.asarray(psi(zeta * scales)) / scales
        new = np.empty_like(zeta)
        new[:, rest] = _solve_linear(split, rates[:, rest] - zeta[:, rest] @ inner.T, dt, *ends)
        new[:, places] = np.asarray(left)[list(places)] / scales[list(places)] + _integrate(rates[:, places], dt)
        changes.append(float(np.abs(new - zeta).max()))
        zeta = new
        if not np.isfinite(changes[-1]) or changes[-1] > GROWN * max(changes[0], 1.0):
            break
        if changes[-1] < tolerance * max(1.0, np.abs(zeta).max()):
            poles = np.concatenate([np.linalg.eigvals(split.stable), np.linalg.eigvals(split.unstable)])
            rates, count = np.asarray(psi(zeta * scales)), len(split.unstable)
            return BoundedSolution(zeta * scales, rates, len(changes), tuple(changes), poles, count, places)
    text = ", ".join(f"{c:.2g}" for c in changes)
    problem = (
        f"the iteration does not converge to {tolerance:g}; "
        f"largest change in each iteration, relative to the scales: {text}"
    )
    fix = "make the command slower or smaller, evaluate A along the motion, or give a better start"
    raise InputError("bounded_solution", problem, fix=fix)


def find_places(A: Any) -> tuple[int, ...]:
    """Return the indices of positions: coordinates, e.g. north, that enter no derivatives except those of positions."""
    size = np.abs(np.asarray(A, float))
    size = size > PLACE * max(size.max(initial=0.0), np.finfo(float).tiny)
    places: list[int] = []
    while True:
        kept = [i for i in range(len(size)) if i not in places]
        more = [i for i in kept if not size[kept, i].any()]
        if not more:
            return tuple(sorted(places))
        places += more


def _integrate(rates: Any, dt: float) -> Any:
    """Return the integral of `rates` (n, k) from the first instant to each instant, by cubic splines."""
    times = dt * np.arange(len(rates))
    return CubicSpline(times, rates).antiderivative()(times) if rates.shape[1] else rates


def bounded_residual(solution: BoundedSolution, dt: float) -> Any:
    """Return the central differences of zeta minus Psi (n - 2, k), as an independent check of the solution."""
    return (solution.zeta[2:] - solution.zeta[:-2]) / (2 * dt) - solution.rates[1:-1]


def _check_arguments(A: Any, guess: Any, dt: float, scales: Any, left: Any, right: Any) -> None:
    k = len(scales)
    shapes = {"A": (A, (k, k)), "left": (left, (k,)), "right": (right, (k,)), "start": (guess, (*guess.shape[:1], k))}
    for name, (value, shape) in shapes.items():
        part = f"bounded_solution.{name}"
        if np.shape(value) != shape:
            problem = f"must have shape {shape}, got {np.shape(value)}"
            raise InputError(
                part, problem, fix=f"give an array of shape {shape}, because the length of `scales` is {k}"
            )
        if not np.isfinite(value).all():
            raise InputError(part, "must be finite", fix="give finite values")
    if len(guess) < 2 or not dt > 0:
        problem = f"must have at least 2 instants and dt above 0 s, got {len(guess)} and {dt:g} s"
        raise InputError("bounded_solution.dt", problem, fix="give e.g. dt=0.01")
    if not (scales > 0).all():
        raise InputError(
            "bounded_solution.scales",
            f"must be above 0, got {scales}",
            fix="give the natural size of each internal coordinate",
        )


def _split_subspaces(A: Any) -> _Split:
    """Split A into a stable and an unstable block; raise InputError if a pole lies on the imaginary axis."""
    if not len(A):
        return _Split(A, A, A)
    poles = np.linalg.eigvals(A)
    on = poles[np.abs(poles.real) <= ON_AXIS * np.abs(poles).max(initial=0.0)]
    if len(on):
        problem = f"A has poles on the imaginary axis: {', '.join(f'{p:.4g}' for p in on)}"
        raise InputError(
            "bounded_solution.A", problem, fix="choose other outputs, for which the bounded solution is unique"
        )
    ordered: Any = schur(A, output="real", sort="lhp")
    T, Z, k = ordered
    mixed = solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:]) if 0 < k < len(A) else T[:k, k:]
    shear = np.eye(len(A))
    shear[:k, k:] = mixed
    return _Split(Z @ shear, T[:k, :k], T[k:, k:])


def _solve_linear(split: _Split, w: Any, dt: float, left: Any, right: Any) -> Any:
    """Return the bounded solution of zeta' = A zeta + w for w (n, k) piecewise linear.

    left, right: boundary values, in the basis of the split.
    """
    k = len(split.stable)
    driven = np.linalg.solve(split.basis, w.T)
    stable = _propagate_linear(split.stable, driven[:k], dt, left[:k])
    unstable = _propagate_linear(-split.unstable, -driven[k:, ::-1], dt, right[k:])[:, ::-1]
    return (split.basis @ np.concatenate([stable, unstable])).T


def _propagate_linear(A: Any, w: Any, dt: float, z0: Any) -> Any:
    """Solve z' = A z + w (k, n) exactly from z0, for a stable A: z(j+1) = E z(j) + (p0 - p1) w(j) + p1 w(j+1)."""
    k = len(A)
    if not k:
        return w
    whole = np.zeros((3 * k, 3 * k))
    whole[:k, :k], whole[:k, k : 2 * k], whole[k : 2 * k, 2 * k :] = A * dt, np.eye(k) * dt, np.eye(k)
    E, p0, p1 = np.split(expm(whole)[:k], 3, axis=1)
    z = np.concatenate([np.asarray(z0)[:, None], (p0 - p1) @ w[:, :-1] + p1 @ w[:, 1:]], axis=1)
    reach = 1
    while reach < z.shape[1] and np.abs(E).max() > FADED:  # each pass sums over twice as many instants
        z[:, reach:] += E @ z[:, :-reach]
        E, reach = E @ E, 2 * reach
    return z


def solve_steady_response(A: Any, S: Any, G: Any) -> Any:
    """Return the matrix X (k, m) of the steady response zeta = X omega, with X S = A X + G.

    Args:
        A: matrix of the system (k, k).
        S: matrix of the exosystem (m, m), which must have no pole in common with A.
        G: input of the exosystem to the system (k, m).

    Source: [2].
    """
    A, S, G = (np.asarray(M, float) for M in (A, S, G))
    k, m = len(A), len(S)
    for name, M, shape in (("A", A, (k, k)), ("S", S, (m, m)), ("G", G, (k, m))):
        if M.shape != shape or not np.isfinite(M).all():
            problem = f"must be finite numbers of shape {shape}, got shape {M.shape}"
            raise InputError(f"following.{name}", problem, fix="give A (k, k), S (m, m), G (k, m)")
    inside, outside = np.linalg.eigvals(A), np.linalg.eigvals(S)
    gaps = np.abs(inside[:, None] - outside)
    i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
    if gaps[i, j] <= POLE_DISTANCE_MIN * max(np.abs(inside).max(), np.abs(outside).max()):
        problem = (
            f"the system's pole {inside[i]:.6g} is also a pole of the exosystem, so the response grows without bound"
        )
        raise InputError("following.S", problem, fix="choose other poles for the command's exosystem S")
    return solve_sylvester(A, -S, -G)


def exosystem_matrix(w: float, order: int) -> Any:
    """Return the matrix S (order, order) of an exosystem with the state (y - y_final, y', …). y is a step command after
    a filter with `order` equal poles at -w (rad/s)."""
    S = np.eye(order, k=1)
    S[-1] = [-float(math.comb(order, i)) * w ** (order - i) for i in range(order)]
    return S
