"""Moment of inertia from spin-up: the source's two trials, its example, and the fit with its error.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import numpy as np
import pytest
from scipy.stats import linregress

from trimtab.actuators.rudder import DEG, RudderGeometry
from trimtab.analysis.identify.inertia import (
    SpinUpTrial,
    find_linear_portion,
    fit_slope,
    inertia_error,
    lateral_force,
    moment_of_inertia,
    trial_inertia,
)
from trimtab.core.errors import InputError

ARM = 0.32
PSI = RudderGeometry().force_angle
TRIALS = (SpinUpTrial(-20 * DEG, 1.1, 0.9412), SpinUpTrial(25 * DEG, 1.05, -1.026))


@pytest.mark.parametrize(("trial", "FY", "J"), [(TRIALS[0], -0.28, 0.0952), (TRIALS[1], 0.31, 0.0967)])
def test_inertia_of_trials_matches_table_4_2(trial, FY, J):
    """[1] table 4.2: J to 1e-4, with FY rounded to two decimals as the table prints it."""
    got_FY, got_J = trial_inertia(trial, ARM, PSI, decimals=2)
    assert got_FY == pytest.approx(FY, abs=1e-12)
    assert got_J == pytest.approx(J, abs=1e-4)


def test_table_4_2_needs_the_rounded_force():
    """Unrounded: 0.0943 and 0.0979 from the printed psi (14.6, -17.4), 0.0948 and 0.0982 from the printed theta."""
    from_psi = [
        moment_of_inertia(ARM, lateral_force(trial.force, psi * DEG), trial.slope)
        for trial, psi in zip(TRIALS, (14.6, -17.4), strict=True)
    ]
    assert from_psi == pytest.approx([0.0943, 0.0979], abs=5e-5)
    from_theta = [trial_inertia(trial, ARM, PSI)[1] for trial in TRIALS]
    assert from_theta == pytest.approx([0.0948, 0.0982], abs=5e-5)
    rounded = [trial_inertia(trial, ARM, PSI, decimals=2)[1] for trial in TRIALS]
    assert np.mean(rounded) == pytest.approx(0.0959, abs=1e-4)


def test_hull_angle_force_and_inertia_match_figure_4_6():
    """[1] figure 4.6: F = 1.0 N at theta = -30 deg turns at 1.2397 rad/s^2 with J = 0.096."""
    psi = PSI(-30 * DEG)
    FY = lateral_force(1.0, psi)
    assert np.degrees(psi) == pytest.approx(21.83, abs=0.005)
    assert pytest.approx(-0.3719, abs=5e-5) == FY
    assert moment_of_inertia(ARM, FY, 1.2397) == pytest.approx(0.096, abs=1e-5)


def test_fit_is_ordinary_least_squares_over_the_window():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(2, 6, 300))
    r = 0.1 + 0.9 * (t - t[0]) - 0.05 * (t - t[0]) ** 2 + rng.normal(0, 0.05, 300)
    fit = fit_slope(t, r, window=1.5)
    inside = t <= t[0] + 1.5
    oracle: Any = linregress(t[inside] - t[0], r[inside])
    assert (fit.slope, fit.offset) == pytest.approx((oracle.slope, oracle.intercept), rel=1e-10)
    assert fit.standard_error == pytest.approx(oracle.stderr, rel=1e-10)
    assert fit.samples == inside.sum() < 300
    assert fit.residual == pytest.approx(0.05, rel=0.25)


def test_slope_standard_error_matches_monte_carlo_spread():
    rng = np.random.default_rng(1)
    t = np.arange(0, 1.5, 0.0065536)
    fits = [fit_slope(t, 1.24 * t + rng.normal(0, 0.02, len(t))) for _ in range(400)]
    slopes = np.array([f.slope for f in fits])
    assert slopes.mean() == pytest.approx(1.24, abs=4 * slopes.std() / 20)
    assert np.mean([f.standard_error for f in fits]) == pytest.approx(slopes.std(), rel=0.12)


def test_inertia_error_matches_monte_carlo_spread():
    rng = np.random.default_rng(2)
    t = np.arange(0, 1.0, 0.01)
    fit = fit_slope(t, 1.2 * t + rng.normal(0, 0.02, len(t)))
    J = moment_of_inertia(ARM, -0.37, fit.slope)
    slopes, forces = rng.normal(fit.slope, fit.standard_error, 20000), rng.normal(-0.37, 0.37 * 0.02, 20000)
    spread = moment_of_inertia(ARM, forces, slopes).std()
    assert inertia_error(J, fit, 0.02) == pytest.approx(spread, rel=0.05)


@pytest.mark.parametrize(
    ("t", "r", "says"),
    [
        ([0, 1], [0, 1], "2 samples"),
        ([0, 1, 2], [0, 1], "shape"),
        ([0, 1, 2], [0, np.nan, 1], "finite"),
        ([], [], "0 samples"),
        ([1, 1, 1], [0, 1, 2], "too few for a slope"),
    ],
)
def test_invalid_slope_data_is_rejected(t, r, says):
    with pytest.raises(InputError, match=says):
        fit_slope(t, r)


def test_straight_part_of_a_spin_up_is_found() -> None:
    g = np.random.default_rng(3)
    t = 0.02 * np.arange(300)
    since = np.maximum(t - 1.5, 0)
    rate = 1.2 * (1 - np.exp(-0.5 * since)) / 0.5
    part = find_linear_portion(t, rate + 0.005 * g.standard_normal(300))
    assert abs(part.start - 1.5) < 0.06
    assert part.window < 1.0
    assert abs(float(part.fit.slope) - 1.2) < 4 * float(part.fit.standard_error) + 0.02
