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
def test_all_data_is_that_of_the_system(method, observer):
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


def test_the_gain_is_the_regulator_s_and_the_filter_s():
    system = ball_system()
    c = design_certificate(system)
    assert np.array_equal(c.K, lqr(system.A, system.B, system.Q, system.Re, scale=system.scale).K)
    kalman = kalman_bucy(system.A_eta, system.C, system.Q_eta, system.R)
    assert np.array_equal(c.observer.L, kalman.L)


def test_the_weight_is_above_what_every_condition_needs():
    """By the definition: each of the four matrices is positive at the weight, and one of them no more at 0.98 of it."""
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


def test_a_method_of_no_name_is_refused():
    with pytest.raises(InputError, match="'magic'"):
        design_certificate(ball_system()._replace(method="magic"))


def test_a_gain_found_elsewhere_is_taken_as_it_is():
    system = ball_system(observer=False)
    gain = lqr(system.A, system.B, system.Q, system.Re)
    c = build_certificate(system, gain._replace(P=gain.P + np.triu(np.full((4, 4), 1e-9), 1)), None)
    assert np.array_equal(c.P, c.P.T)
    assert np.array_equal(c.K, gain.K)
