"""The barometer: the standard's pressure and its height, and each error by itself."""

import jax
import numpy as np
import pytest

from trimtab.core.imperfections import imperfections, without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion, SurroundingAir
from trimtab.core.time import ms
from trimtab.environment.atmosphere import pressure_altitude, standard_atmosphere
from trimtab.sensors.barometer import Barometer

O = np.zeros(3)
IDEAL = without_any(Barometer())


def motion(height, speed=0.0):
    return Motion(np.int64(0), np.array([0.0, 0.0, -height]), O, np.array([speed, 0.0, 0.0]), O, O, O)


def samples(sensor, motions, seed=0):
    """Pressures (n,) along a batch of motions."""
    batch = jax.tree.map(lambda *a: np.stack(a), *motions)
    return np.asarray(rollout(to_arrays(sensor), key(seed), batch))


@jax.jit
def rollout(sensor, key, motions):
    def one(state, now):
        t, motion = now
        state, sample = sensor.step(t, state, motion)
        return state, sample.value.pressure

    times = np.arange(len(motions.p_WB), dtype=np.int64) * sensor.period
    return jax.lax.scan(one, sensor.init(key), (times, motions))[1]


@pytest.mark.parametrize(
    ("height", "pressure"), [(0.0, 101325.0), (5000.0, 54048.0), (15000.0, 12111.0), (50000.0, 79.78)]
)
def test_pressure_matches_the_standard_atmosphere_table(height, pressure):
    """U.S. Standard Atmosphere 1976, table I."""
    seen = IDEAL.measure(motion(height))
    assert float(seen.pressure) == pytest.approx(pressure, rel=2e-4)
    assert float(seen.altitude) == pytest.approx(height, abs=1e-6)


def test_pressure_altitude_inverts_the_atmosphere_up_to_86_km():
    heights = np.linspace(-400, 86e3, 41)
    found = jax.jit(jax.vmap(lambda h: pressure_altitude(standard_atmosphere(h).pressure)))(heights)
    np.testing.assert_allclose(found, heights, rtol=0, atol=1e-5)


def test_altitude_uses_height_above_sea_level_when_known():
    over = replace(motion(10.0), air=SurroundingAir(height=np.float64(1500.0), velocity=O, rate=O))
    assert float(IDEAL.measure(over).altitude) == pytest.approx(1500.0)


@pytest.mark.thorough
def test_noise_bias_drift_and_resolution_have_given_sizes():
    still = [motion(100.0)] * 4000
    true = float(IDEAL.measure(still[0]).pressure)
    noisy = samples(replace(IDEAL, noise=3.0), still) - true
    assert noisy.std() == pytest.approx(3.0, rel=0.05)
    runs = np.array([samples(replace(IDEAL, turn_on_bias=50.0), still[:2], seed) - true for seed in range(200)])
    np.testing.assert_allclose(runs[:, 0], runs[:, 1])
    assert runs[:, 0].std() == pytest.approx(50.0, rel=0.2)
    walks = np.diff(samples(replace(IDEAL, drift=0.7), still))
    assert walks.std() == pytest.approx(0.7 * np.sqrt(0.02), rel=0.05)
    steps = samples(replace(IDEAL, noise=3.0, resolution=4.0), still)
    np.testing.assert_array_equal(steps % 4.0, 0.0)
    assert len(np.unique(steps)) > 2


def test_static_port_error_and_tube_lag_affect_pressure():
    q = 1.225 * 60.0**2 / 2
    seen = samples(replace(IDEAL, static_error=0.03), [motion(0.0, 60.0)] * 2)
    assert seen[0] - 101325.0 == pytest.approx(0.03 * q, rel=1e-3)
    jump = [motion(0.0)] * 10 + [motion(100.0)] * 10
    fall = samples(replace(IDEAL, lag=0.1), jump)
    measure = jax.jit(IDEAL.measure)
    low, high = (float(measure(m).pressure) for m in (jump[0], jump[-1]))
    np.testing.assert_allclose(fall[:10], low)
    np.testing.assert_allclose(fall[10:], high + (low - high) * np.exp(-0.2 * np.arange(1, 11)), rtol=1e-9)


def test_ideal_barometer_returns_the_true_pressure():
    names = {
        "barometer-noise",
        "barometer-bias",
        "barometer-drift",
        "barometer-lag",
        "static-port-error",
        "barometer-quantisation",
    }
    assert set(imperfections(Barometer())) == names
    np.testing.assert_array_equal(samples(IDEAL, [motion(50.0)] * 3), float(IDEAL.measure(motion(50.0)).pressure))
    assert Barometer().period == ms(20)
