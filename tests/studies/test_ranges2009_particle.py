"""A particle filter on odometry and ranges: it finds position and heading and is consistent."""

import functools

import jax
import numpy as np
import pytest
from estimators.odometry_drives import BEACONS, DRIVE, drive, frames_of

from studies.ranges2009._odometry_particle import OdometryParticle
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.rotation import wrap
from trimtab.estimators.ranging.odometry import OdometryNoise, RadioErrors

FILTER = OdometryParticle(
    noise=OdometryNoise(slip=0.05, turn=3e-3, bias_walk=1e-4),
    errors=RadioErrors(noise=0.2, scale=0.05, sigma_scale=0.02, sigma_error=0.1),
    beacons=BEACONS,
    N=100,
)
LATE = slice(DRIVE // 2, None)


@functools.cache
def program():
    def fly(estimator, frames, draws):
        return jax.lax.scan(lambda s, f: estimator.step(f.t, s, f), estimator.init(draws), frames)

    return jax.jit(fly)


def run(world, seed=0, estimator=FILTER):
    return program()(estimator, frames_of(world), key(seed))


def errors(world, estimates):
    """Return the errors of position (m) and heading (rad), each (n,)."""
    s = estimates.state
    return np.hypot(s.north - world.north, s.east - world.east), np.asarray(wrap(s.heading - world.heading))


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
def test_localises_without_an_initial_position(seed):
    world = drive(seed)
    _, estimates = run(world, seed)
    place, heading = errors(world, estimates)
    assert np.asarray(estimates.valid)[LATE].all()
    assert np.sqrt(np.mean(place[LATE] ** 2)) < 0.4
    assert np.abs(heading[LATE]).max() < 0.15
    s = estimates.state
    normalised = ((s.north - world.north) / s.sigma_north)[LATE], ((s.east - world.east) / s.sigma_east)[LATE]
    assert np.mean(np.square(normalised)) < 3.0


@pytest.mark.thorough
def test_estimate_is_invalid_while_the_pose_is_ambiguous():
    """Two positions and every heading fit the first two ranges."""
    _, estimates = run(drive(1))
    valid = np.asarray(estimates.valid)
    assert not valid[:10].any()
    assert valid.any()


@pytest.mark.thorough
def test_tolerates_ten_percent_range_outliers():
    world = drive(3)
    wild = (np.random.default_rng(0).random(world.range.shape) < 0.1) & world.arrived
    state, estimates = run(world._replace(range=np.where(wild, world.range + 8.0, world.range)), 1)
    place, _ = errors(world, estimates)
    assert np.sqrt(np.mean(place[LATE] ** 2)) < 0.5
    assert int(state.drive.fix.rejected) >= 0.7 * wild.sum()


@pytest.mark.thorough
def test_same_seed_repeats_exactly_and_another_agrees_closely():
    world = drive(2)
    one, again, other = (np.asarray(run(world, seed)[1].state.north) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    np.testing.assert_allclose(one[-1], other[-1], atol=0.2)


@pytest.mark.parametrize("change", [{"N": 1}, {"beacons": BEACONS[:1]}, {"beacons": np.zeros((4, 2))}])
def test_rejects_too_few_particles_or_beacons(change):
    with pytest.raises(InputError, match="OdometryParticle"):
        replace(FILTER, **change).check()


@pytest.mark.thorough
def test_estimate_is_invalid_while_ranges_are_rejected():
    """For 30 s, all ranges are 30 m too long and are rejected."""
    world, k = drive(0), np.arange(DRIVE)
    wrong = ((k >= DRIVE // 2) & (k < DRIVE * 3 // 4))[:, None]
    state, estimates = run(world._replace(range=np.where(world.arrived & wrong, world.range + 30.0, world.range)))
    valid = np.asarray(estimates.valid)
    assert int(state.drive.fix.rejected) >= 70
    assert valid[DRIVE // 2 - 100 : DRIVE // 2].all()
    assert not valid[DRIVE * 3 // 4 - 200 : DRIVE * 3 // 4].any()
    assert valid[-100:].all()
    assert errors(world, estimates)[0][-1] < 1.0


@pytest.mark.thorough
def test_estimate_stays_invalid_if_ranges_never_fit():
    """From the middle to the end, all ranges are 30 m too long."""
    world = drive(0)
    later = (np.arange(DRIVE) >= DRIVE // 2)[:, None]
    _, estimates = run(world._replace(range=np.where(world.arrived & later, world.range + 30.0, world.range)))
    assert not np.asarray(estimates.valid)[DRIVE // 2 + 100 :].any()
