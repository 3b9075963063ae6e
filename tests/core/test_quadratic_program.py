"""Random programs against Clarabel, an interior-point solver: plain, degenerate, infeasible; and known ones."""

from functools import cache, partial

import jax
import numpy as np
import pytest
from scipy.sparse import csc_matrix, triu

import trimtab
from trimtab.core.quadratic_program import QuadraticProgram, QuadraticStart, first_start, solve_quadratic_program

TOLERANCE = 1e-6
INFINITE = np.inf


def draw_program(rng, n, m, kind):
    """A random program. Its bounds hold at a random point, except where there must be no solution."""
    rank = int(rng.integers(1, n + 1)) if kind == "degenerate" else n
    B = rng.normal(size=(n, rank))
    P = B @ B.T * 10 ** rng.uniform(-2, 2) + (0.0 if kind == "degenerate" else 1e-2) * np.eye(n)
    A = rng.normal(size=(m, n))
    A[:n] = np.eye(n)
    if kind == "degenerate":  # a row twice, and one that is the sum of two others
        A[-1], A[-4] = A[-2], A[-5] + A[-6]
    z = A @ rng.normal(size=n)
    l, u = z - rng.exponential(1, m), z + rng.exponential(1, m)
    if kind == "degenerate":
        for k in (-3, -4, n):
            l[k] = u[k] = z[k]
        l[-1], u[-1], l[n + 1] = l[-2], u[-2], -INFINITE
    if kind == "infeasible":
        A[-1] = A[-2] + A[-3]
        l[-1] = u[-2] + u[-3] + rng.uniform(0.1, 1)
        u[-1] = l[-1] + 1
    return QuadraticProgram(P, rng.normal(size=n) * 10 ** rng.uniform(-1, 1), A, l, u)


def solve_by_clarabel(p):
    """x, the sum of its multipliers, and whether it says solved."""
    clarabel = pytest.importorskip("clarabel")
    high, low = np.isfinite(p.u), np.isfinite(p.l)
    G, h = np.vstack([p.A[high], -p.A[low]]), np.concatenate([p.u[high], -p.l[low]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.NonnegativeConeT(len(h))]
    P = triu(csc_matrix(p.P)).tocsc()
    found = clarabel.DefaultSolver(P, p.q, csc_matrix(G), h, cones, settings).solve()
    return np.array(found.x), np.abs(found.z).sum(), "Solved" in str(found.status)


@cache
def compiled(n, m, rounds, iterations):
    solve = partial(solve_quadratic_program, rounds=rounds, iterations=iterations, tolerance=TOLERANCE)
    example = draw_program(np.random.default_rng(0), n, m, "plain")
    return trimtab.compile(lambda p, start: solve(p, start), example, start_of(n, m))


def start_of(n, m):
    return jax.tree.map(np.asarray, first_start(n, m))


def objective(p, x):
    return x @ p.P @ x / 2 + p.q @ x


def bound(p, ours, x, forces):
    """Of the difference of two objectives, by convexity: what the residuals leave open, and Clarabel's own 1e-8."""
    open_ends = max(np.abs(ours.y).sum(), forces) * ours.primal + ours.dual * np.abs(ours.x - x).sum()
    return open_ends + 1e-7 * (1 + abs(objective(p, x)) + forces)


def compare(kind, n, m, count, seed):
    """Shares of solved and of infeasible programs among those that Clarabel solves; each solution is checked."""
    rng, solve = np.random.default_rng(seed), compiled(n, m, 40, 50)
    solved, infeasible, known = 0, 0, 0
    for _ in range(count):
        p = draw_program(rng, n, m, kind)
        ours = solve(p, start_of(n, m))
        x, forces, has_solution = solve_by_clarabel(p)
        known += has_solution
        assert np.isfinite(ours.x).all()
        assert not (ours.solved and not has_solution)
        assert not (ours.infeasible and has_solution)
        solved, infeasible = solved + bool(ours.solved), infeasible + bool(ours.infeasible)
        if ours.solved:
            apart = abs(objective(p, ours.x) - objective(p, x))
            assert apart <= bound(p, ours, x, forces)
            if kind == "plain":  # then |x - x'|^2 is at most twice that over the least eigenvalue
                far = np.sum((ours.x - x) ** 2) * np.linalg.eigvalsh(p.P)[0] / 2
                assert far <= bound(p, ours, x, forces)
    print(f"{kind}, {n} by {m}: {solved} of {count} solved, {infeasible} proven to have no solution")
    return known / count, solved / count, infeasible / count


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "wanted"), [("plain", (1, 0.99, 0)), ("degenerate", (1, 0.95, 0))])
def test_feasible_programs_match_clarabel(kind, wanted):
    known, solved, infeasible = compare(kind, 8, 20, 300, 1)
    assert known == wanted[0]
    assert solved >= wanted[1]
    assert infeasible == wanted[2]


@pytest.mark.thorough
def test_infeasible_programs_are_detected_without_exception():
    known, solved, infeasible = compare("infeasible", 8, 20, 300, 2)
    assert known == solved == 0
    assert infeasible >= 0.95


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("n", "m"), [(3, 9), (8, 20), (26, 52)])
def test_thousands_of_programs_match_clarabel(n, m):
    count = 1000 if n < 20 else 500
    assert compare("plain", n, m, count, 3)[1] >= 0.99
    assert compare("degenerate", n, m, count, 4)[1] >= 0.9
    assert compare("infeasible", n, m, count, 5)[2] >= 0.95


@pytest.mark.thorough
def test_solves_example_of_nocedal_and_wright():
    """Nocedal & Wright, "Numerical optimization", example 16.4: x = (1.4, 1.7)."""
    A = np.array([[1.0, -2], [-1, -2], [-1, 2], [1, 0], [0, 1]])
    p = QuadraticProgram(2 * np.eye(2), np.array([-2.0, -5]), A, np.array([-2.0, -6, -2, 0, 0]), np.full(5, np.inf))
    found = solve_quadratic_program(p, first_start(2, 5), rounds=5, iterations=50, tolerance=TOLERANCE)
    assert found.solved
    np.testing.assert_allclose(found.x, [1.4, 1.7], atol=1e-6)
    np.testing.assert_allclose(found.y, [-0.8, 0, 0, 0, 0], atol=1e-5)


@pytest.mark.thorough
def test_start_near_the_solution_needs_fewer_iterations():
    p = draw_program(np.random.default_rng(7), 8, 20, "plain")
    far = compiled(8, 20, 40, 50)(p, start_of(8, 20))
    start = QuadraticStart(far.x, far.y, far.rho)
    few = compiled(8, 20, 1, 5)
    assert few(p, start).solved
    assert not few(p, start_of(8, 20)).solved


def test_invalid_program_is_unsolved_without_exception():
    p = draw_program(np.random.default_rng(8), 8, 20, "plain")
    for broken in (p._replace(P=-p.P), p._replace(q=p.q * np.nan), p._replace(l=p.u, u=p.l)):
        found = compiled(8, 20, 40, 50)(broken, start_of(8, 20))
        assert not found.solved
        assert not found.infeasible or broken.l is p.u


@pytest.mark.thorough
def test_unconverged_program_is_not_reported_infeasible():
    rng = np.random.default_rng(9)
    for _ in range(200):
        found = compiled(8, 20, 1, 5)(draw_program(rng, 8, 20, "plain"), start_of(8, 20))
        assert not found.infeasible
