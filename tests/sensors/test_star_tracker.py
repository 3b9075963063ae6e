"""The star tracker: noise by axis, blinding, and latency."""

import jax
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.imperfections import without, without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import DEG, from_euler
from trimtab.core.signals import Motion
from trimtab.core.time import ms, seconds
from trimtab.sensors.star_tracker import ARC_SECOND, StarTracker

O = np.zeros(3)
ATTITUDE = np.array([0.3, -0.2, 1.0])


def motion(t, rate=O, attitude=ATTITUDE):
    return Motion(t, O, attitude, O, np.array(rate, float), O, O)


def fly(sensor, rates, seed=0):
    """Values, ages and freshness of samples along rates (n, 3)."""
    return rollout(to_arrays(sensor), key(seed), np.asarray(rates, float))


@jax.jit
def rollout(sensor, key, rates):
    def one(state, now):
        t, rate = now
        return sensor.step(t, state, Motion(t, O, ATTITUDE, O, rate, O, O))

    times = np.arange(len(rates), dtype=np.int64) * sensor.period
    return jax.lax.scan(one, sensor.init(key), (times, rates))[1]


@pytest.mark.thorough
def test_noise_about_the_boresight_is_ten_times_larger():
    sensor = replace(without(StarTracker(), "star-tracker-misalignment"), period=ms(200))
    seen = fly(sensor, np.zeros((3000, 3))).value.attitude[5:]
    q_BS = quaternion.from_euler(*np.asarray(sensor.mounting))
    q_WS = quaternion.multiply(quaternion.from_euler(*ATTITUDE), q_BS)
    errors = jax.vmap(lambda q: quaternion.local(q_WS, quaternion.multiply(q, q_BS)))(seen)
    np.testing.assert_allclose(np.std(errors, axis=0) / ARC_SECOND, [5, 5, 50], rtol=0.06)
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0, rtol=1e-12)


@pytest.mark.thorough
def test_misalignment_is_drawn_per_run_and_constant():
    sensor = without(without(StarTracker(), "star-tracker-noise"), "star-tracker-roll-noise")
    runs = [fly(sensor, np.zeros((60, 3)), seed).value.attitude[25:] for seed in range(60)]
    assert all(np.ptp(np.asarray(r), axis=0).max() < 1e-12 for r in runs)
    true = quaternion.from_euler(*ATTITUDE)
    errors = np.array([quaternion.local(true, r[0]) for r in runs])
    assert errors.std() / ARC_SECOND == pytest.approx(20, rel=0.2)


@pytest.mark.thorough
def test_sample_is_late_and_stamped_with_measurement_time():
    seen = fly(StarTracker(), np.zeros((100, 3)))
    fresh = np.flatnonzero(np.asarray(seen.fresh))
    np.testing.assert_array_equal(fresh * ms(10), seconds(0.1) + ms(200) * np.arange(5))
    np.testing.assert_allclose(np.asarray(seen.age)[fresh], 0.1)
    prompt = fly(without(StarTracker(), "star-tracker-latency"), np.zeros((100, 3)))
    np.testing.assert_allclose(np.asarray(prompt.age)[::20], 0.0, atol=1e-12)


def test_fast_turn_holds_last_attitude_and_reports_not_tracking():
    rates = np.zeros((100, 3))
    rates[30:70] = [0.0, 0.0, 3 * DEG]
    seen = fly(StarTracker(), rates)
    tracking = np.asarray(seen.value.tracking)
    np.testing.assert_array_equal(tracking[[15, 29, 52, 75, 99]], [True, True, False, False, True])
    np.testing.assert_array_equal(seen.value.attitude[52], seen.value.attitude[49])
    assert np.asarray(fly(without(StarTracker(), "star-tracker-rate-limit"), rates).value.tracking)[15:].all()


def test_sun_within_thirty_degrees_blinds_the_tracker():
    sensor = StarTracker()
    boresight = from_euler(*ATTITUDE) @ from_euler(*np.asarray(sensor.mounting))[:, 2]
    across = np.cross(boresight, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    for degrees, seen in ((0.0, False), (29.0, False), (31.0, True), (180.0, True)):
        sun = np.cos(degrees * DEG) * boresight + np.sin(degrees * DEG) * across
        assert bool(replace(sensor, sun=7.0 * sun).sees(motion(0))) == seen
    assert bool(without(replace(sensor, sun=boresight), "star-tracker-blinding").sees(motion(0)))


@pytest.mark.thorough
def test_ideal_tracker_returns_the_true_attitude():
    seen = fly(without_any(StarTracker()), np.zeros((5, 3)))
    np.testing.assert_allclose(seen.value.attitude[0], quaternion.from_euler(*ATTITUDE), atol=1e-15)
