"""The weighted Lyapunov conditions, against their definitions written out another way."""

import numpy as np
import pytest
from design.systems import BALL_AND_BEAM, left_side

from trimtab.core.errors import InputError
from trimtab.design import composite
from trimtab.design.lqr import kalman_bucy, lqr

A, B = BALL_AND_BEAM
QE, RE, QF, RF = np.diag([4.0, 0.1, 1.0, 0.1]), np.array([[0.01]]), np.diag([0.1, 0.3]), np.array([[0.02]])
AT = [2, 3]
AF, CF = A[2:, 2:], np.array([[1.0, 0.0]])


@pytest.fixture(scope="module")
def pair():
    gain = lqr(A, B, 1.01 * QE, RE)
    found = kalman_bucy(AF, CF, QF, RF)
    feedback = composite.Feedback(A, B, gain.K, gain.P, QE, np.linalg.inv(RE))
    return feedback, composite.Observer(AF, CF, QF, found.P, found.L, np.linalg.inv(RF), AT)


def z(f, o, weight):
    """(15) corrected, with the inverse of P_eta in it."""
    W = f.P @ B @ np.linalg.inv(RE) @ B.T @ f.P
    inner = np.linalg.inv(o.P)
    Pi = inner @ QF @ inner + CF.T @ np.linalg.inv(RF) @ CF
    E = np.eye(4)[:, AT]
    return np.block([[QE, W @ E / 2], [E.T @ W / 2, weight * Pi]])


def test_inequality_matrix_is_minus_the_left_side(pair):
    f, _ = pair
    np.testing.assert_allclose(composite.inequality_matrix(f), -left_side(A, B, f.K, f.P, QE, RE), atol=1e-10)
    np.testing.assert_allclose(composite.inequality_matrix(f), 0.01 * QE, atol=1e-9)


def test_least_weight_makes_z_positive_definite(pair):
    f, o = pair
    least = composite.least_weight(f, o)
    for factor, positive in ((1.001, True), (0.999, False)):
        assert (np.linalg.eigvalsh(z(f, o, factor * least))[0] > 0) == positive
        assert (np.linalg.eigvalsh(composite.weighted_matrix(f, o, factor * least))[0] > 0) == positive


@pytest.mark.parametrize("robust", [0.0, 0.5, -0.5])
def test_decrease_matrix_matches_rate_of_lyapunov_function(pair, robust):
    """Rate of V = e'P e/2 + weight e_eta'P_eta^-1 e_eta along the true loop, by finite differences."""
    f, o = pair
    weight, K = 3.0, f.K + robust * np.linalg.solve(RE, B.T @ f.P)

    def rate(e, lag):
        seen = e.copy()
        seen[AT] -= lag
        return A @ e + B @ (K @ seen), (AF - o.L @ CF) @ lag

    def V(e, lag):
        return e @ f.P @ e / 2 + weight * lag @ np.linalg.solve(o.P, lag)

    M, rng, h = composite.decrease_matrix(f, o, weight, robust), np.random.default_rng(0), 1e-6
    for _ in range(5):
        e, lag = rng.standard_normal(4), rng.standard_normal(2)
        de, dl = rate(e, lag)
        slope = (V(e + h * de, lag + h * dl) - V(e - h * de, lag - h * dl)) / (2 * h)
        point = np.concatenate([e, np.linalg.solve(o.P, lag)])
        assert -point @ M @ point == pytest.approx(slope, rel=1e-6)


def test_least_decrease_weight_is_sharp(pair):
    f, o = pair
    for robust in (0.0, 0.5, -0.5):
        least = composite.least_decrease_weight(f, o, robust)
        assert np.linalg.eigvalsh(composite.decrease_matrix(f, o, 1.001 * least, robust))[0] > 0
        assert np.linalg.eigvalsh(composite.decrease_matrix(f, o, 0.999 * least, robust))[0] < 0
    assert composite.least_decrease_weight(f, o, 0.5) == pytest.approx(composite.least_weight(f, o) / 2, rel=0.02)
    assert composite.least_decrease_weight(f, o, 2.0) == np.inf  # destabilises: no weight helps


def test_rejects_unstable_observer(pair):
    f, o = pair
    with pytest.raises(InputError, match="must be positive definite"):
        composite.least_decrease_weight(f, o._replace(L=-o.L))
