"""The measured state of a multirotor: sizes of its noise, length of its quaternion, and nothing else."""

import jax
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.sensors.multirotor_state import MultirotorStateSensor
from trimtab.vehicles.quadrotor import MultirotorState

SENSOR = MultirotorStateSensor()
STATE = MultirotorState(
    np.array([1.0, -2, -3]),
    np.array([0.5, 0, -1]),
    np.asarray(quaternion.from_euler(0.3, -0.2, 2.0)),
    np.array([0.1, -0.4, 3.0]),
    np.array([300.0, 310, 290, 305]),
)


def readings(sensor, n=20_000):
    take = jax.jit(jax.vmap(lambda t: sensor.step(t, sensor.init(key(3)), STATE)[1].value))
    return take(np.arange(n, dtype=np.int64) * sensor.period)


@pytest.mark.thorough
def test_noise_has_the_given_deviations():
    z = readings(SENSOR)
    for name, size in (("position", 0.002), ("velocity", 0.02), ("rate", 0.02), ("rotor_speed", 2.0)):
        off = np.asarray(getattr(z, name)) - getattr(STATE, name)
        np.testing.assert_allclose(off.std(axis=0), size, rtol=0.03)
        np.testing.assert_allclose(off.mean(axis=0), 0, atol=5 * size / np.sqrt(20_000))
    turn = jax.vmap(lambda q: quaternion.local(STATE.attitude, q))(z.attitude)
    np.testing.assert_allclose(np.asarray(turn).std(axis=0), 0.004, rtol=0.03)
    np.testing.assert_allclose(np.linalg.norm(z.attitude, axis=1), 1, atol=1e-14)


def test_noiseless_reading_equals_the_state():
    still = replace(SENSOR, position_noise=0.0, velocity_noise=0.0, attitude_noise=0.0, rate_noise=0.0, speed_noise=0.0)
    z = readings(still, 3)
    for name in ("position", "velocity", "attitude", "rate", "rotor_speed"):
        np.testing.assert_allclose(getattr(z, name), np.tile(getattr(STATE, name), (3, 1)), atol=1e-15)
