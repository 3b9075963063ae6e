import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Sensor
from trimtab.core.record import replace
from trimtab.core.rng import Key, key
from trimtab.core.signals import Motion
from trimtab.core.time import ms, seconds
from trimtab.sensors.navigation_errors import NavigationErrors

RUNS = 20_000
TRUTH = np.array([0.4, -0.3, 2.0, 9.5])
SENSOR = NavigationErrors()


def motion(heading=9.5):
    o = np.zeros(3)
    return Motion(0, o, jnp.array([0, 0, heading]), np.array([0.4, -0.3, 0]), np.array([0, 0, 2.0]), o, o)


@jax.jit
def _seen(sensor, keys, times, heading):
    def one(key, t):
        seen = sensor.step(t, sensor.init(key), motion(heading))[1].value
        return jnp.stack([seen.surge_velocity, seen.sway_velocity, seen.yaw_rate, seen.heading])

    return jax.vmap(lambda key: jax.vmap(lambda t: one(key, t))(times))(keys)


def errors(sensor, times, runs=RUNS, seed=5, stream=0):
    """Surge, sway, yaw rate and heading errors, shape (runs, times, 4)."""
    keys = Key(np.full(runs, seed, np.uint32), np.arange(runs, dtype=np.uint32), stream)
    return np.asarray(_seen(sensor, keys, np.asarray(times), 9.5)) - TRUTH


def assert_spread(sample, sigma):
    """Mean 0 and standard deviation sigma, within four of their own standard errors."""
    assert abs(sample.mean()) < 4 * sigma / np.sqrt(len(sample))
    assert sample.std() == pytest.approx(sigma, rel=4 / np.sqrt(2 * len(sample)))


@pytest.mark.parametrize("reading", ["A", "B", "C"])
def test_error_deviations_match_the_closed_form(reading):
    """sigma tau for the integrals, and for the yaw rate the root of the sum of squares of bias and noise."""
    sensor = NavigationErrors.reading(reading)
    tau = 0.504
    du, dv, dr, dpsi = errors(sensor, [seconds(3) + ms(504)])[:, 0].T
    assert_spread(du, sensor.accelerometer_bias * tau)
    assert_spread(dv, sensor.accelerometer_bias * tau)
    assert_spread(dr, np.hypot(sensor.gyro_bias, sensor.gyro_noise))
    assert_spread(dpsi, sensor.gyro_bias * tau)
    assert_spread(dr - dpsi / tau, sensor.gyro_noise)  # what is left of the yaw rate's error is the noise
    both = np.corrcoef([du, dv, dpsi, dr - dpsi / tau])
    assert (abs(both - np.eye(4)) < 4.5 / np.sqrt(RUNS)).all()


def test_interpretations_match_the_published_numbers():
    """2.5 cm/s^2, 1 deg/s, 0.5 deg/s: [1] Z. Kulis, University of Maryland, 2006, section 6.1."""
    spreads = {r: NavigationErrors.reading(r) for r in "ABC"}

    def rounded(r):
        return tuple(float(f"{x:.3g}") for x in (r.accelerometer_bias, r.gyro_bias, r.gyro_noise))

    assert rounded(spreads["A"]) == (0.025, 0.0175, 0.00873)
    assert rounded(spreads["B"]) == (0.0158, 0.0175, 0.0123)
    assert rounded(spreads["C"]) == (0.158, 0.132, 0.0934)
    assert rounded(SENSOR) == rounded(spreads["C"])
    assert NavigationErrors.reading("A", period=ms(1)).period == ms(1)
    with pytest.raises(InputError, match=r"unknown interpretation 'D'.*\nChoices: A, B, C"):
        NavigationErrors.reading("D")


