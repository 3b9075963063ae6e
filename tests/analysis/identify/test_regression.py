"""Least squares with rejection of outliers."""

import numpy as np
import pytest

from trimtab.analysis.identify.regression import fit_linear


def test_fit_without_outliers_is_ordinary_least_squares() -> None:
    g = np.random.default_rng(0)
    A, b = g.standard_normal((30, 3)), np.array([1.0, -2.0, 0.5])
    y = A @ b + 0.1 * g.standard_normal(30)
    fit = fit_linear(A, y)
    value, rest, *_ = np.linalg.lstsq(A, y, None)
    assert fit.kept.all()
    np.testing.assert_allclose(fit.value, value, rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(A.T @ A) * rest[0] / 27, rtol=1e-8)


def test_only_outlier_readings_are_left_out() -> None:
    for seed in range(30):
        g = np.random.default_rng(seed)
        x = np.linspace(0, 1, 25)
        y = 2 * x + 1 + 0.05 * g.standard_normal(25)
        y[[3, 17]] += [1.0, -2.0]
        fit = fit_linear(np.stack([x, np.ones(25)], 1), y)
        assert not fit.kept[[3, 17]].any()
        assert fit.kept.sum() >= 22
        np.testing.assert_allclose(fit.value, [2, 1], atol=0.15)


@pytest.mark.thorough
def test_clean_data_loses_readings_in_one_percent() -> None:
    lost = 0
    for seed in range(400):
        g = np.random.default_rng([7, seed])
        A = np.stack([g.uniform(size=20), np.ones(20)], 1)
        lost += not fit_linear(A, A @ [1, 2] + g.standard_normal(20)).kept.all()
    assert lost <= 14  # 4 expected; 14 or more by chance 1e-4


@pytest.mark.thorough
def test_fit_intervals_have_the_stated_coverage() -> None:
    inside = 0
    for seed in range(400):
        g = np.random.default_rng([8, seed])
        A = np.stack([g.uniform(size=8), np.ones(8)], 1)
        low, high = fit_linear(A, A @ [1, 2] + g.standard_normal(8)).interval()
        inside += int(low[0] <= 1 <= high[0])
    assert 363 <= inside <= 394  # 380 expected, 0.1 % tails
