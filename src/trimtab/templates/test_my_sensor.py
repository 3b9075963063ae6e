"""Tests of the sensor, alone and in a flight: pytest test_my_sensor.py"""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from trimtab import build, replace, simulate
from trimtab.core.rng import key
from trimtab.core.signals import no_motion

FLOWN = build(f"{Path(__file__).with_name('my_sensor.py')}:scenario")
SENSOR = FLOWN.world.sensors["navigation"]
MOTION = replace(no_motion(), v_WB_B=np.array([1.0, 0.2, 0.0]), w_WB_B=np.array([0.0, 0.0, 0.3]))


def samples(run: Any, n: int = 4000) -> Any:
    """Return n samples of one flight with constant motion, with fields of shape (n,)."""
    times = np.arange(n) * SENSOR.period
    return jax.vmap(lambda t: SENSOR.step(t, SENSOR.init(replace(key(0), run=run)), MOTION)[1].value)(times)


def test_noise_has_the_declared_size():
    """The standard deviations of 4000 samples are within 6 % of the declared values. Four standard errors are 4.5 %."""
    z = samples(np.uint32(0))
    np.testing.assert_allclose(np.std(z.surge_velocity), SENSOR.velocity_noise, rtol=0.06)
    np.testing.assert_allclose(np.std(z.yaw_rate), SENSOR.rate_noise, rtol=0.06)
    np.testing.assert_allclose(np.std(z.heading), SENSOR.heading_noise, rtol=0.06)
    np.testing.assert_allclose(np.mean(z.surge_velocity), 1.0, atol=5 * SENSOR.velocity_noise / 63)


def test_bias_differs_between_flights():
    """The means of 64 flights with 300 samples each have the declared standard deviation."""
    runs = np.arange(64, dtype=np.uint32)
    means = np.mean(jax.vmap(lambda run: samples(run, 300).yaw_rate)(runs), axis=1) - 0.3
    assert 0.7 * SENSOR.rate_bias < np.std(means) < 1.3 * SENSOR.rate_bias


def test_measures_exactly_without_imperfections():
    """Without noise and bias, the samples are exact."""
    ideal = FLOWN.without("sensor-noise").without("gyro-bias").world.sensors["navigation"]
    exact, (_, sample) = ideal.measure(MOTION), ideal.step(0, ideal.init(key(0)), MOTION)
    assert float(sample.value.yaw_rate) == float(exact.yaw_rate) == 0.3
    assert float(sample.value.sway_velocity) == float(exact.sway_velocity) == 0.2


def test_hovercraft_reaches_its_speed():
    """A flight, compiled to C, ends within 0.1 m/s of the target, although the samples have errors."""
    log = simulate(FLOWN)
    assert abs(log.final["truth.surge_velocity"] - 2.8 / 2.6) < 0.1
    assert np.abs(log["sensors.navigation.value.yaw_rate"] - log["truth.yaw_rate"]).max() > SENSOR.rate_noise
