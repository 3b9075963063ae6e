"""Quadratic programs for flight code: a fixed number of plain operations with a warm start. Failures are reported as
signals.

    minimise  x.P x/2 + q.x    subject to  l <= A x <= u

Source: [1] B. Stellato, G. Banjac, P. Goulart, A. Bemporad, S. Boyd, "OSQP: an operator splitting solver for quadratic
programs", Mathematical Programming Computation 12 (2020) 637, sections 3.1, 3.4, 5.1 and 5.2.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from trimtab.core.linalg import inverse_spd

SIGMA, RELAXATION = 1e-6, 1.6
"""Regularisation sigma, which makes the linear system positive definite, and over-relaxation alpha. Source: [1],
algorithm 1."""
RHO_LOW, RHO_HIGH, RHO_EQUALITY = 1e-6, 1e6, 1e3
"""Minimum and maximum weight of a constraint, and factor between the weights of an equality and an inequality."""
RHO_CHANGE = 5.0
"""Smallest factor by which the weight of the constraints is changed [1, section 5.2]."""
EQUILIBRATIONS = 4
LOOSE = 1e20
"""Magnitude above which a bound counts as infinite."""


class ChangeRows(NamedTuple):
    """Constraint matrix A for a sequence x of successive moves, with `width` numbers per move. A is not stored as an
    array.

    A x contains the entries of x, then their changes from one move to the next. Products with A are computed by sums.
    """

    width: int

    def times(self, x: Any) -> Any:
        """Return A x (2n,)."""
        return jnp.concatenate([x, x - jnp.concatenate([jnp.zeros(self.width), x[: -self.width]])])

    def back(self, y: Any) -> Any:
        """Return A.T y (n,)."""
        here, change = jnp.split(y, 2)
        return here + change - self._later(change)

    def gram(self, weights: Any) -> Any:
        """Return A.T diag(weights) A (n, n)."""
        here, change = jnp.split(weights, 2)
        n, later = len(here), self._later(change)
        below = jnp.eye(n, k=self.width) * later[:, None]
        return jnp.eye(n) * (here + change + later)[:, None] - below - below.T

    def _later(self, change: Any) -> Any:
        return jnp.concatenate([change[self.width :], jnp.zeros(self.width)])


class _MatrixRows(NamedTuple):
    """Constraint matrix A (m, n) stored as an array."""

    matrix: Any

    def times(self, x: Any) -> Any:
        return self.matrix @ x

    def back(self, y: Any) -> Any:
        return self.matrix.T @ y

    def gram(self, weights: Any) -> Any:
        return (self.matrix.T * weights) @ self.matrix


class QuadraticProgram(NamedTuple):
    """Quadratic program: P (n, n) symmetric positive semidefinite, q (n,), A (m, n) or `ChangeRows`, l <= u (m,).

    An infinite l or u means no bound; l = u means an equality.
    """

    P: Any
    q: Any
    A: Any
    l: Any
    u: Any


class QuadraticStart(NamedTuple):
    """Start of the iteration: x (n,), multipliers y (m,) of A x, and weight rho of the constraints."""

    x: Any
    y: Any
    rho: Any


class QuadraticSolution(NamedTuple):
    """Solution x, y and rho, from which the next iteration can start, and the quality of this solution.

    primal: largest entry of A x - z, with z within the bounds, and at a bound where y is not zero. dual: largest entry
    of P x + q + A.T y. solved: True if primal and dual are within the tolerance, relative to the size of their terms
    [1, eqs. 34, 35]. infeasible: True if the last change of y proves, to a tolerance of 1e-4, that no x is within the
    bounds [1, eq. 37].
    """

    x: Any
    y: Any
    rho: Any
    primal: Any
    dual: Any
    solved: Any
    infeasible: Any


class _Iterate(NamedTuple):
    x: Any
    z: Any
    y: Any
    dy: Any


def first_start(n: int, m: int) -> QuadraticStart:
    """Return the start for a program without a known solution: zeros."""
    return QuadraticStart(jnp.zeros(n), jnp.zeros(m), jnp.asarray(0.1))


def solve_quadratic_program(
    given: QuadraticProgram, start: QuadraticStart, *, rounds: int, iterations: int, tolerance: float = 1e-3
) -> QuadraticSolution:
    """Return an approximate solution by the alternating direction method of multipliers [1], never an exception.

    Args:
        given: the program.
        start: solution of a similar program, or `first_start`.
        rounds: number of times that rho is adapted and the linear system is factorised.
        iterations: number of iterations in each round.
        tolerance: relative tolerance of the residuals of a solved program.
    """
    if isinstance(given.A, ChangeRows):  # the entries of A are 1 and -1, and need no scaling
        scaled, D, E = given, jnp.ones_like(given.q), jnp.ones_like(given.l)
    else:
        scaled, D, E = _equilibrate(given)
        scaled, given = scaled._replace(A=_MatrixRows(scaled.A)), given._replace(A=_MatrixRows(given.A))
    equality = given.u - given.l < 1e-12
    loose = (given.l <= -LOOSE) & (given.u >= LOOSE)
    x, y = start.x / D, start.y / E
    now = _Iterate(x, jnp.clip(scaled.A.times(x), scaled.l, scaled.u), y, jnp.zeros_like(y))

    def play_round(_: Any, carry: tuple[_Iterate, Any]) -> tuple[_Iterate, Any]:
        now, rho = carry
        weights = jnp.where(loose, RHO_LOW, jnp.where(equality, jnp.minimum(RHO_EQUALITY * rho, RHO_HIGH), rho))
        now = _iterate(scaled, now, weights, iterations)
        return now, _choose_rho(scaled, now, rho, tolerance / 1000)

    now, rho = jax.lax.fori_loop(0, rounds, play_round, (now, jnp.clip(start.rho, RHO_LOW, RHO_HIGH)))
    return _judge(given, _Iterate(D * now.x, now.z / E, E * now.y, E * now.dy), rho, tolerance)


def _equilibrate(given: QuadraticProgram) -> tuple[QuadraticProgram, Any, Any]:
    """Return the program with rows and columns of [[P, A.T], [A, 0]] scaled to one, and the scales [1, algorithm 2]."""
    P, A = given.P, given.A
    D, E = jnp.ones(P.shape[0]), jnp.ones(A.shape[0])
    for _ in range(EQUILIBRATIONS):
        column = jnp.maximum(jnp.max(jnp.abs(P), axis=0), jnp.max(jnp.abs(A), axis=0))
        row = jnp.max(jnp.abs(A), axis=1)
        d, e = 1 / jnp.sqrt(jnp.where(column > 0, column, 1.0)), 1 / jnp.sqrt(jnp.where(row > 0, row, 1.0))
        P, A, D, E = d[:, None] * P * d, e[:, None] * A * d, D * d, E * e
    return QuadraticProgram(P, D * given.q, A, E * given.l, E * given.u), D, E


def _iterate(p: QuadraticProgram, now: _Iterate, weights: Any, iterations: int) -> _Iterate:
    """Return the next iterate of [1, algorithm 1], with the linear system reduced to P + sigma I + A.T R A."""
    K = p.P + SIGMA * jnp.eye(p.P.shape[0]) + p.A.gram(weights)
    inverse = inverse_spd(K)

    def once(_: Any, now: _Iterate) -> _Iterate:
        xt = inverse @ (SIGMA * now.x - p.q + p.A.back(weights * now.z - now.y))
        zt = RELAXATION * p.A.times(xt) + (1 - RELAXATION) * now.z + now.y / weights
        z = jnp.clip(zt, p.l, p.u)
        y = weights * (zt - z)
        return _Iterate(RELAXATION * xt + (1 - RELAXATION) * now.x, z, y, y - now.y)

    return jax.lax.fori_loop(0, iterations, once, now)


def _choose_rho(p: QuadraticProgram, now: _Iterate, rho: Any, least: float) -> Any:
    """Return a rho with which the relative primal and dual residuals become equal [1, section 5.2].

    least: number that is added to both residuals, so that rho does not follow rounding errors.
    """
    Ax, Px, Aty = p.A.times(now.x), p.P @ now.x, p.A.back(now.y)
    primal = _size(Ax - now.z) / (jnp.maximum(_size(Ax), _size(now.z)) + 1e-10)
    dual = _size(Px + p.q + Aty) / (jnp.maximum(jnp.maximum(_size(Px), _size(Aty)), _size(p.q)) + 1e-10)
    factor = jnp.sqrt((primal + least) / (dual + least))
    worth = (factor > RHO_CHANGE) | (factor < 1 / RHO_CHANGE)
    return jnp.where(worth, jnp.clip(rho * factor, RHO_LOW, RHO_HIGH), rho)


def _judge(p: QuadraticProgram, now: _Iterate, rho: Any, tolerance: float) -> QuadraticSolution:
    x, z, y, dy = now
    Ax, Px, Aty = p.A.times(x), p.P @ x, p.A.back(y)
    primal = _size(Ax - z)
    dual = _size(Px + p.q + Aty)
    terms = jnp.maximum(jnp.maximum(_size(Px), _size(Aty)), _size(p.q))
    solved = (primal <= tolerance * (1 + jnp.maximum(_size(Ax), _size(z)))) & (dual <= tolerance * (1 + terms))
    size = _size(dy)
    up, down = jnp.maximum(dy, 0.0), jnp.minimum(dy, 0.0)
    has_high, has_low = p.u < LOOSE, p.l > -LOOSE
    support = jnp.sum(jnp.where(has_high, p.u * up, 0.0) + jnp.where(has_low, p.l * down, 0.0))
    small = 1e-4 * size
    one_sided = jnp.all((has_high | (up <= small)) & (has_low | (-down <= small)))
    proof = one_sided & (_size(p.A.back(dy)) <= small) & (support < -small)
    return QuadraticSolution(x, y, rho, primal, dual, solved, (size > 1e-10) & proof & ~solved)


def _size(vector: Any) -> Any:
    return jnp.max(jnp.abs(vector))
