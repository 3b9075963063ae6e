"""The receiver of raw ranges: geometry, clock and errors against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.rotation import DEG
from trimtab.core.signals import Motion, no_motion
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.environment.geodetic import TangentPlane, to_ecef
from trimtab.sensors.gnss import Outages, antenna
from trimtab.sensors.gnss_ranges import ORBIT, ORBITAL_SPEED, PLACES, VELOCITIES, GnssRanges, satellites_from_ecef, sky

QUIET = GnssRanges(noise=0.0, rate_noise=0.0, clock_noise=0.0, drift_walk=0.0)
MOTION = Motion(
    np.int64(ms(700)),
    *(np.array(a) for a in ((10.0, -4.0, -50.0), (0.4, -0.3, 2.0), (20.0, 1.0, -2.0), (0.5, -0.2, 0.8))),
    np.zeros(3),
    np.zeros(3),
)


def samples(sensor, n, seed=0):
    def step(state, i):
        t = i * sensor.period
        return sensor.step(t, state, replace(no_motion(), t=t))

    return jax.jit(lambda: jax.lax.scan(step, sensor.init(key(seed)), jnp.arange(n)))()[1]


def test_satellite_positions_match_azimuth_and_elevation():
    places, velocities = sky([90 * DEG, 0.0], [0.0, 90 * DEG], [0.0, 90 * DEG])
    np.testing.assert_allclose(places[0], [0, ORBIT, 0], atol=1e-6)
    np.testing.assert_allclose(places[1], [0, 0, -ORBIT], atol=1e-6)
    np.testing.assert_allclose(velocities[0], [0, 0, -ORBITAL_SPEED], atol=1e-9)  # up
    np.testing.assert_allclose((places * velocities).sum(1), 0, atol=1e-3)


def test_range_rates_are_derivatives_of_the_distances():
    reading, found = jax.jit(lambda m: (QUIET.measure(m), antenna(m, QUIET.lever_arm)))(MOTION)
    place, velocity = (np.asarray(v) for v in found)
    t, h = to_seconds(MOTION.t), 1e-3
    there = PLACES + t * VELOCITIES
    np.testing.assert_allclose(reading.pseudorange, np.linalg.norm(there - place, axis=1), rtol=1e-14)
    after, before = (np.linalg.norm(there + s * h * VELOCITIES - place - s * h * velocity, axis=1) for s in (1, -1))
    np.testing.assert_allclose(reading.range_rate, (after - before) / (2 * h), atol=1e-4)
    assert reading.received.all()


@pytest.mark.thorough
def test_least_squares_recovers_position_velocity_and_clock():
    """By SciPy's least squares from the sample alone: the clock at 1 s has run on by its drift."""
    s = samples(QUIET, 120)
    i = int(np.flatnonzero(s.fresh)[-1])
    t = float(to_seconds(s.t[i]))
    value = jax.tree.map(lambda a: np.asarray(a[i]), s.value)
    places, moving = value.satellites.reshape(8, 3), value.satellite_velocities.reshape(8, 3)

    def misfit(x):
        apart = places - x[:3]
        distance = np.linalg.norm(apart, axis=1)
        rate = (apart * (moving - x[3:6])).sum(1) / distance
        return np.concatenate([distance + x[6] - value.pseudorange, rate + x[7] - value.range_rate])

    x = least_squares(misfit, np.zeros(8), x_scale=[1, 1, 1, 1, 1, 1, 1e3, 10], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    np.testing.assert_allclose(x[:3], QUIET.lever_arm, atol=1e-3)
    np.testing.assert_allclose(x[3:6], 0, atol=1e-4)
    np.testing.assert_allclose(x[6:], [1500 + 20 * t, 20], atol=2e-3)


def test_clock_variances_match_the_noise_model():
    """Over 200 clocks, 4 s: drift's variance q t; bias's n t + q t³/3."""
    sensor = replace(QUIET, clock_noise=0.3, drift_walk=0.2, period=ms(200), clock_drift=0.0, clock_bias=0.0)
    distance = np.linalg.norm(PLACES[5] - np.asarray(QUIET.lever_arm))
    run = jax.jit(
        lambda k: (
            jax.lax.scan(lambda s, i: sensor.step(i * ms(200), s, no_motion()), sensor.init(k), jnp.arange(22))[0].clock
        )
    )
    clocks = np.array([run(key(k)) for k in range(200)])
    t = 22 * 0.2
    np.testing.assert_allclose(clocks[:, 1].std(), 0.2 * np.sqrt(t), rtol=0.12)
    np.testing.assert_allclose(clocks[:, 0].std(), np.sqrt(0.09 * t + 0.04 * t**3 / 3), rtol=0.15)
    assert distance > 2e7


@pytest.mark.thorough
def test_outage_keeps_only_the_remaining_satellites():
    hidden = Outages(start=seconds(1), length=seconds(1))
    s = samples(replace(QUIET, outages=hidden, remaining=3), 300)
    fresh = np.asarray(s.fresh)
    made = np.asarray(s.t)[fresh] * 1e-7
    counts = np.asarray(s.value.received)[fresh].sum(1)
    np.testing.assert_array_equal(counts, np.where((made >= 1.0) & (made < 2.0), 3, 8))
    gone = np.asarray(s.value.pseudorange)[fresh][(made >= 1.0) & (made < 2.0)]
    assert (gone[:, 3:] == 0).all()
    none = samples(replace(QUIET, outages=hidden, remaining=0), 300)
    made = np.asarray(none.t)[np.asarray(none.fresh)] * 1e-7
    assert not ((made >= 1.0) & (made < 2.0)).any()


def test_satellites_below_five_degrees_are_not_received():
    places, velocities = sky([0.0, 0.0], [4 * DEG, 6 * DEG], [0.0, 0.0])
    received = jax.jit(replace(QUIET, satellites=places, velocities=velocities).measure)(no_motion()).received
    np.testing.assert_array_equal(received, [False, True])


def test_almanac_converts_from_ecef_to_local_frame():
    """A satellite straight above the origin is straight above; its velocity keeps its size."""
    plane = TangentPlane(0.68, -1.34, 100.0)
    above = np.asarray(to_ecef(0.68, -1.34, 100.0 + ORBIT))
    east = np.array([-np.sin(-1.34), np.cos(-1.34), 0.0])
    places, velocities = satellites_from_ecef(plane, above[None], 3000 * east[None])
    np.testing.assert_allclose(places[0], [0, 0, -ORBIT], atol=1e-6)
    np.testing.assert_allclose(velocities[0], [0, 3000, 0], atol=1e-9)


def test_rejects_satellite_velocities_without_positions():
    with pytest.raises(InputError, match="must both"):
        replace(QUIET, velocities=np.zeros((7, 3))).check()
