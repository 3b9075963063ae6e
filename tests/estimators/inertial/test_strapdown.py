"""Increments are a group, exact for constant rates, and follow rates that change straight between two samples."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from trimtab.core import quaternion
from trimtab.estimators.inertial.strapdown import (
    Kinematics,
    average_samples,
    compose,
    increment_of,
    move,
    no_increment,
    remove_first,
)

G = np.array([0.0, 0.0, 9.80665])


def integrate(w, f, T, start=None):
    """Attitude, velocity and position by a solver of SciPy; w(t), f(t) in B."""
    q0, v0, p0 = (np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)) if start is None else start

    def rate(t, x):
        q = x[:4] / np.linalg.norm(x[:4])
        R = Rotation.from_quat(np.roll(q, -1)).as_matrix()
        a, b = x[0], x[1:4]
        turning = np.append(-b @ w(t), a * w(t) + np.cross(b, w(t))) / 2  # q' = q (0, w) / 2
        return np.concatenate([turning, R @ f(t) + G * (start is not None), x[4:7]])

    x = solve_ivp(rate, (0, T), np.concatenate([q0, v0, p0]), rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
    return x[:4] / np.linalg.norm(x[:4]), x[4:7], x[7:10]


def assert_one(one, q, v, p, tol):
    np.testing.assert_allclose(quaternion.local(one.turn, q), 0, atol=tol)
    np.testing.assert_allclose(one.velocity, v, atol=tol * 10)
    np.testing.assert_allclose(one.position, p, atol=tol * 10)


@pytest.mark.parametrize("turn", [0.0, 1e-5, 0.05, 0.3])
def test_constant_rates_are_integrated_exactly_over_any_time(turn):
    w, f, T = np.array([0.3, -0.5, 0.8]), np.array([1.0, -2.0, -9.0]), 0.7
    w = w / np.linalg.norm(w) * turn / T
    one = increment_of(w, f, T)
    assert_one(one, *integrate(lambda t: w, lambda t: f, T), 1e-11)
    assert float(one.time) == T


def test_series_is_accurate_up_to_one_radian():
    a = np.array([0.6, 0.0, 0.8])
    one = increment_of(a, a, 1.0)
    np.testing.assert_allclose(one.turn[0], math.cos(0.5), atol=1e-8)
    np.testing.assert_allclose(one.velocity, a, atol=1e-8)  # along the axis nothing turns


def some(seed):
    rng = np.random.default_rng(seed)
    return increment_of(rng.normal(size=3), 9 * rng.normal(size=3), rng.uniform(0.01, 0.3))


def test_increments_are_a_group():
    a, b, c = some(1), some(2), some(3)
    left, right = compose(compose(a, b), c), compose(a, compose(b, c))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-13), left, right)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-13), remove_first(compose(a, b), a), b)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-15), compose(no_increment(), a), a)


def test_composed_increment_moves_state_like_successive_ones():
    a, b = some(4), some(5)
    start = Kinematics(quaternion.normalise(jnp.array([0.9, 0.1, -0.3, 0.2])), jnp.array([3.0, -2.0, 1.0]), jnp.ones(3))
    two = move(move(start, a, G), b, G)
    at_once = move(start, compose(a, b), G)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-12), two, at_once)


def test_motion_under_gravity_matches_ode_solver():
    w, f, T = np.array([0.3, -0.5, 0.8]), np.array([1.0, -2.0, -9.0]), 0.4
    q = np.asarray(quaternion.normalise(jnp.array([0.9, 0.1, -0.3, 0.2])))
    start = q, np.array([3.0, -2.0, 1.0]), np.array([1.0, 2.0, 3.0])
    end = move(Kinematics(*map(jnp.asarray, start)), increment_of(w, f, T), G)
    q1, v1, p1 = integrate(lambda t: w, lambda t: f, T, start)
    np.testing.assert_allclose(quaternion.local(end.attitude, q1), 0, atol=1e-10)
    np.testing.assert_allclose(end.velocity, v1, atol=1e-9)
    np.testing.assert_allclose(end.position, p1, atol=1e-9)


def coning_error(n, *, corrected):
    """Attitude and velocity at the end of a second of coning and sculling, in n samples, less a solver's."""

    def w(t):
        return np.array([2.0 * np.cos(12 * t), 2.0 * np.sin(12 * t), 0.5])

    def f(t):
        return np.array([3.0 * np.sin(12 * t), 0.0, -9.0 + 3.0 * np.cos(12 * t)])

    q, v, _ = integrate(w, f, 1.0)
    total, dt = no_increment(), 1.0 / n

    def add(total, k):
        a, b = k * dt, (k + 1) * dt
        ends = jax.vmap(lambda t: jnp.stack([2.0 * jnp.cos(12 * t), 2.0 * jnp.sin(12 * t), 0.5 + 0 * t]))
        forces = jax.vmap(lambda t: jnp.stack([3.0 * jnp.sin(12 * t), 0 * t, -9.0 + 3.0 * jnp.cos(12 * t)]))
        (w0, w1), (f0, f1) = ends(jnp.stack([a, b])), forces(jnp.stack([a, b]))
        mean = average_samples(w0, f0, w1, f1, dt) if corrected else ((w0 + w1) / 2, (f0 + f1) / 2)
        return compose(total, increment_of(*mean, dt)), None

    total, _ = jax.lax.scan(add, total, jnp.arange(n))
    return np.linalg.norm(quaternion.local(total.turn, q)), np.linalg.norm(total.velocity - v)


@pytest.mark.thorough
def test_coning_and_sculling_correction_reduces_the_error():
    """A cone's drift about z, and sculling: samples with a straight line between leave less than their means do."""
    with_it, without = coning_error(200, corrected=True), coning_error(200, corrected=False)
    print(f"attitude {without[0]:.1e} rad without, {with_it[0]:.1e} with; velocity {without[1]:.1e}, {with_it[1]:.1e}")
    finer = coning_error(400, corrected=True)
    assert 3.5 < with_it[0] / finer[0] < 4.5  # the trapezoid's own error of the rate is left: order two
    assert with_it[0] < without[0]
    assert with_it[1] < without[1]


def test_magnus_term_raises_the_order_for_linear_rates():
    """Rates and forces that change straight: a mean leaves the third order of the step, with the term the fifth."""
    w0, dw = np.array([1.0, -2.0, 0.5]), np.array([-15.0, 10.0, 20.0])
    f0, df = np.array([2.0, 1.0, -9.0]), np.array([-30.0, 20.0, -20.0])
    errors = []
    for T in (0.08, 0.04):
        q, v, _ = integrate(lambda t: w0 + dw * t, lambda t: f0 + df * t, T)
        one = increment_of(*average_samples(w0, f0, w0 + dw * T, f0 + df * T, T), T)
        errors.append((np.linalg.norm(quaternion.local(one.turn, q)), np.linalg.norm(one.velocity - v)))
    ratio = np.array(errors[0]) / np.array(errors[1])
    print(ratio)
    assert ratio[0] > 24
    assert ratio[1] > 12
