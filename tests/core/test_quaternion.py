"""Quaternions against scipy's rotations, and against the group's own laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.core import quaternion as Q
from trimtab.core.rotation import from_euler, from_rotation_vector

DRAWS = 50
RANDOM = np.random.default_rng(3)
FIRST, SECOND = RANDOM.standard_normal((2, DRAWS, 4))
FIRST, SECOND = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (FIRST, SECOND))


def theirs(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


@pytest.mark.thorough
def test_products_matrices_and_inverses_match_scipy():
    for p, q in zip(FIRST, SECOND, strict=True):
        np.testing.assert_allclose(Q.to_matrix(p), theirs(p).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(Q.to_matrix(Q.multiply(p, q)), (theirs(p) * theirs(q)).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(Q.to_matrix(Q.conjugate(p)), theirs(p).inv().as_matrix(), atol=1e-14)
        np.testing.assert_allclose(Q.rotate(p, jnp.array([1.0, 2.0, 3.0])), theirs(p).apply([1, 2, 3]), atol=1e-14)


def test_to_matrix_ignores_the_quaternion_length():
    q = FIRST[0]
    np.testing.assert_allclose(Q.to_matrix(3.7 * q), Q.to_matrix(q), atol=1e-15)
    np.testing.assert_allclose(Q.normalise(-2.0 * q), -q, atol=1e-15)


@pytest.mark.parametrize("axis", range(4))
def test_from_matrix_recovers_quaternion_for_every_largest_component(axis):
    q = np.full(4, 0.1)
    q[axis] = 1.0
    for sign in (1, -1):
        p = q * sign / np.linalg.norm(q)
        back = np.asarray(Q.from_matrix(jnp.asarray(theirs(p).as_matrix())))
        assert back[0] >= 0
        np.testing.assert_allclose(back * np.sign(back @ p), p, atol=1e-15)


def test_from_matrix_recovers_half_turns():
    for axis in np.eye(3):
        R = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(Q.to_matrix(Q.from_matrix(jnp.asarray(R))), R, atol=1e-15)


def test_from_euler_matches_the_rotation_matrix():
    for angles in RANDOM.uniform(-3, 3, (20, 3)):
        np.testing.assert_allclose(Q.to_matrix(Q.from_euler(*angles)), from_euler(*angles), atol=1e-14)


@pytest.mark.thorough("0.0", "1e-09", "1e-05", "0.00019", "0.00021", "3.1")
@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1.9e-4, 2.1e-4, 1.0, 3.1])
def test_logarithm_inverts_exponential(size):
    for v in RANDOM.standard_normal((10, 3)):
        v = size * v / np.linalg.norm(v)
        q = Q.exponential(jnp.asarray(v))
        np.testing.assert_allclose(q @ q, 1.0, atol=4e-16)
        np.testing.assert_allclose(Q.to_matrix(q), from_rotation_vector(jnp.asarray(v)), atol=1e-14)
        np.testing.assert_allclose(Q.logarithm(q), v, atol=1e-14 * max(1, size), rtol=1e-13)
        np.testing.assert_allclose(Q.logarithm(-q), v, atol=1e-14 * max(1, size), rtol=1e-13)


@pytest.mark.thorough
def test_retract_inverts_local():
    for p, q in zip(FIRST, SECOND, strict=True):
        v = Q.local(p, q)
        assert np.linalg.norm(v) <= np.pi + 1e-12
        np.testing.assert_allclose(Q.to_matrix(Q.retract(p, v)), Q.to_matrix(q), atol=1e-13)


@pytest.mark.thorough
def test_derivative_at_zero_rotation_is_the_identity():
    J = jax.jacfwd(lambda v: Q.local(jnp.asarray(FIRST[0]), Q.retract(jnp.asarray(FIRST[0]), v)))(jnp.zeros(3))
    np.testing.assert_allclose(J, np.eye(3), atol=1e-14)


@pytest.mark.thorough
def test_rate_is_the_derivative_of_a_steady_rotation():
    w, q = jnp.array([0.3, -0.8, 0.5]), jnp.asarray(FIRST[0])
    along = jax.jacfwd(lambda t: Q.retract(q, w * t))(0.0)
    np.testing.assert_allclose(Q.rate(q, w), along, atol=1e-15)
