"""The fixed-lag estimate of a few seconds ago, compared with a smoother implemented here."""

import functools

import jax
import numpy as np
import pytest
from estimators.odometry_drives import DRIVE, TICKS, drive, frames_of
from estimators.ranging.test_odometry import FILTER

from studies.ranges2009._odometry_lag import LaggedOdometry
from trimtab.core.errors import InputError
from trimtab.core.rng import key

LAGGED = LaggedOdometry(filter=FILTER, lag=4.0, kept=5)


@functools.cache
def program(kind):
    def fly(estimator, frames):
        return jax.lax.scan(lambda s, f: estimator.step(f.t, s, f), estimator.init(key(0)), frames)

    return jax.jit(fly)


def fly(world, estimator):
    state, estimates = program(type(estimator))(estimator, frames_of(world))
    return state, jax.tree.map(np.asarray, estimates)


def place_error(world, estimates, rows):
    """North and east (n, 2) over the truth of the time that the estimate is of, which is an instant of odometry."""
    k = np.round((estimates.t[rows] * 1e-7 - estimates.age[rows]) / (TICKS * 1e-7)).astype(int)
    s = estimates.state
    return np.stack([s.north[rows] - world.north[k], s.east[rows] - world.east[k]], axis=1)


@pytest.mark.thorough
def test_kept_poses_do_not_change_the_current_estimate():
    """The kept poses are appended to the filter's state and do not change the current estimate."""
    world = drive(1)
    lagged, _ = fly(world, LAGGED)
    plain, _ = fly(world, FILTER)
    n = plain.x.shape[0]
    np.testing.assert_allclose(lagged.drive.x[:n], plain.x, atol=1e-9)
    np.testing.assert_allclose(lagged.drive.P[:n, :n], plain.P, atol=1e-10)


@pytest.mark.thorough
def test_lagged_estimate_is_more_accurate_and_consistent():
    better, squares = [], []
    for seed in range(30):
        world = drive(seed)
        _, late = fly(world, LAGGED)
        _, now = fly(world, FILTER)
        rows = np.flatnonzero(late.valid)[200::150]
        assert ((late.age[rows] >= 4.0 - 1e-6) & (late.age[rows] <= 5.1)).all()
        error = place_error(world, late, rows)
        better.append([np.sum(error**2), np.sum(place_error(world, now, rows) ** 2)])
        s = late.state
        a, b, c = (np.asarray(v)[rows] for v in (s.sigma_north**2, s.covariance_north_east, s.sigma_east**2))
        squares.append(
            (c * error[:, 0] ** 2 - 2 * b * error[:, 0] * error[:, 1] + a * error[:, 1] ** 2) / (a * c - b * b)
        )
    late, now = np.sum(better, axis=0)
    assert late < 0.8 * now
    assert 1.6 < np.mean(squares) < 2.4


@pytest.mark.thorough
def test_lagged_estimate_becomes_valid_after_the_lag():
    _, late = fly(drive(2), LAGGED)
    first = int(np.argmax(late.valid))
    assert 39 <= first <= 51
    assert late.valid[first:].all()
    assert first < DRIVE


def test_rejects_a_single_kept_pose():
    with pytest.raises(InputError, match="kept must be at least 2"):
        LaggedOdometry(kept=1).check()
