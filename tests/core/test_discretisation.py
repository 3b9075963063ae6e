"""A discrete model against integrals of scipy's matrix exponential."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from trimtab.core.discretisation import discretise, matrix_exponential

PENDULUM = np.array([[0.0, 1.0, 0, 0], [-264.12, -0.64, 28.7, 0.06], [0, 0, 0, 1], [19.6, 0.05, -330.9, -0.66]])


@pytest.mark.thorough("1e-06", "0.3", "4.0")
@pytest.mark.parametrize("size", [1e-6, 0.3, 4.0, 30.0])
def test_matrix_exponential_matches_scipy(size):
    A = np.random.default_rng(0).normal(size=(5, 5))
    A *= size / np.abs(A).sum(1).max()
    want = expm(A)
    np.testing.assert_allclose(matrix_exponential(A), want, rtol=0, atol=3e-13 * np.abs(want).max())


@pytest.mark.parametrize("dt", [1e-3, 5e-3, 0.05])
def test_discrete_model_matches_integrals_of_the_exponential(dt):
    root = np.random.default_rng(1).normal(size=(4, 4))
    Q = root @ root.T
    Ad, Bd, Qd = jax.jit(discretise)(PENDULUM, Q, dt)
    np.testing.assert_allclose(Ad, expm(PENDULUM * dt), rtol=1e-10, atol=1e-12)
    integral = quad_vec(lambda s: expm(PENDULUM * s), 0, dt, epsabs=1e-15)[0]
    np.testing.assert_allclose(Bd, integral, rtol=1e-9, atol=1e-14)
    gathered = quad_vec(lambda s: expm(PENDULUM * s) @ Q @ expm(PENDULUM * s).T, 0, dt, epsabs=1e-14)[0]
    np.testing.assert_allclose(Qd, gathered, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(Qd).min() > 0
    np.testing.assert_array_equal(Qd, np.asarray(Qd).T)


@pytest.mark.thorough
def test_two_half_steps_equal_one_full_step():
    Q = np.diag([1e-5, 100.0, 1e-5, 100.0])
    half, whole = discretise(PENDULUM, Q, 2.5e-3), discretise(PENDULUM, Q, 5e-3)
    np.testing.assert_allclose(half.Ad @ half.Ad, whole.Ad, atol=1e-13)
    np.testing.assert_allclose(half.Ad @ half.Qd @ half.Ad.T + half.Qd, whole.Qd, rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(half.Bd + half.Ad @ half.Bd, whole.Bd, atol=1e-15)
