"""Regulator and steady filter against closed forms and the Hamiltonian's stable subspace."""

import numpy as np
import pytest
from design.systems import BALL_AND_BEAM, DOUBLE_INTEGRATOR

from trimtab.core.errors import InputError
from trimtab.design.lqr import augment_integrals, kalman_bucy, lqr


def by_hamiltonian(A, B, Q, R):
    """P from the eigenvectors of the Hamiltonian matrix: another way than the solver's."""
    n = len(A)
    H = np.block([[A, -B @ np.linalg.inv(R) @ B.T], [-Q, -A.T]])
    values, vectors = np.linalg.eig(H)
    stable = vectors[:, values.real < 0]
    return np.real(stable[n:] @ np.linalg.inv(stable[:n]))


def test_double_integrator_gain_matches_the_textbook():
    found = lqr(*DOUBLE_INTEGRATOR, np.eye(2), 1.0)
    np.testing.assert_allclose(found.K, [[-1, -np.sqrt(3)]], rtol=1e-12)
    np.testing.assert_allclose(found.P, [[np.sqrt(3), 1], [1, np.sqrt(3)]], rtol=1e-12)
    np.testing.assert_allclose(found.poles, np.array([-np.sqrt(3) + 1j, -np.sqrt(3) - 1j]) / 2, rtol=1e-12)
    assert found.residual < 1e-14


def test_scale_does_not_change_gain_with_integral_action():
    A, B = augment_integrals(*BALL_AND_BEAM, [0])
    np.testing.assert_array_equal(A[4], [1, 0, 0, 0, 0])
    assert B.shape == (5, 1)
    Q, R = np.diag([1.0, 0.1, 3.0, 0.1, 0.5]), np.array([[0.04]])
    found = lqr(A, B, Q, R)
    np.testing.assert_allclose(found.P, by_hamiltonian(A, B, Q, R), rtol=1e-7)
    other = lqr(A, B, Q, R, scale=[100.0, 1e-3, 5.0, 1.0, 1e4])
    np.testing.assert_allclose(other.K, found.K, rtol=1e-8)
    closed = np.linalg.eigvals(A + B @ found.K)
    np.testing.assert_allclose(np.sort(found.poles.real), np.sort(closed.real), rtol=1e-8)


def test_kalman_bucy_matches_scalar_closed_form():
    """x' = a x + w, y = x + n: P = R (a + sqrt(a^2 + Q/R))."""
    found = kalman_bucy(0.3, 1.0, 2.0, 0.5)
    P = 0.5 * (0.3 + np.sqrt(0.09 + 4.0))
    np.testing.assert_allclose([found.P[0, 0], found.L[0, 0]], [P, P / 0.5], rtol=1e-12)
    np.testing.assert_allclose(found.poles, [0.3 - P / 0.5], rtol=1e-12)


def test_rejects_unsolvable_problems_with_pole_or_number():
    with pytest.raises(InputError, match=r"no input moves the pole \+1 1/s"):
        lqr([[1, 0], [0, -2]], [[0], [1]], np.eye(2), 1.0)
    with pytest.raises(InputError, match=r"Q is zero for the motion of the pole \+0 ± 3i 1/s"):
        lqr([[0, 3, 0], [-3, 0, 0], [0, 0, -1]], [[0], [1], [1]], np.diag([0, 0, 1]), 1.0)
    with pytest.raises(InputError, match=r"entry \[0, 1\] must be finite, got nan"):
        lqr([[0, np.nan], [0, 0]], [[0], [1]], np.eye(2), 1.0)
    with pytest.raises(InputError, match="smallest eigenvalue -1"):
        lqr(*DOUBLE_INTEGRATOR, np.eye(2), -1.0)
    with pytest.raises(InputError, match="must be symmetric"):
        lqr(*DOUBLE_INTEGRATOR, [[1, 0.5], [0, 1]], 1.0)
    with pytest.raises(InputError, match="shape"):
        lqr(*DOUBLE_INTEGRATOR, np.eye(3), 1.0)


def test_accepts_stable_uncontrollable_pole():
    found = lqr([[1, 0], [0, -2]], [[1], [0]], np.eye(2), 1.0)
    assert found.poles.real.max() < 0


def test_tiny_input_gain_is_still_controllable():
    """In bad units the input matrix is 1e-12 of the rest; only the scaled size may count."""
    found = lqr([[1.0]], [[1e-12]], 1.0, 1e-24)
    np.testing.assert_allclose(found.poles, [-np.sqrt(2)], rtol=1e-9)


@pytest.mark.parametrize("e", [1e-3, 1e-5, 1e-7, 1e-9])
@pytest.mark.parametrize("scale", [None, [1.0, 1.0], [1e3, 1e-3]])
def test_nearly_singular_weight_has_the_exact_gain(e, scale):
    """A and Q commute, so that P = A + sqrt(A^2 + Q). Its entries are computed from the eigenvalues e and 2 + e."""
    slow, fast = e * (1 + np.sqrt(2)), 2 + e + np.sqrt((2 + e) ** 2 + e * e)
    P = np.array([[fast + slow, fast - slow], [fast - slow, fast + slow]]) / 2
    found = lqr([[1 + e, 1], [1, 1 + e]], np.eye(2), e * e * np.eye(2), np.eye(2), scale=scale)
    np.testing.assert_allclose(-found.K, P, rtol=1e-8)
    assert found.residual < 1e-11


def test_pole_conditions_do_not_depend_on_units():
    """Every positive definite weight sees every pole; a column of the input matrix counts in any unit."""
    for size in (1e-30, 1e-14, 1.0, 1e14):
        found = lqr([[1, 0], [0, 2]], np.eye(2), size * np.eye(2), size * np.eye(2), scale=[1, 1])
        np.testing.assert_allclose(-np.diag(found.K), [1 + np.sqrt(2), 2 + np.sqrt(5)], rtol=1e-9)
    with pytest.raises(InputError, match=r"is zero for the motion of the pole \+2"):
        lqr([[1, 0], [0, 2]], np.eye(2), [[1e-14, 0], [0, 0]], np.eye(2), scale=[1, 1])
