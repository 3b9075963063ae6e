"""Command filters: closed forms against scipy's step responses, continuity, invalid values.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import jax
import numpy as np
import pytest
from scipy import signal

from trimtab.core.errors import InputError
from trimtab.laws.path_command import FilteredClimb, filtered_step

CLIMB = FilteredClimb(dh=5000.0, dV=1000.0, wh=0.06, wV=0.09, start=5.0)


def response(w, order, derivative, t):
    """Return d^k/dt^k of the unit step through w^n/(s + w)^n, by scipy's simulation."""
    system = (w**order * np.eye(1, derivative + 1)[0], np.poly([-w] * order))
    return signal.step(system, T=t)[1]


def test_closed_forms_match_scipy_step_responses():
    """Oracle, climb: orders 4 and 3, each derivative, to 1e-9 of its largest value."""
    t = np.linspace(0.0, 250.0, 501)
    p = CLIMB.at(5.0 + t)
    h = [(p.h - 85000.0) / 5000, p.h_rate / 5000, p.h_acceleration / 5000, p.h_jerk / 5000]
    V = [(p.V - 7702.0808) / 1000, p.V_rate / 1000, p.V_acceleration / 1000]
    for w, got in ((0.06, h), (0.09, V)):
        for k, values in enumerate(got):
            wanted = response(w, len(got), k, t)
            assert np.abs(values - wanted).max() < 1e-9 * max(np.abs(wanted).max(), w**k)


def test_filtered_step_matches_published_polynomials():
    """Oracle, climb: the closed form."""
    a = np.linspace(0.0, 12.0, 61)
    e = np.exp(-a)
    wanted = [1 - e * (1 + a + a**2 / 2 + a**3 / 6), e * a**3 / 6, e * (a**2 / 2 - a**3 / 6), e * (a - a**2 + a**3 / 6)]
    np.testing.assert_allclose(filtered_step(a, 4), wanted, atol=1e-15)
    wanted = [1 - e * (1 + a + a**2 / 2), e * a**2 / 2, e * (a - a**2 / 2)]
    np.testing.assert_allclose(filtered_step(a, 3), wanted, atol=1e-15)


@pytest.mark.thorough
def test_each_field_is_the_derivative_of_the_previous():
    t = np.array([0.0, 4.0, 5.5, 20.0, 60.0, 200.0])
    derivative = jax.vmap(jax.jacfwd(CLIMB.at))(t)
    p = CLIMB.at(t)
    pairs = (("h", "h_rate"), ("h_rate", "h_acceleration"), ("h_acceleration", "h_jerk"), ("V", "V_rate"))
    for lower, upper in (*pairs, ("V_rate", "V_acceleration")):
        np.testing.assert_allclose(getattr(derivative, lower), getattr(p, upper), rtol=1e-9, atol=1e-12)


def test_command_derivatives_are_continuous_at_the_step():
    """Oracle, climb: h'' and V' are continuous at the step; h''' starts from zero too."""
    t = 5.0 + np.array([-1e-6, 1e-6])
    p = CLIMB.at(t)
    for name in ("h", "h_rate", "h_acceleration", "h_jerk", "V", "V_rate"):
        before, after = np.asarray(getattr(p, name))
        assert abs(after - before) < 1e-4 * 1e-6 * 1e5, name
    np.testing.assert_allclose([p.V_acceleration[0], p.V_acceleration[1]], [0.0, 1000 * 0.09**3 * 1e-6], atol=1e-6)


@pytest.mark.thorough
def test_altitude_step_reaches_95_percent_after_130_seconds():
    """Oracle, climb: about 130 s for an altitude step with the defaults."""
    t = np.linspace(0, 250, 25001)
    reached = t[np.argmax(FilteredClimb(dh=1.0).at(5.0 + t).h - 85000.0 >= 0.95)]
    assert abs(reached - 130) < 2


def test_rejects_final_speeds_at_or_below_zero():
    CLIMB.check()
    with pytest.raises(InputError, match="must be above 0, got 0 ft/s"):
        FilteredClimb(V0=500.0, dV=-500.0).check()
    with pytest.raises(InputError, match="must be above 0, got -100 ft/s"):
        FilteredClimb(V0=500.0, dV=-600.0).check()
