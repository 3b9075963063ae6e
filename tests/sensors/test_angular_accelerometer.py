"""The angular accelerometer on the hypersonic vehicle: its reading, noise and imperfections."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.core.time import ms
from trimtab.sensors.angular_accelerometer import AngularAccelerometer
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

O = jnp.zeros(3)


def _samples(sensor, motion, n, seed=0):
    k = jnp.arange(n, dtype=np.int64)
    state = sensor.init(key(seed))
    step = jax.jit(jax.vmap(lambda k: sensor.step(k * sensor.period, state, motion)[1].value.pitch_acceleration))
    return np.asarray(step(k))


def _motion(pitch_acceleration):
    return Motion(0, O, O, O, O, O, jnp.array([7.0, 1.0, -5.0]) * jnp.array([1, pitch_acceleration, 1]))


def test_measures_total_pitch_acceleration_including_bending():
    """That of the dynamics, bending included, and not only of the moment."""
    craft = Hypersonic()
    x, u = HypersonicState(85000.0, 7702.0, 0.028, 0.028, 0.0, 1.5, 3.0, 1.1, -2.0), HypersonicInput(0.26, 0.217)
    got = AngularAccelerometer().measure(craft.motion(0, x, u)).pitch_acceleration
    assert float(got) == pytest.approx(float(craft.dynamics(0.0, x, u).q), rel=1e-12)
    assert abs(float(got) - float(craft.forces_at(x, u).M) / craft.Iyy) > 0.1


def test_noise_is_white_with_the_given_deviation():
    """sigma 0.01 rad/s^2 for each sample at 200 Hz, the scenarios' setting, which is a density of 5e-7."""
    sensor = AngularAccelerometer()
    assert isinstance(sensor, Sensor)
    assert sensor.period == ms(5)
    z = _samples(sensor, _motion(0.2), 4000) - 0.2
    assert z.std() == pytest.approx(0.01, rel=0.05)
    assert abs(z.mean()) < 4 * 0.01 / np.sqrt(4000)
    assert abs(np.corrcoef(z[1:], z[:-1])[0, 1]) < 4 / np.sqrt(4000)
    assert not np.array_equal(z, _samples(sensor, _motion(0.2), 4000, seed=1) - 0.2)


def test_scale_and_offset_can_be_switched_off():
    sensor = AngularAccelerometer(noise=0.0, scale_factor=0.02, offset=-0.03)
    np.testing.assert_allclose(_samples(sensor, _motion(0.5), 3), 0.5 * 1.02 - 0.03, rtol=1e-14)
    for name in imperfections(AngularAccelerometer()):
        sensor = without(sensor, name)
    np.testing.assert_array_equal(_samples(sensor, _motion(0.5), 3), 0.5)
    with pytest.raises(InputError, match="no imperfection"):
        without(sensor, "bias")
