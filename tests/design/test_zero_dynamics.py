"""Zeros that are known by hand, and the verdicts."""

import numpy as np
import pytest
from design.published import G, ball_and_beam, cart_pole, hovercraft, vtol
from scipy.signal import tf2ss

from trimtab.core.errors import InputError
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions
from trimtab.design.zero_dynamics import transmission_zeros, zero_dynamics


def linear(A, B, C, D=None, rest=None):
    """A linear system as a Model."""
    A, B, C = (np.atleast_2d(np.asarray(M, float)) for M in (A, B, C))
    D = np.zeros((len(C), B.shape[1])) if D is None else np.atleast_2d(D)
    names = tuple(f"x{i}" for i in range(len(A)))
    inputs = tuple(f"u{i}" for i in range(B.shape[1]))
    return model_of_functions(lambda x, u: A @ x + B @ u, names, inputs, h=lambda x, u: C @ x + D @ u)


def of_transfer(numerator, denominator):
    A, B, C, D = tf2ss(numerator, denominator)
    return linear(A, B, C, D)


@pytest.mark.thorough
def test_cart_pole_is_non_minimum_phase():
    """Zeros of force to cart position: +-sqrt(g/l), the pole pivoting about a cart that stands still."""
    found = zero_dynamics(cart_pole("p"))
    assert found.verdict == "non-minimum phase"
    want = np.sqrt(G / 0.7)
    np.testing.assert_allclose(found.zeros.zeros, [want, -want], rtol=1e-12)
    np.testing.assert_allclose(found.poles, [want, -want], rtol=1e-12)
    np.testing.assert_allclose(found.offending_zeros, [want], rtol=1e-12)
    assert found.internals == ("a", "w")
    assert found.why[0].endswith((", in a, w", ", in w, a"))
    swing = zero_dynamics(cart_pole("a"))  # the cart may coast
    assert swing.verdict == "marginal"
    np.testing.assert_allclose(swing.poles, [0, 0], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("eps", [0.01, 1.0])
def test_planar_vtol_is_non_minimum_phase(eps):
    """Hauser, Sastry, Meyer 1992, section 2: theta'' = (g/eps) sin theta."""
    found = zero_dynamics(vtol(eps))
    assert found.verdict == "non-minimum phase"
    np.testing.assert_allclose(found.poles, [np.sqrt(G / eps), -np.sqrt(G / eps)], rtol=1e-10)
    np.testing.assert_allclose(found.jacobian, [[0, 1], [G / eps, 0]], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.zeros.zeros, found.poles, rtol=1e-9)


@pytest.mark.thorough
def test_hovercraft_zero_dynamics_are_marginal():
    """psi'' = -(d/J) FY with FY = 0 is all that is left: a double zero at 0."""
    found = zero_dynamics(hovercraft(heading=0.4))
    assert found.verdict == "marginal"
    np.testing.assert_allclose(found.poles, [0, 0], atol=1e-9)
    assert set(found.internals) == {"heading", "yaw_rate"}


def test_verdict_is_undecided_without_relative_degree():
    found = zero_dynamics(ball_and_beam())
    assert (found.verdict, found.jacobian, len(found.zeros.zeros)) == ("undecided", None, 0)
    assert "not at the point" in found.why[0]


@pytest.mark.thorough("zeros1", "zeros3", "zeros5")
@pytest.mark.parametrize("zeros", [[], [-1.0], [2.0, -3.0], [-1 + 2j, -1 - 2j, -40.0], [1e-3, -1e3], [5.0] * 4])
def test_transmission_zeros_match_transfer_function(zeros):
    poles = [-1.0, -2.0, -3.0, -4.5]
    found = transmission_zeros(linearise(of_transfer(np.atleast_1d(np.poly(zeros)), np.poly(poles))))
    assert len(found.zeros) == len(zeros)
    np.testing.assert_allclose(np.poly(found.zeros), np.poly(zeros), rtol=1e-7)


@pytest.mark.thorough("5.0-non-minimum phase")
@pytest.mark.parametrize(("zero", "verdict"), [(-1.0, "minimum phase"), (0.0, "marginal"), (5.0, "non-minimum phase")])
def test_verdict_follows_the_zero_location(zero, verdict):
    """With feedthrough, where the input is found from the output itself, and without."""
    for zeros in ([zero], [zero, -2.0]):
        found = zero_dynamics(of_transfer(np.poly(zeros), np.poly([-1.5, -2.5])))
        assert found.verdict == verdict
        np.testing.assert_allclose(found.poles, sorted(zeros, reverse=True), rtol=1e-9, atol=1e-12)


def test_transmission_zeros_of_multivariable_system():
    """diag((s - 1)/(s + 2)(s + 3), 1/(s + 1)) mixed by constant matrices has the zero 1 alone, whatever the units."""
    A, B = np.array([[-5.0, -6, 0], [1, 0, 0], [0, 0, -1]]), np.array([[1.0, 0], [0, 0], [0, 1]])
    C = np.array([[1.0, -1, 0], [0, 0, 1]])
    mix, other = np.array([[1.0, 2], [3, -1]]), np.array([[0.5, 1], [-2, 1]])
    T = np.diag([1e4, 1e-3, 10.0]) @ np.array([[1, 0.2, 0], [0.1, 1, 0.4], [0, 0.3, 1]])
    model = linear(T @ A @ np.linalg.inv(T), T @ B @ mix, other @ C @ np.linalg.inv(T))
    found = transmission_zeros(linearise(model))
    np.testing.assert_allclose(found.zeros, [1.0], rtol=1e-9)
    x, u = found.states[0], found.inputs[0]
    lin = linearise(model)
    np.testing.assert_allclose(lin.A @ x + lin.B @ u, x, rtol=1e-7, atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(lin.C @ x, 0, atol=1e-9 * (np.abs(lin.C) @ np.abs(x)).max())


def test_transmission_zeros_of_nonsquare_systems_and_hidden_modes():
    A, B = np.diag([-1.0, -2, 3]), np.array([[1.0], [1], [0]])  # the mode 3 is out of reach
    two = transmission_zeros(linearise(linear(A, B, [[1.0, 0, 0], [0, 1, 0]])))
    np.testing.assert_allclose(two.zeros, [3.0], rtol=1e-12)  # nor seen: it stays
    both = transmission_zeros(linearise(linear(A, B, [[1.0, 0, 1], [0, 1, 1]])))
    assert len(both.zeros) == 0  # seen by two outputs, it can't hide from both
    one = transmission_zeros(linearise(linear(A, B, [[1.0, 0, 1]])))
    np.testing.assert_allclose(one.zeros, [3.0, -2.0], rtol=1e-12)
    wide = transmission_zeros(linearise(linear(A[:2, :2], np.eye(2), [[1.0, 1]])))
    assert len(wide.zeros) == 0


@pytest.mark.thorough
def test_rejects_non_equilibrium_unless_state_is_loose():
    with pytest.raises(InputError, match=r"not an equilibrium: north' = 0\.5"):
        zero_dynamics(hovercraft(surge_velocity=0.5))
    moving = zero_dynamics(hovercraft(surge_velocity=0.5), loose=("north",))
    assert moving.verdict == "marginal"
    with pytest.raises(InputError, match="other states depend on surge_velocity"):
        zero_dynamics(hovercraft(), u={"FX": 1.0}, loose=("surge_velocity",))
    with pytest.raises(InputError, match="must be 2"):
        zero_dynamics(vtol(1.0), internal=("x",))


@pytest.mark.thorough
def test_user_tolerance_changes_the_verdict():
    slow = of_transfer([1.0, 1e-3], np.poly([-1.0, -2.0]))
    assert zero_dynamics(slow).verdict == "minimum phase"
    found = zero_dynamics(slow, tolerance=1e-2)
    assert found.verdict == "marginal"
    np.testing.assert_allclose(found.offending_zeros, [-1e-3], rtol=1e-9)