@pytest.mark.thorough
def test_errors_grow_linearly_and_reset_each_second():
    times = np.arange(0, seconds(3), ms(6))
    tau = (times % seconds(1)) * 1e-7
    du, dv, dr, dpsi = errors(replace(SENSOR, gyro_noise=0.0), times, runs=3)[1].T
    for k in range(3):
        now = times // seconds(1) == k
        for error in (du, dv, dpsi):
            slope = error[now][-1] / tau[now][-1]
            assert abs(slope) > 1e-4
            np.testing.assert_allclose(error[now], slope * tau[now], rtol=0, atol=1e-14)
        np.testing.assert_allclose(dr[now], dpsi[now][-1] / tau[now][-1], rtol=0, atol=1e-13)
    assert (errors(SENSOR, [0, seconds(1)], runs=3)[..., [0, 1, 3]] == 0).all()


def test_bias_is_redrawn_each_second_and_noise_each_sample():
    times = [ms(600), ms(606), seconds(1) + ms(596)]
    found = errors(SENSOR, times)
    bias, noise = found[..., 3] / [0.6, 0.606, 0.596], found[..., 2] - found[..., 3] / [0.6, 0.606, 0.596]
    np.testing.assert_allclose(bias[:, 0], bias[:, 1], atol=1e-13)
    for a, b in ((bias[:, 0], bias[:, 2]), (noise[:, 0], noise[:, 1]), (noise[:, 0], noise[:, 2])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(RUNS)


@pytest.mark.thorough
def test_errors_are_reproducible_for_the_same_key():
    times = np.arange(1, 50) * ms(6)
    first = errors(SENSOR, times, runs=10)
    np.testing.assert_array_equal(first, errors(SENSOR, times, runs=10))
    for other in (errors(SENSOR, times, runs=10, seed=6), errors(SENSOR, times, runs=10, stream=77)):
        assert not np.isclose(first, other, rtol=1e-9, atol=0).any()


def test_switching_one_error_off_leaves_the_others_unchanged():
    times = np.arange(1, 50) * ms(6)
    full = errors(SENSOR, times, runs=5)
    quiet = errors(replace(SENSOR, accelerometer_bias=0.0, gyro_bias=0.0), times, runs=5)
    noise = full[..., 2] - full[..., 3] / (times * 1e-7)
    np.testing.assert_allclose(quiet[..., 2], noise, rtol=0, atol=1e-12)
    assert (quiet[..., [0, 1, 3]] == 0).all()


def test_ideal_sensor_keeps_its_period_and_has_zero_error():
    ideal = without(SENSOR, "navigation-error")
    assert ideal.period == ms(6)
    assert (errors(ideal, np.arange(40) * ms(6), runs=3) == 0).all()
    with pytest.raises(InputError, match=r"no imperfection 'bias'.*\nChoices: navigation-error"):
        without(SENSOR, "bias")


@pytest.mark.thorough
def test_heading_range_option_gives_positive_heading():
    sensor = replace(SENSOR, heading_range="positive")
    keys = Key(np.full(200, 1, np.uint32), np.arange(200, dtype=np.uint32))
    for heading in (9.5, -0.01, 0.01, -30.0):
        counted = np.asarray(_seen(SENSOR, keys, np.array([ms(900)]), heading))[:, 0, 3]
        positive = np.asarray(_seen(sensor, keys, np.array([ms(900)]), heading))[:, 0, 3]
        assert abs(counted - heading).max() < 1
        assert ((positive >= 0) & (positive < 2 * np.pi)).all()
        np.testing.assert_allclose(np.exp(1j * positive), np.exp(1j * counted), atol=1e-12)
    assert SENSOR.measure(motion()).heading == 9.5
    assert sensor.measure(motion()).heading == pytest.approx(9.5 - 2 * np.pi)


def test_samples_are_fresh_and_have_no_delay():
    assert isinstance(SENSOR, Sensor)
    state = SENSOR.init(key(3))
    after, sample = SENSOR.step(ms(12), state, motion())
    assert after is state
    assert (sample.t, sample.age, sample.fresh, sample.valid) == (ms(12), 0.0, True, True)
