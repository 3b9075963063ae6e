import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.environment.acoustics import range_ratio
from trimtab.estimators.ranging.range_model import TOP, compensate_range

HEIGHT = 2.7048


def measured(degrees):
    beta = np.radians(degrees)
    true_range = HEIGHT / np.cos(beta)
    return beta, true_range, true_range / np.asarray(range_ratio(beta))


def test_check_22_newton_iterations():
    """At most 5 iterations from 2 to 45° to 1e-6, and the true range comes back."""
    beta, true_range, rho = measured(np.linspace(2, 45, 2000))
    r, found, iterations = compensate_range(rho, np.full_like(rho, HEIGHT))
    assert np.asarray(iterations).max() <= 5
    assert np.asarray(iterations).max() <= 3  # what was found when the method was chosen
    excess = np.asarray(range_ratio(found)) * np.cos(found) - HEIGHT / rho
    assert abs(excess).max() <= 1e-6
    np.testing.assert_allclose(found, beta, atol=1e-6 / (1.076 * np.radians(2) - 0.0032))
    np.testing.assert_allclose(r, true_range, atol=3e-6)


def test_check_22_range_not_above_the_height_is_returned():
    rho = np.array([HEIGHT, HEIGHT - 1e-9, HEIGHT - 0.01, 0.5, 0.0])
    r, beta, iterations = compensate_range(rho, np.full_like(rho, HEIGHT))
    np.testing.assert_array_equal(r, rho)
    assert (np.asarray(beta) == 0).all()
    assert (np.asarray(iterations) == 0).all()


def test_calibration_table_backwards():
    """[1] table 5.2: true ranges out of the measured ones, within the 1.2e-4 of check 22."""
    rho = np.array([274.83, 288.83, 315.07, 334.25]) / 100
    r, beta, _ = compensate_range(rho, np.full(4, HEIGHT))
    np.testing.assert_allclose(r, np.array([274.65, 287.84, 312.32, 330.20]) / 100, rtol=1.6e-4)
    np.testing.assert_allclose(np.degrees(beta), [10, 20, 30, 35], atol=0.1)


def test_below_two_degrees_where_the_slope_vanishes():
    """Two angles may fit there; either gives the range to a tenth of a millimetre, and no step runs away."""
    _, true_range, rho = measured(np.linspace(0.0, 2, 4001))
    assert np.radians(0.17) == pytest.approx(TOP, rel=0.01)
    r, beta, iterations = compensate_range(rho, np.full_like(rho, HEIGHT))
    assert abs(np.asarray(r) - true_range).max() < 1e-4
    assert np.asarray(beta).max() < np.radians(2.1)
    assert np.asarray(iterations).max() < 8


def test_noise_and_other_heights_stay_finite():
    rng = np.random.default_rng(0)
    height = rng.uniform(-1, 9, 5000)
    rho = rng.uniform(0, 12, 5000)
    for out in compensate_range(rho, height):
        assert np.isfinite(out).all()
    r, beta, _ = compensate_range(rho, height)
    within = (rho > height) & (height > 0)
    solved = within & (np.asarray(beta) < np.pi / 4) & (np.asarray(beta) > 0.04)
    np.testing.assert_allclose((np.asarray(r) * np.cos(beta))[solved], height[solved], rtol=2e-6)


def test_exportable_and_differentiable():
    assert lower_function(compensate_range, [np.zeros(4), np.ones(4)]).outputs
    slope = jax.vmap(jax.grad(lambda rho: compensate_range(rho, HEIGHT)[0]))(np.array([2.5, 2.71, 3.0, 4.0]))
    assert np.isfinite(slope).all()
