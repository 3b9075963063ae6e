"""Certificates as they are put together: every field from the system, and the weight that both conditions need."""

import numpy as np
import pytest
from design.systems import ball_system

from trimtab.core.errors import InputError
from trimtab.design import composite
from trimtab.design.certificate import ABOVE, build_certificate, design_certificate
from trimtab.design.lqr import kalman_bucy, lqr


@pytest.mark.parametrize("method", ["lqr", "lmi"])
@pytest.mark.parametrize("observer", [True, False])
def test_certificate_holds_all_data_of_the_system(method, observer):
    system = ball_system(method, observer)
    c = design_certificate(system)
    assert (c.system, c.about, c.method) == (system.name, system.about, method)
    assert (c.states, c.inputs, c.recorded) == (system.states, system.inputs, {"kappa": 0.3})
    for name in ("A", "B", "Qe", "Re", "scale"):
        assert np.array_equal(getattr(c, name), getattr(system, name)), name
    assert (c.Q is None) == (method == "lmi")
    assert np.array_equal(c.P, c.P.T)
    assert np.linalg.eigvals(c.A + c.B @ c.K).real.max() < 0
    assert (c.observer is not None) == observer
    if c.observer is not None:
        assert np.array_equal(c.observer.A, system.A[2:, 2:])  # what else moves them is known
        assert np.array_equal(c.observer.C, system.C)
        assert np.array_equal(c.estimated_indices(), [2, 3])


def test_gains_are_those_of_lqr_and_kalman_filter():
    system = ball_system()
    c = design_certificate(system)
    assert np.array_equal(c.K, lqr(system.A, system.B, system.Q, system.Re, scale=system.scale).K)
    kalman = kalman_bucy(system.A_eta, system.C, system.Q_eta, system.R)
    assert np.array_equal(c.observer.L, kalman.L)


def test_observer_weight_satisfies_every_condition():
    """Each of the four matrices is positive definite at the weight; at 0.98 of the weight, at least one is not."""
    c = design_certificate(ball_system())
    f, o, weight = c.feedback_matrices(), c.observer_matrices(c.observer), c.observer.weight

    def lowest(w):
        matrices = [
            composite.weighted_matrix(f, o, w),
            *(composite.decrease_matrix(f, o, w, r) for r in (0, 0.5, -0.5)),
        ]
        return min(np.linalg.eigvalsh(M)[0] for M in matrices)

    assert lowest(weight) > 0 > lowest(0.98 * weight)
    assert weight >= ABOVE * c.observer.least_weight


def test_rejects_unknown_method():
    with pytest.raises(InputError, match="'magic'"):
        design_certificate(ball_system()._replace(method="magic"))


def test_external_gain_is_kept_unchanged():
    system = ball_system(observer=False)
    gain = lqr(system.A, system.B, system.Q, system.Re)
    c = build_certificate(system, gain._replace(P=gain.P + np.triu(np.full((4, 4), 1e-9), 1)), None)
    assert np.array_equal(c.P, c.P.T)
    assert np.array_equal(c.K, gain.K)
