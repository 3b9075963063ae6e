"""Rotations against scipy's, and the conventions of docs/conventions.md."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trimtab.core import rotation as r

ANGLES = st.floats(-1e4, 1e4, allow_nan=False)
RANDOM = Rotation.random(40, rng=np.random.default_rng(3))
VECTORS = [
    np.zeros(3),
    *(np.array([1.0, -2.0, 0.5]) * s for s in (1e-12, 1e-7, 4e-5, 5e-5, 1e-3, 0.3, 1.0)),
    np.array([0.0, 0.0, np.pi - 1e-9]),
]


def _scipy_quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


@given(ANGLES)
def test_wrap_is_the_same_angle_in_the_half_open_turn(angle):
    """Round-off may put an angle a hair below -pi on +pi itself, never beyond."""
    got = float(r.wrap(angle))
    assert -np.pi <= got <= np.pi
    assert np.cos(got) == pytest.approx(np.cos(angle), abs=1e-11)
    assert np.sin(got) == pytest.approx(np.sin(angle), abs=1e-11)


@given(ANGLES)
def test_wrap_positive_is_the_same_angle_in_a_turn(angle):
    """Round-off may put an angle a hair below 0 on 2 pi, and leaves the very smallest doubles alone."""
    got = float(r.wrap_positive(angle))
    assert -1e-300 <= got <= 2 * np.pi
    assert np.cos(got) == pytest.approx(np.cos(angle), abs=1e-11)
    assert np.sin(got) == pytest.approx(np.sin(angle), abs=1e-11)


def test_wrap_at_the_seam():
    assert float(r.wrap(np.pi)) == -np.pi
    assert float(r.wrap(-np.pi)) == -np.pi
    assert float(r.wrap(0.25)) == 0.25
    assert float(r.wrap_positive(-0.25)) == pytest.approx(2 * np.pi - 0.25)
    assert float(jax.grad(r.wrap)(4.0)) == 1.0


@pytest.mark.parametrize("heading", [0.0, 0.3, -2.0, 9.0])
def test_planar_is_a_clockwise_turn_seen_from_above(heading):
    R = np.asarray(r.planar(heading))
    np.testing.assert_allclose(R, Rotation.from_euler("z", heading).as_matrix()[:2, :2], atol=1e-15)
    north, east = R @ [1.0, 0.0]
    assert np.arctan2(east, north) == pytest.approx(float(r.wrap(heading)))


@pytest.mark.parametrize("i", range(40))
def test_euler_against_scipy(i):
    yaw, pitch, roll = RANDOM[i].as_euler("ZYX")
    R = np.asarray(r.from_euler(roll, pitch, yaw))
    np.testing.assert_allclose(R, RANDOM[i].as_matrix(), atol=1e-14)
    np.testing.assert_allclose(r.to_euler(R), [roll, pitch, yaw], atol=1e-12)


def test_euler_signs():
    """z down: positive pitch lifts the nose (negative down component), positive yaw turns it east."""
    nose_up = np.asarray(r.from_euler(0.0, 0.2, 0.0)) @ [1.0, 0.0, 0.0]
    assert nose_up[2] == pytest.approx(-np.sin(0.2))
    nose_east = np.asarray(r.from_euler(0.0, 0.0, 0.2)) @ [1.0, 0.0, 0.0]
    assert nose_east[1] == pytest.approx(np.sin(0.2))
    starboard_down = np.asarray(r.from_euler(0.2, 0.0, 0.0)) @ [0.0, 1.0, 0.0]
    assert starboard_down[2] == pytest.approx(np.sin(0.2))


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_euler_at_vertical_gives_roll_zero_and_the_same_rotation(pitch, yaw):
    R = r.from_euler(0.4, pitch, yaw)
    roll, found, turned = r.to_euler(R)
    assert float(roll) == 0.0
    assert float(found) == pytest.approx(pitch)
    np.testing.assert_allclose(r.from_euler(roll, found, turned), R, atol=1e-12)


@pytest.mark.parametrize("v", VECTORS)
def test_rotation_vector_against_scipy(v):
    wanted = Rotation.from_rotvec(v)
    np.testing.assert_allclose(r.from_rotation_vector(jnp.asarray(v)), wanted.as_matrix(), atol=1e-15)
    q = np.asarray(r.quaternion_from_rotation_vector(jnp.asarray(v)))
    np.testing.assert_allclose(q, _scipy_quaternion(wanted), atol=1e-15)
    np.testing.assert_allclose(r.quaternion_to_rotation_vector(jnp.asarray(q)), v, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("v", VECTORS[:3])
def test_rotation_vector_differentiates_at_and_near_zero(v):
    for f in (r.from_rotation_vector, r.quaternion_from_rotation_vector):
        assert np.isfinite(jax.jacfwd(f)(jnp.asarray(v))).all()
    slope = jax.jacfwd(r.from_rotation_vector)(jnp.zeros(3))
    np.testing.assert_array_equal(slope[2, 1], [1.0, 0.0, 0.0])


def test_cross_matrix():
    v, w = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 1.0])
    np.testing.assert_allclose(r.cross_matrix(jnp.asarray(v)) @ w, np.cross(v, w))


@pytest.mark.parametrize("i", range(0, 40, 5))
def test_quaternions_against_scipy(i):
    a, b = RANDOM[i], RANDOM[i + 1]
    p, q = _scipy_quaternion(a), _scipy_quaternion(b)
    np.testing.assert_allclose(r.quaternion_to_matrix(jnp.asarray(p)), a.as_matrix(), atol=1e-14)
    product = np.asarray(r.quaternion_product(jnp.asarray(p), jnp.asarray(q)))
    np.testing.assert_allclose(r.quaternion_to_matrix(product), (a * b).as_matrix(), atol=1e-14)
    one = r.quaternion_product(jnp.asarray(p), r.quaternion_inverse(jnp.asarray(p)))
    np.testing.assert_allclose(one, [1, 0, 0, 0], atol=1e-15)
    for sign in (1, -1):
        v = r.quaternion_to_rotation_vector(jnp.asarray(sign * p))
        np.testing.assert_allclose(v, a.as_rotvec(), atol=1e-13)


def test_half_turn():
    v = r.quaternion_to_rotation_vector(jnp.array([0.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(v, [0, np.pi, 0], atol=1e-15)


def test_a_tiny_negative_angle_stays_below_a_full_turn():
    assert r.wrap_positive(-1e-17) == 0.0


TURN = np.array([0.05, -0.08, 0.12])
"""A turn of 0.15 rad: ten ticks of the hovercraft's unit at 130 deg/s."""


