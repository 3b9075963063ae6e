import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.sensors.encoder import Encoder

STEP = 2 * np.pi / 4096


def readings(encoder, headings):
    o = jnp.zeros(3)

    def one(psi):
        m = Motion(0, o, jnp.array([0.0, 0.0, 1.0]) * psi, o, o, o, o)
        return encoder.step(0, encoder.init(key(0)), m)[1].value, encoder.measure(m)

    return jax.jit(jax.vmap(one))(jnp.asarray(headings))


def test_counts_4096_steps_per_turn_in_both_directions():
    """[1] section 6.2.1. Headings between counts, so that rounding decides none."""
    k = np.arange(-5000, 5000, 37)
    value, _ = readings(Encoder(), (k + 0.25) * STEP)
    np.testing.assert_array_equal(value.count, k)
    assert isinstance(Encoder(), Sensor)
    assert np.asarray(value.count).dtype == np.int32


def test_angle_error_is_unbiased_and_below_half_a_count():
    psi = np.random.default_rng(0).uniform(-20, 20, 4000)
    value, true = readings(Encoder(zero=0.3), psi)
    error = np.asarray(value.angle) - (psi - 0.3)
    assert np.abs(error).max() <= STEP / 2 * (1 + 1e-9)
    assert error.mean() == pytest.approx(0, abs=4 * STEP / np.sqrt(12 * 4000))
    np.testing.assert_allclose(true.angle, psi - 0.3, atol=1e-15)


def test_eccentricity_error_has_one_period_per_turn():
    psi = np.linspace(0, 2 * np.pi, 100)
    value, _ = readings(without(Encoder(eccentricity=0.01), "encoder-quantisation"), psi)
    np.testing.assert_allclose(value.angle, psi + 0.01 * np.sin(psi), atol=1e-14)
    clean, _ = readings(
        without(without(Encoder(eccentricity=0.01), "encoder-quantisation"), "encoder-eccentricity"), psi
    )
    np.testing.assert_allclose(clean.angle, psi, atol=1e-15)
    with pytest.raises(InputError, match="no imperfection"):
        without(Encoder(), "play")
