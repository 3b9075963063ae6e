"""The filter's matrices against automatic derivatives, its updates against the Kalman filter's dense ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.estimators.inertial.error_state import (
    SpatialNoise,
    SpatialStart,
    carry_covariance,
    catch_up,
    first_nominal,
    fuse_scalars,
    process_noise,
    propagate,
    put_error_in,
    transition,
)
from trimtab.estimators.inertial.strapdown import no_increment
from trimtab.estimators.kalman import predict_covariance, update

G = jnp.array([0.0, 0.0, 9.80665])
START = SpatialStart(angles=(0.3, -0.2, 1.0), velocity=(10.0, -3.0, 1.0), position=(5.0, 6.0, -7.0))
DT, SAMPLES = 1e-3, 20


def imu_reading(k):
    """Angular velocity and force of sample k of a ride: 4 rad/s² of angular acceleration."""
    s = 0.005 * k
    return (
        jnp.stack([0.8 * jnp.sin(s), 0.5 + 0.2 * jnp.cos(2 * s), -0.6 + 0 * s]),
        jnp.stack([2.0 * jnp.cos(s), 1.0 + 0 * s, -9.8 + 3 * jnp.sin(s)]),
    )


def ride(x, samples=SAMPLES):
    for k in range(samples):
        x = propagate(x, *imu_reading(jnp.asarray(float(k))), DT, 0.0, G)
    return x


def with_error(x, e):
    """The truth that is missing e (15,) from a state."""
    return put_error_in(x, e, x.P)


def error_between(x, true):
    """What x misses (15,)."""
    return jnp.concatenate(
        [
            quaternion.local(x.attitude, true.attitude),
            true.velocity - x.velocity,
            true.position - x.position,
            true.gyro_bias - x.gyro_bias,
            true.force_bias - x.force_bias,
        ]
    )


@pytest.fixture(scope="module")
def jacobian():
    """F (15, 15) over the ride by automatic differentiation, of all its samples one by one."""
    x = first_nominal(START, 15)
    return np.asarray(jax.jit(jax.jacfwd(lambda e: error_between(ride(x), ride(with_error(x, e)))))(jnp.zeros(15)))


@pytest.mark.thorough
def test_transition_is_the_jacobian_of_the_mechanisation(jacobian):
    """Of attitude, velocity, position to rounding; of biases as for a constant rate, of the place a constant force."""
    x = first_nominal(START, 15)
    F = np.asarray(transition(quaternion.to_matrix(x.attitude), ride(x).span))
    np.testing.assert_allclose(F[:, :9], jacobian[:9, :9], atol=1e-12)
    for rows, part in ((slice(0, 3), 1e-3), (slice(3, 6), 1e-3), (slice(6, 9), 1e-2)):
        for columns in (slice(9, 12), slice(12, 15)):
            block = jacobian[rows, columns]
            np.testing.assert_allclose(F[rows, columns], block, atol=part * np.abs(block).max() + 1e-15)
    np.testing.assert_allclose(jacobian[9:], np.eye(15)[9:], atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("n", [15, 17])
def test_covariance_propagation_matches_dense_matrices(n):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(n, n))
    P, noise = jnp.asarray(A @ A.T), SpatialNoise()
    x = first_nominal(START, n)
    one, R = ride(x).span, quaternion.to_matrix(x.attitude)
    F = np.eye(n)
    F[:9, :15] = transition(R, one)
    if n == 17:
        F[15, 16] = SAMPLES * DT
    dense = predict_covariance(P, F, process_noise(noise, one.time, 0.0, n))
    carried = carry_covariance(P, R, one, 0.0, noise)
    np.testing.assert_allclose(carried, dense, atol=1e-12 * np.abs(dense).max())
    np.testing.assert_array_equal(carried, carried.T)


def test_force_noise_integrates_to_velocity_and_position():
    """The integral of white noise, twice: T, T²/2, T³/3. Untrusted samples add to it."""
    noise = SpatialNoise(force=0.1, gyro=0.2, untrusted_rate=3.0)
    Q = np.asarray(process_noise(noise, 2.0, 0.0, 15))
    np.testing.assert_allclose([Q[4, 4], Q[4, 7], Q[7, 4], Q[7, 7]], 0.01 * np.array([2.0, 2.0, 2.0, 8 / 3]))
    assert Q[0, 0] == pytest.approx(0.04 * 2)
    np.testing.assert_allclose(np.diag(Q)[9:12], noise.gyro_walk**2 * 2)
    np.testing.assert_array_equal(Q, Q.T)
    assert process_noise(noise, 2.0, 0.5, 15)[0, 0] == pytest.approx(0.08 + 1.5**2)


@pytest.mark.thorough
def test_single_catch_up_matches_propagation_per_sample():
    x, noise = first_nominal(START, 15), SpatialNoise()
    often = x
    for k in range(SAMPLES):
        often = catch_up(propagate(often, *imu_reading(jnp.asarray(float(k))), DT, 0.0, G), noise)
    once = catch_up(ride(x), noise)
    scale = np.sqrt(np.outer(np.diag(often.P), np.diag(often.P)))
    np.testing.assert_allclose((once.P - often.P) / scale, 0, atol=1e-5)
    jax.tree.map(np.testing.assert_array_equal, once.span, no_increment())


def random_update(seed, m=6):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(15, 15))
    return A @ A.T + np.eye(15), rng.normal(size=m), rng.normal(size=(m, 15)), rng.uniform(0.1, 2.0, size=m)


@pytest.mark.thorough
def test_sequential_scalar_updates_match_dense_update():
    P, y, H, R = random_update(5)
    f = fuse_scalars(jnp.asarray(P), jnp.asarray(y), jnp.asarray(H), jnp.asarray(R), jnp.ones(6, bool), jnp.inf)
    dense = update(jnp.zeros(15), jnp.asarray(P), jnp.asarray(y), jnp.asarray(H), jnp.diag(jnp.asarray(R)))
    np.testing.assert_allclose(f.error, dense.x, atol=1e-10)
    np.testing.assert_allclose(f.P, dense.P, atol=1e-10)
    assert float(f.nis.sum()) == pytest.approx(float(dense.nis), rel=1e-9)
    np.testing.assert_array_equal(f.P, f.P.T)
    assert f.used.all()


def test_unwanted_nan_and_gated_measurements_are_ignored():
    P, y, H, R = (jnp.asarray(v) for v in random_update(6))
    wanted = jnp.array([True, False, True, True, True, True])
    y = y.at[2].set(jnp.nan).at[3].set(1e4)
    fuse = jax.jit(fuse_scalars)
    f = fuse(P, y, H, R, wanted, 15.0)
    left = np.array([0, 4, 5])
    g = fuse(P, y[left], H[left], R[left], jnp.ones(3, bool), 15.0)
    np.testing.assert_array_equal(f.used, [True, False, False, False, True, True])
    np.testing.assert_allclose(f.error, g.error, atol=1e-12)
    np.testing.assert_allclose(f.P, g.P, atol=1e-12)
    assert np.isfinite(f.nis).all()


@pytest.mark.thorough
def test_covariance_stays_positive_definite_under_precise_measurements():
    """Known to a millimetre, from a hundred metres: symmetric and positive."""
    P = jnp.diag(jnp.asarray(START.sigmas(15)) ** 2).at[6, 6].set(1e4)
    rng = np.random.default_rng(9)
    for H in jnp.asarray(rng.normal(size=(40, 5, 15)) * 10):
        f = fuse_scalars(P, jnp.zeros(5), H, jnp.full(5, 1e-6), jnp.ones(5, bool), jnp.inf)
        P = f.P + 1e-8 * jnp.eye(15)
        assert np.linalg.eigvalsh(P).min() > 0
    np.testing.assert_array_equal(P, P.T)


@pytest.mark.thorough
def test_error_reset_matches_the_group_jacobian():
    """What is missing after a turn was put in: d log(Exp(-a) Exp(a + e)), to first order in a."""
    x = first_nominal(START, 15)
    a = jnp.concatenate([jnp.array([0.02, -0.03, 0.05]), jnp.zeros(12)])
    after = put_error_in(x, a, x.P)
    G_exact = jax.jacfwd(lambda e: error_between(after, with_error(x, a + e)))(jnp.zeros(15))
    rng = np.random.default_rng(2)
    A = rng.normal(size=(15, 15))
    P = jnp.asarray(A @ A.T)
    moved = put_error_in(x, a, P).P
    np.testing.assert_allclose(moved, G_exact @ P @ G_exact.T, atol=2e-3 * np.abs(P).max())
    assert np.abs(moved - P).max() > 10 * np.abs(moved - G_exact @ P @ G_exact.T).max()


@pytest.mark.thorough
def test_nominal_state_absorbs_the_injected_error():
    x = first_nominal(START, 17)
    e = jnp.asarray(np.linspace(-0.1, 0.2, 17))
    after = put_error_in(x, e, x.P)
    np.testing.assert_allclose(error_between(x, after), e[:15], atol=1e-12)
    np.testing.assert_allclose(after.clock, e[15:])
