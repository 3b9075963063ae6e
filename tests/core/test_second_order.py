"""Second-order sections against scipy's filters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from trimtab.compiler.function import lower_function
from trimtab.core.second_order import Section, SectionState, filter_sample, low_pass, steady_state

DT = 0.0065536
INPUT = np.random.default_rng(1).normal(size=(300, 2))


def run(section, state, u):
    return jax.jit(lambda s, u: jax.lax.scan(lambda s, u: filter_sample(section, s, u), s, u))(state, jnp.asarray(u))[1]


def test_section_matches_scipy_lfilter():
    section = Section(b0=0.3, b1=-0.2, b2=0.1, a1=-0.9, a2=0.4)
    got = run(section, SectionState(jnp.zeros(2), jnp.zeros(2)), INPUT)
    np.testing.assert_allclose(got, signal.lfilter([0.3, -0.2, 0.1], [1, -0.9, 0.4], INPUT, axis=0), atol=1e-14)


@pytest.mark.parametrize("frequency", [1.0, 30.0, 70.0])
def test_low_pass_matches_scipy_butterworth(frequency):
    s = low_pass(frequency, np.sqrt(0.5), DT)
    b, a = signal.butter(2, frequency, fs=1 / DT)
    np.testing.assert_allclose([s.b0, s.b1, s.b2], b, rtol=1e-9)
    np.testing.assert_allclose([1, s.a1, s.a2], a, rtol=1e-9, atol=1e-12)
    assert float(s.gain()) == pytest.approx(1, abs=1e-12)


def test_steady_state_holds_a_constant_input():
    section = low_pass(10.0, 0.5, DT)
    u = jnp.array([2.0, -1.0])
    np.testing.assert_allclose(
        run(section, steady_state(section, u), np.tile(u, (50, 1))), np.tile(u, (50, 1)), atol=1e-12
    )


def test_filter_is_exportable_to_c():
    lower_function(lambda f, s, u: filter_sample(low_pass(f, 0.7, DT), s, u), (10.0, SectionState(0.0, 0.0), 1.0))
