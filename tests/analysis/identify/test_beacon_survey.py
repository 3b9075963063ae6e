import numpy as np
import pytest
from scipy.optimize import least_squares

from trimtab.analysis.identify.beacon_survey import survey_beacons
from trimtab.core.errors import InputError

BEACONS = np.array([[1.5, 1.5, -2.7], [1.4, -1.6, -2.6], [-1.5, -1.5, -2.8], [-1.6, 1.4, -2.7]])
RANGE, STEP = 0.004, 0.003


def loop(k=60):
    """A path that starts at the origin: a figure of eight."""
    s = np.linspace(0, 2 * np.pi, k)
    return np.stack([1.1 * np.sin(s), 0.8 * np.sin(2 * s)], axis=1)


def measured(seed, k=60, noise=1.0, missing=0.1):
    rng = np.random.default_rng(seed)
    path = loop(k)
    ranges = np.linalg.norm(np.concatenate([path, np.zeros((k, 1))], 1)[:, None] - BEACONS, axis=2)
    ranges = ranges + noise * RANGE * rng.normal(size=ranges.shape)
    ranges[rng.random(ranges.shape) < missing] = np.nan
    odometry = np.diff(path, axis=0) + noise * STEP * rng.normal(size=(k - 1, 2))
    return ranges, odometry


def surveyed(seed, **settings):
    return survey_beacons(*measured(seed, **settings), range_noise=RANGE, odometry_noise=STEP)


def test_noise_free_survey_is_exact():
    found = surveyed(0, noise=0.0)
    np.testing.assert_allclose(found.beacons, BEACONS, atol=1e-9)
    np.testing.assert_allclose(found.path, loop(), atol=1e-9)
    assert found.residual < 1e-6


def test_survey_matches_scipy_least_squares():
    """The same sum of squares, by scipy with differences for the Jacobian."""
    ranges, odometry = measured(1, k=25)
    found = survey_beacons(ranges, odometry, range_noise=RANGE, odometry_noise=STEP)

    def f(x):
        beacons, path = x[:12].reshape(4, 3), np.concatenate([np.zeros((1, 2)), x[12:].reshape(-1, 2)])
        distance = np.linalg.norm(np.concatenate([path, np.zeros((25, 1))], 1)[:, None] - beacons, axis=2)
        off = ((distance - ranges) / RANGE)[np.isfinite(ranges)]
        return np.concatenate([off, ((np.diff(path, axis=0) - odometry) / STEP).ravel()])

    best = least_squares(f, np.concatenate([BEACONS.ravel(), loop(25)[1:].ravel()]), xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(found.beacons, best.x[:12].reshape(4, 3), atol=1e-6)
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    np.testing.assert_allclose(found.covariance[2], covariance[6:9, 6:9], rtol=1e-3)


@pytest.mark.thorough
def test_survey_errors_match_the_covariance():
    """Normalised squared error of the beacons over 80 surveys: mean of chi-squared, within four of its errors."""
    runs = 80
    found = [surveyed(seed, k=25) for seed in range(runs)]
    squares = [e @ np.linalg.solve(c, e) for s in found for e, c in zip(s.beacons - BEACONS, s.covariance, strict=True)]
    assert np.mean(squares) == pytest.approx(3, abs=4 * np.sqrt(6 / runs))  # beacons of one survey hang together
    assert np.mean([s.residual for s in found]) == pytest.approx(1, abs=0.03)
    spread = np.std([s.beacons for s in found], axis=0)
    np.testing.assert_allclose(spread, np.mean([s.standard_errors() for s in found], axis=0), rtol=0.3)


def test_surveyed_path_is_better_than_odometry_alone():
    """Odometry alone drifts by a centimetre or more; the ranges correct the path."""
    ranges, odometry = measured(3)
    found = survey_beacons(ranges, odometry, range_noise=RANGE, odometry_noise=STEP)
    alone = np.concatenate([np.zeros((1, 2)), np.cumsum(odometry, axis=0)])
    drift = np.sqrt(np.mean((alone - loop()) ** 2))
    assert np.sqrt(np.mean((found.path - loop()) ** 2)) < 0.5 * drift
    assert abs(found.beacons - BEACONS).max() < 0.03


def test_rejects_invalid_or_insufficient_survey_data():
    ranges, odometry = measured(0)
    with pytest.raises(InputError, match="shape"):
        survey_beacons(ranges, odometry[:-1], range_noise=RANGE, odometry_noise=STEP)
    with pytest.raises(InputError, match="noise"):
        survey_beacons(ranges, odometry, range_noise=0.0, odometry_noise=STEP)
    few = np.where(np.arange(60)[:, None] < [60, 3, 60, 60], 3.0, np.nan)
    with pytest.raises(InputError, match="beacon 1 answered 3 pings"):
        survey_beacons(few, odometry, range_noise=RANGE, odometry_noise=STEP)
    with pytest.raises(InputError, match="from one point"):
        survey_beacons(ranges, 0 * odometry, range_noise=RANGE, odometry_noise=STEP)


@pytest.mark.parametrize(("range_noise", "step_noise"), [(1e-3, 5e-3), (4e-3, 4e-3), (1e-3, 1e-3), (1e-4, 1e-2)])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_rejects_a_straight_path(range_noise, step_noise, turn):
    """From a straight line, side and height of a beacon are indistinguishable, even with odometry noise of a few mm."""
    path = np.stack([np.arange(6.0), np.array([0, 5, -3, 4, -2, 1]) * 1e-3], axis=1)
    ranges = np.hypot(np.arange(6.0) - 2.0, np.hypot(3.0, 2.5))[:, None]
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    with pytest.raises(InputError, match="do not determine beacon 0"):
        survey_beacons(ranges, np.diff(path @ R.T, axis=0), range_noise=range_noise, odometry_noise=step_noise)


@pytest.mark.parametrize("seed", range(5))
def test_distant_beacon_from_small_loop_is_accurate_or_rejected(seed):
    draws, beacon = np.random.default_rng(seed), np.array([10.0, 8.0, -3.0])
    s = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    path = np.stack([np.cos(s) - 1, 0.5 * np.sin(s)], axis=1)
    exact = np.linalg.norm(np.concatenate([path, np.zeros((12, 1))], axis=1) - beacon, axis=1)[:, None]
    for noise in (0.1, 0.01):
        try:
            found = survey_beacons(
                exact + noise * draws.standard_normal((12, 1)),
                np.diff(path, axis=0) + 0.002 * draws.standard_normal((11, 2)),
                range_noise=noise,
                odometry_noise=0.002,
            )
        except InputError:
            continue
        assert (np.abs(found.beacons[0] - beacon) < 5 * found.standard_errors()[0]).all()
