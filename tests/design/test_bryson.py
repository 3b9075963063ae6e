"""Weights by limits: their meaning by cost, integral action, and what is refused."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from trimtab.core.errors import InputError
from trimtab.design.bryson import INTEGRAL, fed_back_states, weigh_by_limits
from trimtab.design.certificate import design_certificate
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions


@pytest.fixture(scope="module")
def cart():
    A, B = np.array([[0.0, 1.0], [0.0, -0.2]]), np.array([[0.0], [2.0]])
    return linearise(model_of_functions(lambda x, u: A @ x + B @ u, ("x", "v"), ("F",)))


def test_gain_matches_riccati_solution_and_is_proved(cart):
    system = weigh_by_limits("cart", cart, {"x": 0.5, "v": 2.0, "F": 4.0})
    certificate = design_certificate(system)
    Q, R = np.diag([1 / 0.5**2, 1 / 2.0**2]), np.array([[1 / 4.0**2]])
    P = solve_continuous_are(cart.A, cart.B, Q, R)
    np.testing.assert_allclose(certificate.K, -np.linalg.solve(R, cart.B.T @ P), rtol=1e-9)
    assert prove_certificate(certificate, system).holds
    assert not prove_certificate(certificate._replace(K=-certificate.K), system).holds


def test_integral_action_adds_a_state(cart):
    system = weigh_by_limits("cart", cart, {"x": 0.5, "v": 2.0, "F": 4.0}, {"x": 0.2})
    assert system.states == ("x", "v", f"{INTEGRAL}x")
    assert (np.linalg.eigvals(system.A + system.B @ design_certificate(system).K).real < 0).all()
    assert system.Q[2, 2] == pytest.approx(0.2**-2)
    np.testing.assert_array_equal(system.A[2], [1, 0, 0])


def test_rejects_missing_zero_and_unknown_limits(cart):
    for limits, words in (
        ({"x": 1.0}, "no limit is given for F, v"),
        ({"x": 0.0, "v": 1.0, "F": 1.0}, "above 0"),
        ({"y": 1.0, "F": 1.0}, "unknown name 'y'"),
    ):
        with pytest.raises(InputError, match=words):
            weigh_by_limits("cart", cart, limits)


def test_unused_state_is_fed_back_only_if_named(cart):
    assert fed_back_states(cart, {"x"}, ()) == ("v",)
    assert fed_back_states(cart, {"x"}, ("x",)) == ("x", "v")
