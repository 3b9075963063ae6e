"""Least squares between bounds, compiled, against scipy; unknowns fixed by equal bounds; and too few steps."""

import functools

import jax
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from trimtab.core.box_least_squares import solve_box_least_squares


@functools.cache
def solver(steps):
    return jax.jit(functools.partial(solve_box_least_squares, steps=steps))


def draw(rng, n):
    A, b = rng.normal(size=(n + 2, n)), rng.normal(size=n + 2) * 3
    low = rng.uniform(-1, 0, n)
    return A, b, low, low + rng.uniform(0.1, 1.5, n)


@pytest.mark.thorough
@pytest.mark.parametrize("n", [2, 4, 6, 8])
def test_solution_matches_scipy_lsq_linear(n):
    rng = np.random.default_rng(n)
    left_open = 0
    for _ in range(200):
        A, b, low, high = draw(rng, n)
        want = lsq_linear(A, b, (low, high), tol=1e-14).x
        found = solver(2 * n + 2)(A.T @ A, -A.T @ b, low, high, np.zeros(n))
        left_open += not found.solved
        if found.solved:
            np.testing.assert_allclose(found.x, want, atol=1e-6)
        assert ((found.x >= low) & (found.x <= high)).all(), "within bounds whether solved or not"
    assert left_open <= 2


def test_side_reports_the_active_bound():
    found = solver(8)(np.eye(3), np.array([-5.0, 5.0, 0.1]), np.full(3, -1.0), np.full(3, 1.0), np.zeros(3))
    np.testing.assert_array_equal(found.side, [1, -1, 0])
    np.testing.assert_allclose(found.x, [1, -1, -0.1])


@pytest.mark.thorough
def test_unknown_with_equal_bounds_is_fixed():
    low, high = np.array([0.0, -1.0]), np.array([0.0, 1.0])
    found = solver(6)(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-3.0, -1.0]), low, high, np.ones(2))
    np.testing.assert_allclose(found.x, [0, 0.5])
    assert found.solved


@pytest.mark.thorough
def test_too_few_steps_are_reported_as_unsolved():
    rng = np.random.default_rng(0)
    A, b, low, high = draw(rng, 8)
    assert not solver(1)(A.T @ A, -A.T @ b, low, high, np.zeros(8)).solved
