"""X S = A X + G against closed forms, and poles that coincide."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.design.stable_inversion import exosystem_matrix, solve_steady_response


def test_a_sine_into_an_unstable_system():
    """z' = 2 z + sin t: the bounded solution is -(2 sin t + cos t)/5."""
    X = solve_steady_response([[2.0]], [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    np.testing.assert_allclose(X, [[-0.4, -0.2]], atol=1e-15)


def test_it_solves_the_equation_and_moves_as_the_system_does():
    draws = np.random.default_rng(4)
    A, G = draws.normal(size=(4, 4)), draws.normal(size=(4, 3))
    S = exosystem_matrix(0.7, 3)
    X = solve_steady_response(A, S, G)
    np.testing.assert_allclose(X @ S, A @ X + G, atol=1e-12)
    start = np.array([-1.0, 0.0, 0.0])
    together = solve_ivp(
        lambda t, z: np.concatenate([A @ z[:4] + G @ z[4:], S @ z[4:]]),
        (0, 1.5),
        np.append(X @ start, start),
        rtol=1e-11,
    ).y[:, -1]
    np.testing.assert_allclose(together[:4], X @ together[4:], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("order", [1, 3, 4])
def test_filter_matrix_has_its_poles_and_its_step_response(order):
    S = exosystem_matrix(0.06, order)
    np.testing.assert_allclose(np.poly(S), np.poly([-0.06] * order), rtol=1e-12)
    start = -np.eye(order)[0]
    a = 0.06 * 40
    factors = np.cumprod([1, *(a / np.arange(1, order))])
    ended = solve_ivp(lambda t, z: S @ z, (0, 40), start, rtol=1e-11, atol=1e-14).y[0, -1]
    np.testing.assert_allclose(ended, -np.exp(-a) * factors.sum(), rtol=1e-8)


@pytest.mark.parametrize(
    ("A", "S", "G", "text"),
    [
        ([[-1.0]], [[-1.0]], [[1.0]], "pole -1 is one of the exosystem's"),
        ([[-1.0]], [[0.0, 1.0]], [[1.0]], r"S: shape \(1, 2\)"),
        ([[-1.0]], [[0.0]], [[1.0, 2.0]], r"G: shape \(1, 2\)"),
        ([[np.nan]], [[0.0]], [[1.0]], "A: shape"),
    ],
)
def test_wrong_input_is_refused(A, S, G, text):
    with pytest.raises(InputError, match=text):
        solve_steady_response(A, S, G)