def _printed_update(R, turn):
    """E as printed in [1] eq. 3.4, applied from the left."""
    v = -turn
    U = np.cross(np.eye(3), v)
    n = np.linalg.norm(v)
    return (np.eye(3) + np.sin(n) / n**2 * U + (1 - np.cos(n)) / n**2 * U @ U) @ R


def test_matrix_update_turns_in_the_body():
    """Spec 2.1: B(k) = B(k-1) Eᵀ to rounding; E B, and the printed first term over |v|², are wrong by much more.

    Oracle: the product of scipy's rotations, the turn in the body after the attitude.
    """
    worst = []
    for attitude in RANDOM[:10]:
        wanted = (attitude * Rotation.from_rotvec(TURN)).as_matrix()
        R = jnp.asarray(attitude.as_matrix())
        np.testing.assert_allclose(r.rotate_by_vector(R, jnp.asarray(TURN)), wanted, atol=5e-16)
        E = np.asarray(r.from_rotation_vector(jnp.asarray(-TURN)))
        worst.append(np.abs(E @ attitude.as_matrix() - wanted).max())
        assert np.abs(_printed_update(attitude.as_matrix(), TURN) - wanted).max() > 0.5
    assert 0.1 < max(worst) < 0.3
    assert min(worst) > 0.05


