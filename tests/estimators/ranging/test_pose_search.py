"""Pose from ranges of several instants: exact without noise, and the ranges' agreement tells outliers apart."""

import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.rotation import planar
from trimtab.estimators.ranging.pose_search import (
    KEPT,
    RecentRanges,
    fit_pose,
    move_ranges,
    no_recent_ranges,
    remember_range,
)

BEACONS = np.array([[-20.0, -15.0, -2.0], [18.0, -20.0, -1.0], [22.0, 19.0, -3.0], [-16.0, 21.0, -2.0]])
SCALE, SIGMA = (0.05, 0.02), 0.2
FIT = jax.jit(lambda recent, number: fit_pose(recent, number, BEACONS, 0.0, SCALE, SIGMA))


def ranges_of(place, turn, scale=0.05, step=1.2, beacons=4):
    """Ranges on a curved path that ends at the place; the odometry's heading is off by -turn (rad)."""
    course = 0.3 + 0.1 * np.arange(KEPT)
    since = np.cumsum(step * np.stack([np.cos(course), np.sin(course)], axis=1), axis=0)
    beacon = np.arange(KEPT, dtype=np.int32) % beacons
    away = place - since @ np.asarray(planar(turn)).T - BEACONS[beacon, :2]
    ranges = (1 + scale) * np.sqrt(np.sum(away**2, axis=1) + BEACONS[beacon, 2] ** 2)
    return RecentRanges(beacon, ranges, since, np.ones(KEPT, bool))


@pytest.mark.parametrize("turn", [0.0, 0.4, -1.5, 3.0])
@pytest.mark.parametrize("place", [(3.0, -4.0), (35.0, 10.0)])
def test_recovers_pose_from_exact_ranges(place, turn):
    found = FIT(ranges_of(np.array(place), turn), 12)
    np.testing.assert_allclose(found.q[1:], [*place, 0.05], atol=0.3)  # the priors of turn and scale move it a little
    assert float(found.q[0]) == pytest.approx(turn, abs=0.03)
    assert float(found.chi_square) < 0.5
    assert int(found.freedom) == 9


def test_covariance_matches_monte_carlo():
    """300 draws of noise, and of the scale: each entry of q is off by its sigma."""
    rng, place, errors, chi_squares = np.random.default_rng(0), np.array([3.0, -4.0]), [], []
    for _ in range(300):
        scale = 0.05 + 0.02 * rng.standard_normal()
        exact = ranges_of(place, 0.0, scale)
        noisy = RecentRanges(exact.beacon, exact.range + SIGMA * rng.standard_normal(KEPT), exact.since, exact.rejected)
        found = FIT(noisy, 12)
        errors.append(np.asarray(found.q) - [0.0, *place, scale])
        chi_squares.append(float(found.chi_square))
    sigma = np.sqrt(np.diag(found.P))
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), sigma, rtol=0.15)
    assert np.mean(chi_squares) == pytest.approx(9.0, rel=0.1)


def test_outliers_fail_the_chi_square_test():
    """One range 3 m too long; all of four beacons too long by 5 m."""
    exact = ranges_of(np.array([3.0, -4.0]), 0.0)
    one, all_of_them = exact.range.copy(), exact.range + 5.0
    one[4] += 3.0
    for spoilt in (one, all_of_them):
        found = FIT(RecentRanges(exact.beacon, spoilt, exact.since, exact.rejected), 12)
        assert float(found.chi_square) > 4 * float(found.freedom)


def test_too_few_ranges_give_infinite_chi_square():
    recent = no_recent_ranges()
    assert not np.isfinite(float(FIT(recent, 12).chi_square))
    exact = ranges_of(np.array([3.0, -4.0]), 0.0)
    eleven = np.where(np.arange(KEPT) < 11, exact.range, 0.0)
    assert not np.isfinite(float(FIT(RecentRanges(exact.beacon, eleven, exact.since, exact.rejected), 12).chi_square))


def test_remembered_ranges_move_and_drop_the_oldest():
    recent, moved = no_recent_ranges(), np.array([1.0, -2.0])
    add = jax.jit(lambda r, *range_: remember_range(move_ranges(r, moved), *range_))
    for k in range(KEPT + 2):
        recent = add(recent, k % 4, 10.0 + k, np.zeros(2), k % 3 == 0)
    np.testing.assert_array_equal(recent.range, 10.0 + np.arange(KEPT + 1, 1, -1))
    np.testing.assert_array_equal(recent.since, np.outer(np.arange(KEPT), [1.0, -2.0]))
    np.testing.assert_array_equal(recent.rejected, np.arange(KEPT + 1, 1, -1) % 3 == 0)
    np.testing.assert_array_equal(recent.beacon, np.arange(KEPT + 1, 1, -1) % 4)


@pytest.mark.thorough
def test_pose_search_lowers_to_generated_c():
    assert lower_function(lambda recent: fit_pose(recent, 12, BEACONS, 0.0, SCALE, SIGMA), (no_recent_ranges(),)).text(
        "f"
    )
