"""A range against the simulated network and automatic derivatives, its cone error undone, a ping's ranges in turn."""

import functools

import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.signals import Motion
from trimtab.environment.acoustics import range_ratio
from trimtab.estimators.ranging.position import SQUARE
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import (
    TOP,
    Geometry,
    compensate_range,
    linearise_range,
    place_information,
    predict_range,
    update_with_ranges,
)
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging

BEACON = np.array([1.5, -1.5, -2.7])
predict = jax.jit(predict_range, static_argnames="cone")
compensate = jax.jit(compensate_range)


@functools.partial(jax.jit, static_argnames="cone")
def slope_at(place, cone):
    """Return the derivative of the range by the place."""
    return jax.grad(lambda p: predict_range(BEACON, p, 0.0, cone=cone).range)(place)


@pytest.mark.parametrize("cone", [True, False])
def test_predicted_range_matches_the_sensor(cone):
    """The simulated network's h(x), [1] section 5.5.4."""
    o = np.zeros(3)
    sensor = UltrasonicRanging(cone_error=cone)
    place = np.array([0.3, -0.2])
    want = jax.jit(sensor.measure)(Motion(np.int64(0), np.append(place, 0.1), o, o, o, o, o)).range
    got = [predict(b, place, 0.1, cone=cone).range for b in np.asarray(sensor.beacons.map)]
    np.testing.assert_allclose(got, want, rtol=1e-13)


@pytest.mark.parametrize("cone", [True, False])
@pytest.mark.parametrize("place", [(0.3, -0.2), (1.5, -1.4), (1.2, -1.5)])
def test_slope_matches_automatic_derivative(place, cone):
    place = np.array(place)
    at = predict(BEACON, place, 0.0, cone=cone)
    want = slope_at(place, cone)
    np.testing.assert_allclose(at.slope, want, atol=1e-12)


@pytest.mark.thorough
def test_curvature_matches_automatic_hessian():
    place = np.array([0.3, -0.2])
    want = jax.hessian(lambda p: predict_range(BEACON, p, 0.0, cone=False).range)(place)
    np.testing.assert_allclose(predict_range(BEACON, place, 0.0, cone=False).curvature, want, atol=1e-12)
    with_cone = jax.hessian(lambda p: predict_range(BEACON, p, 0.0, cone=True).range)(place)
    np.testing.assert_allclose(predict_range(BEACON, place, 0.0, cone=True).curvature, with_cone, atol=0.05)


def test_derivatives_are_finite_under_a_beacon():
    at = predict(BEACON, BEACON[:2], 0.0, cone=True)
    assert float(at.range) == pytest.approx(2.7)
    np.testing.assert_allclose(at.slope, 0.0, atol=1e-15)
    assert np.isfinite(at.curvature).all()


@pytest.mark.thorough
def test_predict_range_lowers_to_generated_c():
    assert lower_function(lambda b, p: predict_range(b, p, 0.0, cone=True), (BEACON, np.zeros(2))).text("f")


G = Geometry(SQUARE, np.array([0.2, 0.1]), 0.05, True)
X = np.array([0.7, 0.1, 0.2, 0.3, -0.2, 0.01, 0.1, -0.1, 0.003, 0.01, -0.02, 0.03, 0.0])
P = np.diag([0.04, 1, 1, 0.01, 0.02, 1, 1, 1, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4])


@jax.jit
def range_at(x, i):
    c, s = jax.numpy.cos(x[0]), jax.numpy.sin(x[0])
    place = x[3:5] + jax.numpy.stack([c * 0.2 - s * 0.1, s * 0.2 + c * 0.1])
    return (1 + x[8]) * predict_range(jax.numpy.asarray(SQUARE)[i], place, 0.05, cone=True).range + x[9 + i]


@jax.jit
def _linearised(x, P, beacons, i):
    return linearise_range(x, P, i, G._replace(beacons=beacons)), *jax.value_and_grad(range_at)(x, i)


def linearised(i):
    """Return the linearised range, the range itself, and its automatic derivative."""
    return _linearised(X, P, SQUARE, i)


@pytest.mark.parametrize("i", range(4))
def test_linearised_range_matches_automatic_derivative(i):
    at, value, slope = linearised(i)
    assert float(at.range) == pytest.approx(float(value), rel=1e-14)
    np.testing.assert_allclose(at.H, slope, atol=1e-12)


def test_second_order_terms_match_monte_carlo():
    """Mean and variance beyond first order of 400000 states (Bar-Shalom 10.3.3)."""
    g = np.random.default_rng(0)
    x = X + np.sqrt(np.diag(P)) * g.standard_normal((400_000, 13))
    at = linearised(0)[0]
    z = np.asarray(jax.jit(jax.vmap(lambda x: range_at(x, 0)))(x))
    rest = z - float(at.range) - (x - X) @ np.asarray(at.H)
    assert rest.mean() == pytest.approx(float(at.mean), rel=0.05)
    assert rest.var() == pytest.approx(float(at.variance), rel=0.1)


