"""Quasi-static internal states: against an independent search, and against the bounded solution.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import math

import numpy as np
import pytest
from laws.climb_reference import CLIMB, CRAFT, T, miss, noncausal, run
from scipy.optimize import brentq

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace, to_arrays
from trimtab.laws.internal_states import QuasiStaticInternal, QuasiStaticState
from trimtab.laws.path_command import FilteredClimb

FORM = to_arrays(QuasiStaticInternal(CRAFT))


def moment(alpha, p):
    """Return M over qbar S c (1) with elevator and thrust from the two accelerations, in plain numbers."""
    sine = p.h_rate / p.V
    cosine = math.sqrt(1 - sine**2)
    qS = 6.7429e-5 * math.exp(-(p.h - 85000) / 21358) * p.V**2 / 2 * 17
    g = 1.39e16 / 20988500.0**2

    def drag(delta):
        return qS * (5.8224 * alpha**2 - 0.045315 * alpha + 0.81993 * delta**2 + 2.7699e-4 * delta + 0.010131)

    def force(delta):
        lift = qS * (4.6773 * alpha + 0.76224 * delta - 0.018714)
        normal = (p.h_acceleration - p.V_rate * sine) / cosine + g * cosine
        return (300 * (p.V_rate + g * sine) + drag(delta)) * math.tan(alpha) + lift - 300 * normal

    delta = brentq(force, -2.0, 2.0, xtol=1e-15)
    thrust = (300 * (p.V_rate + g * sine) + drag(delta)) / math.cos(alpha)
    air = 6.2926 * alpha**2 + 2.1335 * alpha + 0.18979 - 1.2897 * delta
    return 8.36 * thrust / (qS * 17) + air, delta


def test_quasi_static_state_matches_an_independent_root_search():
    """[1] eq. 7 at several instants of the large climb."""
    state, zeta = run(FORM, every=1000)
    assert bool(state.found)
    for t, got in zip(T[::1000], zeta, strict=True):
        p = CLIMB.at(float(t))
        p = replace(p, **{n: float(getattr(p, n)) for n in ("h", "h_rate", "h_acceleration", "V", "V_rate")})
        alpha = brentq(lambda a, p=p: moment(a, p)[0], -0.05, 0.1, xtol=1e-14)
        delta = moment(alpha, p)[1]
        sine = p.h_rate / p.V
        Q = (p.h_acceleration - p.V_rate * sine) / math.sqrt(1 - sine**2) / p.V
        eta1 = (1.4013e3 * alpha**2 + 4.5737e3 * alpha + 1.1752e2) / 16.5**2
        eta2 = (-5.0227e3 * alpha**2 + 2.8633e3 * alpha + 1.2465e3 * delta - 4.4201e1) / 20**2
        np.testing.assert_allclose(got, [alpha, Q, eta1, 0, eta2, 0], rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
def test_quasi_static_error_to_the_bounded_solution_is_small():
    """Large climb, largest scaled differences: 1.6e-4 in alpha, 3.3e-2 in Q, which it approximates by gamma'."""
    _, zeta = run(FORM)
    got = miss(zeta, noncausal()[1].solution.zeta)
    assert (got < [1.7e-4, 3.4e-2, 2.1e-5, 5.7e-4, 3.1e-5, 7.3e-4]).all()
    assert got[1] > 1e-2


@pytest.mark.thorough
def test_root_search_starts_from_the_previous_solution():
    """Two Newton steps per call are enough after the first calls, from any start; the first call has no root yet."""
    right = run(FORM, every=10)[1]
    for alpha in (0.1, -0.1):
        first = replace(FORM, steps=2, alpha=alpha)
        state, zeta = run(first, every=10)
        assert bool(state.found)
        np.testing.assert_allclose(zeta[3:], right[3:], rtol=1e-6, atol=1e-9)
        assert not bool(first.step(0.0, first.init(None), CLIMB)[0].found)


@pytest.mark.thorough
def test_unsolvable_climb_is_flagged_and_stays_finite():
    """A fall faster than the vehicle, and hardly any air; a NaN command keeps the previous angle."""
    for climb in (FilteredClimb(dh=-1e6, wh=3.0), FilteredClimb(V0=1000.0), FilteredClimb(h0=400e3)):
        state, zeta = FORM.step(6.0, FORM.init(None), climb)
        assert not bool(state.found)
        assert np.isfinite(zeta).all()
    state, _ = FORM.step(6.0, QuasiStaticState(alpha=0.02, found=True), FilteredClimb(h0=math.nan))
    assert not bool(state.found)
    assert float(state.alpha) == 0.02


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_quasi_static_form_matches_jax():
    climb, state = to_arrays(CLIMB), to_arrays(FORM.init(None))
    run = compile(lambda form, t, s, c: form.step(t, s, c), FORM, np.float64(0), state, climb)
    for t in (0.0, 12.0, 40.0):
        state, zeta = run(FORM, np.float64(t), state, climb)
        np.testing.assert_allclose(zeta, FORM.step(t, state, climb)[1], rtol=1e-9, atol=1e-12)
