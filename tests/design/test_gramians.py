"""Gramians against Lyapunov's equation and by hand, and the weakest direction in words."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from trimtab.core.errors import InputError
from trimtab.design.gramians import find_gramians, integrate_gramian
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions


def linear(A, B, C, states):
    A, B, C = (np.array(M, float) for M in (A, B, C))
    return linearise(model_of_functions(lambda x, u: A @ x + B @ u, states, ("u",), h=lambda x, u: C @ x))


def test_long_horizon_gramian_solves_lyapunov_equation():
    A = np.array([[-1.0, 3.0, 0], [-2, -0.7, 1], [0, 0.5, -4]])
    B = np.array([[1.0], [0.3], [-2]])
    np.testing.assert_allclose(integrate_gramian(A, B, 60.0), solve_continuous_lyapunov(A, -B @ B.T), rtol=1e-10)


def test_double_integrator_gramian_matches_analytic_value():
    T = 3.0
    W = integrate_gramian(np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]), T)
    np.testing.assert_allclose(W, [[T**3 / 3, T**2 / 2], [T**2 / 2, T]], rtol=1e-12)


def test_reports_uncontrollable_and_unobservable_states():
    found = find_gramians(linear([[-1, 0], [0, -2]], [[1], [0]], [[0, 1]], ("moved", "seen")), 2.0)
    assert (found.hardly_moved.words, found.hardly_seen.words) == ("seen", "moved")
    assert found.hardly_moved.size == 0
    found = find_gramians(linear([[-1, 1], [0, -2]], [[0], [1]], [[1, 0]], ("a", "b")), 2.0)
    assert found.hardly_moved.size > 1e-3


def test_rejects_zero_time():
    with pytest.raises(InputError, match="above 0"):
        find_gramians(linear([[-1]], [[1]], [[1]], ("a",)), 0.0)
