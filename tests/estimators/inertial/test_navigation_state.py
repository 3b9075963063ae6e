"""Kinematics of the reference point: values and sigmas against a Monte Carlo of the geometry."""

import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.estimators.inertial.mechanisation import Belief, LeverArms
from trimtab.estimators.inertial.navigation_state import (
    count_measurement,
    fuse_measurement,
    no_heading_fix,
    no_position_fix,
    reference_kinematics,
)
from trimtab.estimators.kalman import update

ARMS = LeverArms(imu=np.array([0.3, -0.2]))
NAMES = ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east")


def geometry(x, rate, arm):
    """The reference point's motion from that of the IMU, for many samples x (k, 8)."""
    c, s = np.cos(x[:, 0]), np.sin(x[:, 0])
    w = rate - x[:, 5]
    surge, sway = c * x[:, 1] + s * x[:, 2], -s * x[:, 1] + c * x[:, 2]
    north, east = x[:, 3] - (c * arm[0] - s * arm[1]), x[:, 4] - (s * arm[0] + c * arm[1])
    return np.stack([surge + w * arm[1], sway - w * arm[0], w, north, east], axis=1)


@pytest.mark.thorough
def test_reference_point_sigmas_match_monte_carlo():
    g = np.random.default_rng(0)
    x = np.array([0.7, 1.2, -0.4, 3.0, 4.0, 0.02, 0.1, -0.1])
    A = 0.01 * g.standard_normal((8, 8))
    P = A @ A.T
    told = reference_kinematics(Belief(x, P), np.float64(0.9), 1e-4, ARMS)
    want = geometry(x[None], 0.9, ARMS.imu)[0]
    np.testing.assert_allclose([told[n] for n in NAMES], want, rtol=1e-13)
    drawn = x + g.multivariate_normal(np.zeros(8), P, 400_000)
    rates = 0.9 + 0.01 * g.standard_normal(len(drawn))
    spread = geometry(drawn, rates, ARMS.imu).std(axis=0)
    np.testing.assert_allclose([told[f"sigma_{n}"] for n in NAMES], spread, rtol=0.01)
    own = np.sqrt(np.diag(P))
    np.testing.assert_allclose(told["sigma_heading"], own[0], rtol=1e-12)
    np.testing.assert_allclose(told["sigma_gyro_bias"], own[5], rtol=1e-12)
    np.testing.assert_allclose([told["sigma_forward_bias"], told["sigma_starboard_bias"]], own[6:], rtol=1e-12)
    assert told["covariance"].positive


@pytest.mark.thorough
def test_fix_counters_count_used_and_rejected():
    used = update(np.zeros(1), np.eye(1), np.array([0.5]), np.eye(1), np.eye(1))
    refused = update(np.zeros(1), np.eye(1), np.array([50.0]), np.eye(1), np.eye(1), gate=9.0)
    missing = update(np.zeros(1), np.eye(1), np.array([np.nan]), np.eye(1), np.eye(1))
    fix = no_heading_fix()
    for done in (used, refused, refused):
        fix = count_measurement(fix, done)
    assert (fix.used, fix.rejected, fix.rejected_in_a_row) == (1, 2, 2)
    np.testing.assert_allclose(fix.normalised, [50 / np.sqrt(2)], rtol=1e-12)
    np.testing.assert_allclose(fix.nis, 1250, rtol=1e-12)
    fix = count_measurement(count_measurement(fix, missing), used, -1.0)
    assert (fix.used, fix.rejected, fix.rejected_in_a_row) == (2, 2, 0)
    assert fix.innovation[0] == -0.5
    assert no_position_fix().innovation.shape == (2,)


@pytest.mark.thorough
def test_repeated_rejections_force_acceptance():
    """The covariance grows until the innovation is plausible; then the measurement is used once."""
    x, P, R, y = np.zeros(2), np.diag([1e-4, 1e-4]), 1e-6 * np.eye(2), np.array([1.0, 0.5])
    believed = {"gate": 18.0, "patience": np.int32(3)}
    fix = no_position_fix()
    for k in range(3):
        done, fix = fuse_measurement(fix, x, P, y, np.eye(2), R, **believed)
        assert not done.accepted
        np.testing.assert_array_equal(done.P, P)
        assert fix.rejected_in_a_row == k + 1
    refused = fix
    done, fix = fuse_measurement(fix, x, P, y, np.eye(2), R, **believed)
    assert done.accepted
    np.testing.assert_allclose(done.x, y, rtol=1e-3)
    assert done.nis < 2.1
    assert (fix.forced, fix.rejected_in_a_row, fix.used) == (1, 0, 1)
    done, same = fuse_measurement(refused, x, P, np.array([np.nan, 0.0]), np.eye(2), R, **believed)
    np.testing.assert_array_equal(done.P, P)  # to what is no number it does not give in
    assert same.forced == 0
    stubborn = no_position_fix()
    for _ in range(6):
        done, stubborn = fuse_measurement(stubborn, x, P, y, np.eye(2), R, gate=18.0, patience=np.int32(0))
    assert stubborn.rejected_in_a_row == 6
    assert not done.accepted


@pytest.mark.thorough
def test_sigmas_stay_finite_with_negative_variance():
    told = reference_kinematics(Belief(np.zeros(8), -1e-18 * np.eye(8)), 0.0, 0.0, ARMS)
    assert all(np.isfinite(told[f"sigma_{n}"]) for n in NAMES)
    assert not told["covariance"].positive


@pytest.mark.thorough
def test_reference_kinematics_lowers_to_generated_c():
    assert lower_function(
        lambda x, P: reference_kinematics(Belief(x, P), 0.1, 1e-4, ARMS), (np.zeros(8), np.eye(8))
    ).text("f")