def test_update_accepts_and_rejects_each_range_separately():
    """The right ones are used, a wrong, a silent and a considered one not or hardly; the state comes nearer."""
    truth = X.copy()
    truth[[3, 4]] += [0.05, -0.1]
    z = np.array([float(range_at(truth, i)) for i in range(4)])
    z[1] += 2.0
    learns = np.r_[np.ones(9), np.zeros(4)]
    update = jax.jit(lambda z, usable: update_with_ranges(X, P, z, usable, G, RangeErrorModel(), learns))
    done = update(z, np.array([True, True, True, False]))
    assert list(np.asarray(done.accepted)) == [True, False, True, False]
    np.testing.assert_array_equal(done.x[9:], X[9:])
    assert done.nis[3] == 0.0
    assert done.nis[1] > 15.1
    assert np.all(np.linalg.eigvalsh(np.asarray(done.P)) > 0)
    assert np.all(np.diag(np.asarray(done.P))[9:] == np.diag(P)[9:])


def test_position_information_matches_the_slopes():
    place = np.array([0.3, -0.2])
    used = np.array([True, True, False, True])
    slopes = np.array([predict(b, place, 0.05, cone=True).slope for b in SQUARE])[used]
    information = jax.jit(lambda place, used: place_information(place, used, G, 0.02))(place, used)
    np.testing.assert_allclose(information, slopes.T @ slopes / 4e-4, rtol=1e-12)


@pytest.mark.thorough
def test_range_update_lowers_to_generated_c():
    learns = np.ones(13)

    def f(x, P, z):
        return update_with_ranges(x, P, z, z > 0, G, RangeErrorModel(), learns)

    assert lower_function(f, (X, P, np.ones(4))).text("f")


HEIGHT = 2.7048


def measured(degrees):
    beta = np.radians(degrees)
    true_range = HEIGHT / np.cos(beta)
    return beta, true_range, true_range / np.asarray(range_ratio(beta))


def test_newton_converges_in_three_iterations():
    """At most 5 iterations from 2 to 45° to 1e-6, and the true range comes back."""
    beta, true_range, rho = measured(np.linspace(2, 45, 2000))
    r, found, iterations = compensate(rho, np.full_like(rho, HEIGHT))
    assert np.asarray(iterations).max() <= 5
    assert np.asarray(iterations).max() <= 3  # what was found when the method was chosen
    excess = np.asarray(range_ratio(found)) * np.cos(found) - HEIGHT / rho
    assert abs(excess).max() <= 1e-6
    np.testing.assert_allclose(found, beta, atol=1e-6 / (1.076 * np.radians(2) - 0.0032))
    np.testing.assert_allclose(r, true_range, atol=3e-6)


def test_range_below_the_height_is_returned_unchanged():
    rho = np.array([HEIGHT, HEIGHT - 1e-9, HEIGHT - 0.01, 0.5, 0.0])
    r, beta, iterations = compensate(rho, np.full_like(rho, HEIGHT))
    np.testing.assert_array_equal(r, rho)
    assert (np.asarray(beta) == 0).all()
    assert (np.asarray(iterations) == 0).all()


def test_compensation_inverts_the_calibration_table():
    """[1] table 5.2: true ranges out of the measured ones, within 1.2e-4."""
    rho = np.array([274.83, 288.83, 315.07, 334.25]) / 100
    r, beta, _ = compensate(rho, np.full(4, HEIGHT))
    np.testing.assert_allclose(r, np.array([274.65, 287.84, 312.32, 330.20]) / 100, rtol=1.6e-4)
    np.testing.assert_allclose(np.degrees(beta), [10, 20, 30, 35], atol=0.1)


def test_compensation_is_stable_below_two_degrees():
    """Two angles may fit there; either gives the range to a tenth of a millimetre, and no step runs away."""
    _, true_range, rho = measured(np.linspace(0.0, 2, 4001))
    assert np.radians(0.17) == pytest.approx(TOP, rel=0.01)
    r, beta, iterations = compensate(rho, np.full_like(rho, HEIGHT))
    assert abs(np.asarray(r) - true_range).max() < 1e-4
    assert np.asarray(beta).max() < np.radians(2.1)
    assert np.asarray(iterations).max() < 8


@pytest.mark.thorough
def test_compensation_stays_finite_for_noisy_ranges():
    rng = np.random.default_rng(0)
    height = rng.uniform(-1, 9, 5000)
    rho = rng.uniform(0, 12, 5000)
    for out in compensate(rho, height):
        assert np.isfinite(out).all()
    r, beta, _ = compensate(rho, height)
    within = (rho > height) & (height > 0)
    solved = within & (np.asarray(beta) < np.pi / 4) & (np.asarray(beta) > 0.04)
    np.testing.assert_allclose((np.asarray(r) * np.cos(beta))[solved], height[solved], rtol=2e-6)


@pytest.mark.thorough
def test_compensation_lowers_to_c_and_is_differentiable():
    assert lower_function(compensate_range, [np.zeros(4), np.ones(4)]).outputs
    slope = jax.vmap(jax.grad(lambda rho: compensate_range(rho, HEIGHT)[0]))(np.array([2.5, 2.71, 3.0, 4.0]))
    assert np.isfinite(slope).all()
