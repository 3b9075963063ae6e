"""The dive sensor: its reading of a vehicle's state, and its noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.sensors.dive import DiveSensor
from trimtab.vehicles.torpedo import Torpedo, TorpedoControls, TorpedoState

NAMES = ("depth", "roll", "pitch", "heading", "surge_velocity", "pitch_rate", "yaw_rate")


def values(reading):
    return [float(getattr(reading, n)) for n in NAMES]


def test_reading_equals_the_vehicle_state_without_noise():
    attitude = np.array(quaternion.from_euler(*map(jnp.asarray, (0.1, -0.2, 0.9))))
    x = TorpedoState(np.array([1, 2, 7.0]), attitude, np.array([1.5, 0.1, 0.2]), np.array([0.3, 0.4, 0.5]))
    sensor = DiveSensor()
    assert isinstance(sensor, Sensor)
    vehicle, still = Torpedo(), TorpedoControls(0.0, 0.0, 0.0)
    state = sensor.init(key(0))
    seen = jax.jit(lambda x: sensor.step(0, state, vehicle.motion(0, x, still))[1].value)(to_arrays(x))
    np.testing.assert_allclose(values(seen), [7.0, 0.1, -0.2, 0.9, 1.5, 0.4, 0.5], rtol=1e-12)


@pytest.mark.thorough
def test_noises_are_independent_with_the_given_deviations():
    sigmas = {
        "depth_noise": 0.05,
        "attitude_noise": 0.01,
        "heading_noise": 0.02,
        "velocity_noise": 0.1,
        "rate_noise": 0.3,
    }
    sensor, o = DiveSensor(**sigmas), jnp.zeros(3)
    state, still = sensor.init(key(3)), Motion(0, o, o, o, o, o, o)
    step = jax.jit(jax.vmap(lambda k: sensor.step(k * sensor.period, state, still)[1].value))
    n = 20_000
    seen = step(jnp.arange(n))
    samples = np.array([getattr(seen, name) for name in NAMES])
    want = np.array([0.05, 0.01, 0.01, 0.02, 0.1, 0.3, 0.3])
    np.testing.assert_allclose(samples.std(axis=1), want, rtol=4 / np.sqrt(2 * n))
    np.testing.assert_allclose(samples.mean(axis=1) / want, 0.0, atol=4 / np.sqrt(n))
    np.testing.assert_allclose(np.corrcoef(samples) - np.eye(7), 0.0, atol=4.5 / np.sqrt(n))


def test_noise_can_be_switched_off():
    noisy = DiveSensor(depth_noise=0.05, rate_noise=0.3)
    assert list(imperfections(noisy)) == ["navigation-error"]
    quiet = without(noisy, "navigation-error")
    assert (quiet.depth_noise, quiet.rate_noise) == (0.0, 0.0)
