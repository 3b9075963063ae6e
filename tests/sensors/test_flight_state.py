"""The measured part of the hypersonic vehicle's state, through the motion, in the SI."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion
from trimtab.sensors.flight_state import FlightStateSensor
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

NAMES = ("altitude", "climb", "speed", "alpha", "pitch_rate")


def test_reading_equals_the_vehicle_state_in_si():
    x, u = HypersonicState(85000.0, 7702.0, 0.03, 0.05, 0.01, 0.9, 0.0, 0.7, 0.0), HypersonicInput(0.3, 0.2)
    sensor = FlightStateSensor()
    assert isinstance(sensor, Sensor)
    state = sensor.init(key(0))
    seen = jax.jit(lambda x, u: sensor.step(0, state, Hypersonic().motion(0, x, u))[1].value)(x, u)
    want = [85000 * 0.3048, 7702 * 0.3048 * np.sin(0.02), 7702 * 0.3048, 0.03, 0.01]
    np.testing.assert_allclose([float(getattr(seen, n)) for n in NAMES], want, rtol=1e-12)


def test_climb_rate_is_correct_at_any_attitude():
    attitude, velocity, o = jnp.array([0.4, -0.3, 1.2]), jnp.array([50.0, -7.0, 20.0]), jnp.zeros(3)
    seen = FlightStateSensor().measure(Motion(0, o, attitude, velocity, o, o, o))
    assert float(seen.climb) == pytest.approx(-float((from_euler(*attitude) @ velocity)[2]), rel=1e-12)


def test_noises_are_independent_with_the_given_deviations():
    sigmas = np.array([1.0, 0.2, 0.5, 1e-3, 2e-4])
    sensor = FlightStateSensor(*sigmas)
    state, o = sensor.init(key(3)), jnp.zeros(3)
    still = Motion(0, o, o, jnp.array([100.0, 0, 0]), o, o, o)
    step = jax.jit(jax.vmap(lambda k: sensor.step(k * sensor.period, state, still)[1].value))
    seen = step(jnp.arange(3000, dtype=np.int64))
    z = np.stack([np.asarray(getattr(seen, n)) for n in NAMES])
    np.testing.assert_allclose(z.std(1), sigmas, rtol=0.06)
    assert np.abs(np.corrcoef(z) - np.eye(5)).max() < 4 / np.sqrt(3000)


def test_noise_can_be_switched_off():
    sensor = FlightStateSensor(1.0, 1.0, 1.0, 1.0, 1.0)
    for name in imperfections(FlightStateSensor()):
        sensor = without(sensor, name)
    assert [getattr(sensor, f"{n}_noise") for n in NAMES] == [0.0] * 5
    with pytest.raises(InputError, match="no imperfection"):
        without(sensor, "wind")
