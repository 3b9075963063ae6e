"""The published continuous filter of the modes: its equations, its steady state, and the effect of the printed setting.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import numpy as np
import pytest
from estimators.flexible_flights import DT, NAMES, fly, rms, trim
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

from studies.hypersonic2022._continuous_filter import ContinuousModeFilter
from trimtab.core.errors import InputError
from trimtab.core.record import to_arrays
from trimtab.estimators.flexible.discrete import PRINTED_ETA0, FlexibleModeFilter
from trimtab.estimators.flexible.model import modal_dynamics


def _model():
    A, C = modal_dynamics(trim()[0])
    return np.asarray(A), np.asarray(C)


@pytest.mark.thorough
def test_filter_matches_the_riccati_equation_at_trim():
    """Oracle: scipy integrates eta and the Riccati equation together at constant state, input and measurement."""
    _, x, _ = trim()
    A, C = _model()
    truth = np.array([float(getattr(x, n)) for n in NAMES])
    Q, R = np.diag([1e-4, 1.0, 1e-4, 1.0]), 0.02

    def rate(t, y):
        e, P = y[:4], y[4:].reshape(4, 4)
        L = P @ C / R
        return np.concatenate([A @ e - L * (C @ e), (A @ P + P @ A.T + Q - R * np.outer(L, L)).ravel()])

    first = np.concatenate([np.array(PRINTED_ETA0) - truth, np.eye(4).ravel()])
    want = solve_ivp(rate, (0, 9.995), first, t_eval=[1.0, 3.0, 9.995], rtol=1e-10, atol=1e-12).y
    one = ContinuousModeFilter(Q=np.diag(Q), R=R, substeps=4)  # RK4 at 5 ms is off by 1e-4
    one.check()
    errors, _, P = fly(*trim(), one, noise=0.0)
    for i, k in enumerate((200, 600, 1999)):
        np.testing.assert_allclose(errors[k], want[:4, i], atol=2e-6)
        np.testing.assert_allclose(P[k], want[4:, i].reshape(4, 4), rtol=1e-4, atol=1e-6)


def test_covariance_converges_to_the_algebraic_riccati_solution():
    A, C = _model()
    one = to_arrays(ContinuousModeFilter(R=1e-4, substeps=2))
    eta, P = np.zeros(4), 1e-3 * np.eye(4)
    for _ in range(4):  # a few periods by the part's own step, the rest by what it must settle at
        eta, P = one.integrate(eta, P, np.zeros(4), 0.0, True)
    settled = solve_continuous_are(A.T, C[:, None], 1e-5 * np.eye(4), np.array([[1e-4]]))
    _, still = one.integrate(eta, settled, np.zeros(4), 0.0, True)
    np.testing.assert_allclose(still, settled, rtol=1e-6, atol=1e-12)
    assert np.linalg.eigvalsh(np.asarray(P)).min() > 0


@pytest.mark.thorough
def test_printed_setting_equals_observer_without_measurement():
    """With R = 10 as a density, the gain is almost zero: the errors are within 1 % of a filter without updates."""
    none = np.asarray(fly(*trim(), FlexibleModeFilter(corrects=False), noise=0.0)[0])
    printed = np.asarray(fly(*trim(), ContinuousModeFilter(), noise=0.0)[0])
    for window in ((0, 1), (4, 5), (9, 10)):
        np.testing.assert_allclose(rms(printed, *window), rms(none, *window), rtol=0.01)
    assert (rms(printed, 9, 10) < 0.08 * rms(printed, 0, 1)).all()  # and yet it "converges in ten seconds"


@pytest.mark.thorough
def test_discrete_filter_approximates_the_published_continuous_filter():
    """Both use the same densities: the variance of a sample is R/dt. After the start, errors agree to the step size."""
    continuous = ContinuousModeFilter(Q=(1e-4, 1.0, 1e-4, 1.0), R=0.02)
    discrete = FlexibleModeFilter(Q=(1e-4, 1.0, 1e-4, 1.0), R=0.02 / DT, P0=(1.0,) * 4)
    errors = [np.asarray(fly(*trim(), one, noise=0.0)[0]) for one in (continuous, discrete)]
    scale = np.array([0.6, 10.0, 0.4, 8.0])
    assert (np.abs(errors[0] - errors[1])[20:] / scale).max() < 0.02
    assert np.abs(errors[0] - errors[1]).max() > 0


def test_rejects_step_too_long_for_the_gain():
    ContinuousModeFilter().check()
    stiff = {"R": 5e-7, "P0": (1.0, 100.0, 1.0, 100.0)}
    with pytest.raises(InputError, match="too fast for steps"):
        ContinuousModeFilter(**stiff).check()
    ContinuousModeFilter(**stiff, substeps=500).check()
    with pytest.raises(InputError, match="four variances"):
        ContinuousModeFilter(Q=(1.0, 1.0, -1.0, 1.0)).check()
