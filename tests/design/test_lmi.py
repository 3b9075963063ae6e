"""Gains from the matrix inequality, on systems that have nothing to do with each other."""

import sys

import numpy as np
import pytest
from design.systems import BALL_AND_BEAM, DOUBLE_INTEGRATOR, integrators, left_side
from scipy.linalg import sqrtm

from trimtab.core.errors import InputError
from trimtab.design.lmi import STATES_SOLVED, STRICT, least_violation, lmi_gain, minimise, symmetric_matrix
from trimtab.design.lqr import lqr

CASES = {
    "double integrator": (*DOUBLE_INTEGRATOR, np.diag([1.0, 0.5]), np.array([[2.0]])),
    "ball and beam": (*BALL_AND_BEAM, np.diag([4.0, 0.1, 1.0, 0.1]), np.array([[0.01]])),
}


@pytest.mark.parametrize("case", CASES)
def test_gain_satisfies_the_matrix_inequality(case):
    A, B, Qe, Re = CASES[case]
    found = lmi_gain(A, B, Qe, Re)
    assert np.linalg.eigvalsh(found.P)[0] > 0
    d = 1 / np.sqrt(np.diag(Qe))
    assert np.linalg.eigvalsh(left_side(A, B, found.K, found.P, Qe, Re) * np.outer(d, d))[-1] < 0
    assert found.margin > 0.5 * STRICT
    assert np.linalg.eigvals(A + B @ found.K).real.max() < 0
    assert found.poles[0].real == pytest.approx(np.linalg.eigvals(A + B @ found.K).real.max(), rel=1e-6)


def test_objective_matches_its_definition_and_is_minimal():
    """tr(Q_e X) + tr(R_e Y X^-1 Y') at the solution, scaled back; and no gain of the regulator does better."""
    A, B, Qe, Re = CASES["ball and beam"]
    found = lmi_gain(A, B, Qe, Re)

    def cost(K, P):
        X = np.linalg.inv(P)
        return np.trace(Qe @ X) + np.trace(Re @ K @ X @ K.T)

    assert cost(found.K, found.P) == pytest.approx(found.objective, rel=1e-5)
    for more in (1.001, 1.5, 3.0):
        other = lqr(A, B, more * Qe, Re)
        assert cost(other.K, other.P) > found.objective * (1 - 1e-6)


def test_decay_speeds_up_poles_and_scale_keeps_gain():
    A, B, Qe, Re = CASES["ball and beam"]
    slow, fast = lmi_gain(A, B, Qe, Re), lmi_gain(A, B, Qe, Re, decay=2.0)
    assert fast.poles[0].real < -2.0
    other = lmi_gain(A, B, Qe, Re, scale=[1.0, 2.0, 0.5, 3.0])
    np.testing.assert_allclose(other.K, slow.K, rtol=1e-3)


def test_infeasible_problem_reports_pole_and_violation():
    with pytest.raises(
        InputError, match=r"solver reported .*no input moves the poles \+1 1/s.*violated by at least [\d.e-]+"
    ):
        lmi_gain([[1, 0], [0, -2]], [[0], [1]], np.eye(2), 1.0)
    with pytest.raises(InputError, match=r"no input moves the poles -2 1/s.*\nFix: choose a smaller decay"):
        lmi_gain([[1, 0], [0, -2]], [[1], [0]], np.eye(2), 1.0, decay=3.0)
    assert lmi_gain([[1, 0], [0, -2]], [[1], [0]], np.eye(2), 1.0, decay=1.5).poles[0].real < -1.5
    with pytest.raises(InputError, match="give a positive weight to every state"):
        lmi_gain(*DOUBLE_INTEGRATOR, np.diag([1.0, 0.0]), 1.0)


def test_undecided_problem_reports_size_and_limit():
    assert lmi_gain(*integrators(STATES_SOLVED), np.eye(STATES_SOLVED), 1.0).poles[0].real < 0
    for n, weight in ((12, 1.0), (10, 1 / 1.01)):  # the solver fails; it ends beside the boundary
        undecided = rf"{n} states and 1 inputs(.|\n)*does not show(.|\n)*up to {STATES_SOLVED} integrators"
        with pytest.raises(InputError, match=undecided):
            lmi_gain(*integrators(n), weight * np.eye(n), 1.0, scale=np.ones(n))


def test_missing_solver_error_gives_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(InputError, match=r"Clarabel is not installed[\s\S]*pip install .*\[design\]"):
        lmi_gain(*DOUBLE_INTEGRATOR, np.eye(2), 1.0)


def test_semidefinite_programs_with_known_answers():
    """Largest eigenvalue of M as the least t with t I - M >= 0; trace norm bound; a contradiction and its size."""
    rng = np.random.default_rng(3)
    M = rng.standard_normal((5, 5))
    M = M + M.T
    found = minimise(lambda z: z[0], [lambda z: z[0] * np.eye(5) - M], 1)
    assert found.objective == pytest.approx(np.linalg.eigvalsh(M)[-1], rel=1e-7)

    # least tr X with [X, M; M, X] >= 0 is the trace norm of M
    def trace(z):
        return np.trace(symmetric_matrix(z, 5))

    found = minimise(trace, [lambda z: np.kron([[1, 0], [0, 1]], symmetric_matrix(z, 5)) +
                     np.kron([[0, 1], [1, 0]], M)], 15)  # fmt: skip
    assert found.objective == pytest.approx(np.trace(np.real(sqrtm(M @ M))), rel=1e-6)
    assert least_violation([lambda z: np.diag([z[0] - 1, -1 - z[0]])], 1) == pytest.approx(1.0, rel=1e-6)
