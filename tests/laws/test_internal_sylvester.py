"""The causal linear form against the noncausal linear solution.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import numpy as np
import pytest
from laws.climb_reference import CLIMB, CRAFT, H0, SCALES, V0, T, linear, miss, noncausal, run

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import to_arrays
from trimtab.scenarios.hypersonic._internal import internal_linear, level_trim, sylvester_internal


@pytest.fixture(scope="module")
def form():
    return to_arrays(sylvester_internal(CRAFT, CLIMB))


@pytest.fixture(scope="module")
def ran(form):
    return run(form)[1]


@pytest.mark.thorough
def test_converges_to_the_noncausal_linear_solution_after_the_step(ran):
    """[1] eq. 7: the difference consists of stable modes; after 20 s it is below 1e-7 of the scales."""
    off = np.abs(ran - linear()[1].solution.zeta[: len(T)]) / SCALES
    at = {s: off[np.searchsorted(T, 5 + s - 1e-9)].max() for s in (0, 1, 5, 15, 30)}
    assert 2e-4 < at[0] < 5e-4  # the jump: what the unstable mode began with before the step
    assert at[5] < 5e-6
    assert at[15] < 1e-7
    assert at[30] < 1e-8


@pytest.mark.thorough
def test_transient_has_no_unstable_component(ran):
    """The projection on the left eigenvector of the pole +3.289 is zero from the step on."""
    A22 = internal_linear(CRAFT, level_trim(CRAFT, H0, V0)).A22 * SCALES / SCALES[:, None]
    poles, left = np.linalg.eig(A22.T)
    vector = left[:, np.argmax(poles.real)].real
    off = (ran - linear()[1].solution.zeta[: len(T)]) / SCALES
    after = np.searchsorted(T, 5 - 1e-9)
    assert np.abs(off[after:] @ vector).max() < 1e-8
    assert np.abs(off[after - 20 : after] @ vector).min() > 1e-5


def test_error_to_the_exact_bounded_solution_is_bounded(ran):
    """Large climb, scaled: 6.8e-2 in alpha because the form is linear; equal for the noncausal linear solution."""
    exact = noncausal()[1].solution.zeta
    for zeta in (ran, linear()[1].solution.zeta[: len(T)]):
        got = miss(zeta, exact)
        assert (got < [6.9e-2, 3.8e-4, 1.21e-2, 4.5e-5, 2.6e-3, 2.8e-5]).all()
        assert got[0] > 6.7e-2


def test_equals_the_trim_before_the_step(form, ran):
    """The form is causal: it does not move before the command."""
    before = T < 5.0
    np.testing.assert_array_equal(ran[before], np.broadcast_to(form.zeta_0, ran[before].shape))
    np.testing.assert_allclose(form.zeta_0, level_trim(CRAFT, H0, V0).zeta)


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_sylvester_form_matches_jax(form, ran):
    compiled = compile(lambda form, t, c: form.step(t, (), c)[1], form, np.float64(0), CLIMB)
    for k in (0, 1001, 5000):
        np.testing.assert_allclose(compiled(form, T[k], CLIMB), ran[k], rtol=1e-10, atol=1e-13)
