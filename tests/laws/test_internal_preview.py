"""Internal states from a few seconds of preview, against the bounded solution of the whole command.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import jax
import numpy as np
import pytest
from laws.climb_reference import CLIMB, CRAFT, H0, V0, miss, noncausal, run
from scipy.linalg import expm

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace, to_arrays
from trimtab.laws.internal_states import FadingModes
from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic._internal import level_trim, preview_internal

STEP = jax.jit(lambda form, t, state, climb: form.step(t, state, climb), compiler_options=FAST_COMPILE_OPTIONS)


def form(**changes):
    return to_arrays(preview_internal(CRAFT, level_trim(CRAFT, H0, V0), **changes))


@pytest.fixture(scope="module")
def default():
    return run(form())


@pytest.mark.thorough
def test_four_second_preview_matches_the_bounded_solution(default):
    """Large climb, 5 ms: largest scaled differences over the whole climb with its step, all below 4e-6."""
    state, zeta = default
    assert bool(state.found)
    got = miss(zeta, noncausal()[1].solution.zeta)
    assert (got < [1.2e-6, 4e-6, 2e-7, 5e-8, 2.2e-7, 9e-8]).all()


@pytest.mark.thorough
def test_internal_state_moves_before_the_command(default):
    zeta = default[1]
    assert abs(zeta[950, 0] - zeta[0, 0]) > 3e-7
    assert CLIMB.at(4.76).h == H0


@pytest.mark.thorough
def test_horizon_error_decays_at_the_unstable_mode_rate():
    """The end error falls by e^(-3.289 H), 27 times per second of horizon, until other errors dominate."""
    one, two = (
        miss(run(form(horizon=h, intervals=n), every=4)[1], noncausal()[1].solution.zeta, 4)[0]
        for h, n in ((1.0, 20), (2.0, 40))
    )
    assert 1e-4 < one < 2.5e-4
    assert 18 < one / two < 36


def test_weights_integrate_a_ramp_exactly():
    """Against scipy's matrix exponential; zero for a step of zero."""
    poles = np.array([-3.0 + 0j, -0.34 + 18.5j])
    o = np.zeros((2, 2, 2))
    modes = FadingModes(poles.real, poles.imag, o, o)
    for dt in (1e-4, 0.005, 0.1, 2.0):
        (begin_re, begin_im), (end_re, end_im) = modes.weights(dt)
        for i, l in enumerate(poles):
            driven = expm(np.array([[l, 1, 0], [0, 0, 1 / dt], [0, 0, 0]]) * dt)
            p0, p1 = driven[0, 1], driven[0, 2]
            np.testing.assert_allclose(end_re[i, 0] + 1j * end_im[i, 0], p1, rtol=1e-9)
            np.testing.assert_allclose(begin_re[i, 0] + 1j * begin_im[i, 0], p0 - p1, rtol=1e-9)
    assert not np.any(modes.weights(0.0))


@pytest.mark.thorough
def test_repeated_step_at_one_instant_gives_same_result():
    f = form(intervals=10)
    state, _ = STEP(f, 5.2, f.init(None), CLIMB)
    again, zeta = STEP(f, 5.2, state, CLIMB)
    np.testing.assert_allclose(zeta, STEP(f, 5.2, again, CLIMB)[1], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(again.q, state.q, rtol=1e-12, atol=1e-15)


@pytest.mark.thorough
def test_infeasible_climb_is_flagged_and_stays_finite():
    f = form(intervals=10)
    state, zeta = STEP(f, 6.0, f.init(None), to_arrays(FilteredClimb(dh=-1e6, wh=3.0)))
    assert not bool(state.found)
    assert np.isfinite(zeta).all()


def test_rejects_zero_intervals_and_zero_horizon():
    with pytest.raises(InputError, match="at least 1, got 0"):
        replace(form(), intervals=0).check()
    with pytest.raises(InputError, match="horizon"):
        preview_internal(CRAFT, level_trim(CRAFT, H0, V0), horizon=0.0)


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_preview_matches_jax():
    f = form(intervals=10)
    climb, state = to_arrays(CLIMB), to_arrays(f.init(None))
    compiled = compile(lambda f, t, s, c: f.step(t, s, c), f, np.float64(0), state, climb)
    mine = state
    for t in (4.9, 4.905, 5.0, 5.3):
        state, zeta = compiled(f, np.float64(t), state, climb)
        mine, wanted = STEP(f, t, mine, climb)
        np.testing.assert_allclose(zeta, wanted, rtol=1e-9, atol=1e-11)
