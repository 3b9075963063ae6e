"""AdaptiveRobust: signs, bounds and adaptation against what follows from [1] eqs. 16-18.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.laws.adaptive_robust import SIZES, AdaptationState, AdaptiveRobust
from trimtab.laws.stable_inversion import K_FLOWN, R_FLOWN
from trimtab.loop.checks import check_values

K, R = np.array(K_FLOWN), np.array(R_FLOWN)
ROBUST = AdaptiveRobust(BP=-R[:, None] * K)
ERROR = np.array([30.0, -2.0, 4.0, 1e-3, -2e-3, 0.02, 0.3, -0.01, 0.2])
LEARNT = AdaptationState(0.7, 0.3)


def sized(e):
    return np.sqrt(np.sum((e / np.array(SIZES)) ** 2))


@pytest.mark.parametrize(("sign", "times"), [("published", 0.5), ("minus", 1.5), ("off", 1.0)])
def test_damping_scales_the_gain_of_a_regulator(sign, times):
    """[1] eqs. 16-18: R^-1 s = -K e, so the published u_h halves K and minus makes it one and a half."""
    terms = replace(ROBUST, damping=sign).terms(LEARNT, ERROR)
    np.testing.assert_allclose(K @ ERROR + terms.u_h, times * K @ ERROR, rtol=1e-12)


def test_switching_opposes_s_and_stays_below_its_bound():
    one = replace(ROBUST, switching="smooth", kappa=0.2)
    for scale in (1e-6, 1e-3, 1.0, 10.0):
        terms = one.terms(LEARNT, scale * ERROR)
        bound = (0.7 + 0.3 * sized(scale * ERROR)) / 1.2
        assert np.dot(terms.s, terms.u_s) < 0
        s = np.linalg.norm(terms.s)
        np.testing.assert_allclose(np.linalg.norm(terms.u_s), bound * s / (s + 0.01), rtol=1e-12)


def test_sign_switching_uses_the_full_bound_in_each_direction():
    terms = replace(ROBUST, switching="sign").terms(LEARNT, ERROR)
    np.testing.assert_allclose(np.abs(terms.u_s), 0.7 + 0.3 * sized(ERROR), rtol=1e-12)
    np.testing.assert_array_equal(np.sign(terms.u_s), -np.sign(terms.s))


@pytest.mark.thorough
@pytest.mark.parametrize("sigma", [0.0, 0.5])
def test_adaptive_bounds_follow_their_differential_equation(sigma):
    """[1] eqs. 16-18, corrected; scipy integrates the same equations with a decaying error."""
    one = replace(ROBUST, switching="smooth", sigma=sigma, cap=1e3)

    def rates(t, rho):
        e = ERROR * np.exp(-t)
        s = np.linalg.norm(np.array(one.BP) @ e)
        return [one.q0 * (s - sigma * rho[0]), one.q1 * (sized(e) * s - sigma * rho[1])]

    wanted = solve_ivp(rates, (0, 2), [0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    state, dt = one.init(), 1e-3
    for k in range(2000):
        e = ERROR * np.exp(-(k + 0.5) * dt)
        state = one.adapt(dt, state, e, np.array(one.BP) @ e)
    np.testing.assert_allclose([state.rho0, state.rho1], wanted, rtol=2e-3)


def test_adaptive_bounds_stay_between_zero_and_the_cap():
    one = replace(ROBUST, switching="smooth", cap=0.9, sigma=0.0)
    state = one.adapt(100.0, LEARNT, ERROR, np.array(one.BP) @ ERROR)
    assert float(state.rho0) == 0.9
    leaky = replace(one, sigma=1e3)
    assert float(leaky.adapt(1.0, LEARNT, ERROR, np.zeros(2)).rho0) == 0.0


def test_disabled_law_does_not_adapt():
    state = ROBUST.adapt(1.0, LEARNT, ERROR, np.array(ROBUST.BP) @ ERROR)
    assert state is LEARNT
    terms = ROBUST.terms(LEARNT, ERROR)
    assert not np.any(terms.u_h)
    assert not np.any(terms.u_s)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"kappa": 1.0}, "must be below 1"),
        ({"eps": 0.0}, "above 0"),
        ({"sizes": (0.0,) * 9}, "above 0"),
        ({"BP": np.full((2, 9), np.nan)}, "not finite"),
        ({"damping": "plus"}, "not a choice"),
    ],
)
def test_rejects_invalid_values(changes, says):
    with pytest.raises(InputError, match=says):
        check_values({"robust": replace(ROBUST, **changes)})
