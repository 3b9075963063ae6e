"""The discrete matrices against matrix exponentials, the gains against the Riccati equation's.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT
from scipy.linalg import expm, solve_discrete_are

from trimtab.core.record import to_arrays
from trimtab.estimators.inertial.dual_filter import (
    HEADING_ROW,
    InertialNoise,
    belief_covariance,
    heading_process_noise,
    heading_transition,
    lever_arm_noise,
    motion_process_noise,
    motion_transition,
)
from trimtab.estimators.kalman import predict, update


def rotation(a):
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def test_transitions_match_matrix_exponentials():
    np.testing.assert_allclose(heading_transition(0.3), expm(0.3 * np.array([[0.0, 1], [0, 0]])), rtol=1e-14)
    A = np.zeros((6, 6))
    A[:2, 4:], A[2:4, :2] = rotation(0.7), np.eye(2)
    np.testing.assert_allclose(motion_transition(0.3, 0.7), expm(0.3 * A), atol=1e-15)


def test_process_noise_acts_along_body_axes():
    G = np.zeros((6, 4))
    G[:2, :2], G[4:, 2:] = rotation(0.7), np.eye(2)
    growth = np.array([9.0, 9.0, 1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(
        jax.jit(motion_process_noise)(growth, 0.7, 0.0), G @ np.diag(growth[2:]) @ G.T, atol=1e-14
    )
    np.testing.assert_allclose(heading_process_noise(growth, 0.0), np.diag([9.0, 9.0]))


def test_noise_of_one_long_step_equals_many_short_steps():
    noise, none = InertialNoise(gyro_walk=0.3, force_walk=0.7), np.zeros(2)
    n, T = 400, 2.0
    dt = T / n
    P1, P2 = np.zeros((2, 2)), np.zeros((6, 6))
    F1, F2 = np.asarray(heading_transition(dt)), np.asarray(motion_transition(dt, 0.7))
    g = noise.growth(dt, none)
    Q1, Q2 = np.asarray(heading_process_noise(g, dt)), np.asarray(motion_process_noise(g, 0.7, dt))
    for _ in range(n):
        P1, P2 = F1 @ P1 @ F1.T + Q1, F2 @ P2 @ F2.T + Q2
    whole = noise.growth(T, none)
    np.testing.assert_allclose(heading_process_noise(whole, T), P1, rtol=1e-10)
    np.testing.assert_allclose(motion_process_noise(whole, 0.7, T), P2, rtol=1e-9, atol=1e-12)
    assert noise.integration_time(T) == T
    assert InertialNoise(covariance="literal").integration_time(jnp.asarray(T)) == 0


def test_literal_and_consistent_covariances_have_expected_growth():
    """At the tick, literal adds the printed numbers; consistent dt^2 times white noise and dt times walks."""
    printed = [4.9e-4, 5e-4, 3.4e-2, 2.7e-2, 5e-4, 5e-4]
    literal = InertialNoise(covariance="literal").growth(DT, np.zeros(2))
    np.testing.assert_allclose(literal, printed, rtol=1e-12)
    mended = InertialNoise().growth(DT, np.zeros(2))
    np.testing.assert_allclose(mended, np.array(printed) * [DT**2, DT, DT**2, DT**2, DT, DT], rtol=1e-12)
    halves = 2 * np.asarray(InertialNoise().growth(DT / 2, np.zeros(2)))
    np.testing.assert_allclose(halves, mended, rtol=1e-12)  # what is split adds up


def test_untrusted_samples_increase_the_process_noise():
    calm, gyro, both = (np.asarray(InertialNoise().growth(0.5, np.array(d))) for d in ([0.0, 0], [1.0, 0], [1.0, 1]))
    np.testing.assert_allclose(gyro - calm, [0.5, 0, 0, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(both - gyro, [0, 0, 2.0, 2.0, 0, 0], atol=1e-15)


WALK = 5e-4 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
GROWTH = {"literal": np.diag([4.9e-4, 5e-4]), "consistent": np.diag([4.9e-4 * DT**2, 0.0]) + WALK}
"""Covariance of heading and bias that a step adds: [1] section 5.4.5 as printed, and with its units mended."""


@pytest.mark.parametrize("covariance", GROWTH)
def test_steady_heading_gains_match_the_riccati_solution(covariance):
    """Against scipy's solution of the Riccati equation: (0.795, 0.800) as printed, (0.0438, 0.140) mended."""
    H = np.array([[1.0, 0.0]])
    P = solve_discrete_are(np.array([[1.0, 0.0], [DT, 1.0]]), H.T, GROWTH[covariance], np.array([[1.6e-4]]))
    gains = P[:, 0] / (P[0, 0] + 1.6e-4)
    noise = to_arrays(InertialNoise(covariance=covariance))
    Q = heading_process_noise(noise.growth(DT, jnp.zeros(2)), noise.integration_time(jnp.asarray(DT)))
    R = jnp.reshape(noise.heading, (1, 1))

    def step(P, _):
        _, P = predict(jnp.zeros(2), P, heading_transition(DT), Q)
        done = update(jnp.zeros(2), P, jnp.ones(1), HEADING_ROW, R)  # the state becomes the gain
        return done.P, done.x

    _, K = jax.jit(lambda: jax.lax.scan(step, jnp.diag(jnp.array([1.6e-4, 1.0])), None, length=5000))()
    np.testing.assert_allclose(K[-1], gains, rtol=1e-6)


def test_belief_covariance_places_blocks_and_signs_correctly():
    g = np.random.default_rng(0)
    A, B = g.standard_normal((2, 2)), g.standard_normal((6, 6))
    P1, P2 = A @ A.T, B @ B.T
    P = np.asarray(jax.jit(belief_covariance)(P1, P2, -1.0))
    T1, T2 = np.diag([1, -1.0]), np.diag([1.0, 1, 1, 1, -1, -1])
    np.testing.assert_allclose(P[np.ix_([0, 5], [0, 5])], T1 @ P1 @ T1, rtol=1e-14)
    rest = [1, 2, 3, 4, 6, 7]
    np.testing.assert_allclose(P[np.ix_(rest, rest)], T2 @ P2 @ T2, rtol=1e-14)
    assert not P[np.ix_([0, 5], rest)].any()


def test_heading_variance_adds_lever_arm_noise():
    np.testing.assert_allclose(lever_arm_noise(np.eye(2), np.array([0.0, 2.0]), 0.25), [[1, 0], [0, 2]])