def test_matrix_and_quaternion_updates_are_the_limit_of_small_turns():
    """R' = R [w ×]: against scipy's integration of a rate that changes its axis."""
    from scipy.integrate import solve_ivp

    def rate(t):
        return np.array([0.9 * np.sin(t), 0.7 * np.cos(2 * t), 1.2])

    def slope(t, y):
        return (y.reshape(3, 3) @ np.cross(np.eye(3), rate(t))).ravel()

    start = RANDOM[4].as_matrix()
    wanted = solve_ivp(slope, (0, 2), start.ravel(), rtol=1e-11, atol=1e-12).y[:, -1].reshape(3, 3)
    n = 2000
    turns = jnp.asarray([rate((k + 0.5) * 2 / n) * 2 / n for k in range(n)])

    def both(carry, turn):
        R, q = carry
        return (r.rotate_by_vector(R, turn), r.rotate_quaternion_by_vector(q, turn)), None

    first = (jnp.asarray(start), r.quaternion_from_matrix(jnp.asarray(start)))
    (R, q), _ = jax.jit(lambda c: jax.lax.scan(both, c, turns))(first)
    np.testing.assert_allclose(R, wanted, atol=2e-6)
    np.testing.assert_allclose(r.quaternion_to_matrix(q), R, atol=1e-12)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)


def test_orthonormalised_squares_the_error():
    R = RANDOM[2].as_matrix() + 1e-4 * np.random.default_rng(0).normal(size=(3, 3))
    before, once = (np.abs(A.T @ A - np.eye(3)).max() for A in (R, np.asarray(r.orthonormalise(jnp.asarray(R)))))
    assert once < before**2 * 2
    twice = r.orthonormalise(r.orthonormalise(jnp.asarray(R)))
    np.testing.assert_allclose(twice.T @ twice, np.eye(3), atol=1e-14)


def test_quaternion_from_matrix_and_from_euler_against_scipy():
    half_turns = [Rotation.from_rotvec(np.pi * np.eye(3)[i]) for i in range(3)]
    for rotation in [*RANDOM, *half_turns, Rotation.identity()]:
        q = np.asarray(r.quaternion_from_matrix(jnp.asarray(rotation.as_matrix())))
        assert abs(q @ _scipy_quaternion(rotation)) == pytest.approx(1, abs=1e-14)
        assert q[0] >= 0
        v = jnp.array([0.3, -1.0, 2.0])
        np.testing.assert_allclose(r.rotate_vector(jnp.asarray(q), v), rotation.as_matrix() @ v, atol=1e-14)
    yaw, pitch, roll = RANDOM[0].as_euler("ZYX")
    q = np.asarray(r.quaternion_from_euler(roll, pitch, yaw))
    assert abs(q @ _scipy_quaternion(RANDOM[0])) == pytest.approx(1, abs=1e-14)
    np.testing.assert_array_equal(r.normalise_quaternion(jnp.zeros(4)), [1, 0, 0, 0])
    np.testing.assert_allclose(r.normalise_quaternion(3 * jnp.asarray(q)), q, atol=1e-15)


@pytest.mark.parametrize("pitch", [0.0, 1.2, -1.5, 2.5])
def test_euler_rates_against_differences(pitch):
    w, h = jnp.array([0.4, -0.7, 0.9]), 1e-6
    rates, singular = r.euler_rates(0.3, pitch, w)
    R = r.from_euler(0.3, pitch, 1.1)
    slope = (np.asarray(r.from_euler(*(jnp.array([0.3, pitch, 1.1]) + h * rates))) - R) / h
    np.testing.assert_allclose(slope, R @ np.cross(np.eye(3), w), atol=2e-5)
    assert not singular


def test_the_singularity_of_euler_angles_is_a_flag_and_stays_finite():
    w = jnp.array([0.4, -0.7, 0.9])
    for pitch, flagged in ((np.pi / 2, True), (-np.pi / 2 + 0.009, True), (np.pi / 2 - 0.011, False), (0.0, False)):
        rates, singular = r.euler_rates(0.3, pitch, w)
        assert bool(singular) is flagged
        assert bool(r.is_vertical(r.from_euler(0.3, pitch, 0.2))) is flagged
        assert np.isfinite(rates).all()
        assert np.abs(rates).max() < 200
