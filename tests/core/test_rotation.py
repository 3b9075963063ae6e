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


from_euler, to_euler, from_rotation_vector, rotate_by_vector, wrap, wrap_positive = map(
    jax.jit, (r.from_euler, r.to_euler, r.from_rotation_vector, r.rotate_by_vector, r.wrap, r.wrap_positive)
)
slope_of_rotation = jax.jit(jax.jacfwd(r.from_rotation_vector))


@given(ANGLES)
def test_wrap_keeps_the_angle_within_plus_minus_pi(angle):
    """Rounding may turn an angle just below -pi into +pi exactly, never more."""
    got = float(wrap(angle))
    assert -np.pi <= got <= np.pi
    assert np.cos(got) == pytest.approx(np.cos(angle), abs=1e-11)
    assert np.sin(got) == pytest.approx(np.sin(angle), abs=1e-11)


@given(ANGLES)
def test_wrap_positive_keeps_the_angle_within_one_turn(angle):
    """Rounding may turn an angle just below 0 into 2 pi, and leaves subnormal numbers unchanged."""
    got = float(wrap_positive(angle))
    assert -1e-300 <= got <= 2 * np.pi
    assert np.cos(got) == pytest.approx(np.cos(angle), abs=1e-11)
    assert np.sin(got) == pytest.approx(np.sin(angle), abs=1e-11)


def test_wrap_at_plus_and_minus_pi():
    assert float(wrap(np.pi)) == -np.pi
    assert float(wrap(-np.pi)) == -np.pi
    assert float(wrap(0.25)) == 0.25
    assert float(wrap_positive(-0.25)) == pytest.approx(2 * np.pi - 0.25)
    assert float(jax.grad(r.wrap)(4.0)) == 1.0


@pytest.mark.parametrize("heading", [0.0, 0.3, -2.0, 9.0])
def test_planar_rotation_is_clockwise_seen_from_above(heading):
    R = np.asarray(r.planar(heading))
    np.testing.assert_allclose(R, Rotation.from_euler("z", heading).as_matrix()[:2, :2], atol=1e-15)
    north, east = R @ [1.0, 0.0]
    assert np.arctan2(east, north) == pytest.approx(float(wrap(heading)))


@pytest.mark.parametrize("i", range(40))
def test_euler_angles_match_scipy(i):
    yaw, pitch, roll = RANDOM[i].as_euler("ZYX")
    R = np.asarray(from_euler(roll, pitch, yaw))
    np.testing.assert_allclose(R, RANDOM[i].as_matrix(), atol=1e-14)
    np.testing.assert_allclose(to_euler(R), [roll, pitch, yaw], atol=1e-12)


def test_signs_of_euler_angles():
    """z down: positive pitch lifts the nose (negative down component), positive yaw turns it east."""
    nose_up = np.asarray(from_euler(0.0, 0.2, 0.0)) @ [1.0, 0.0, 0.0]
    assert nose_up[2] == pytest.approx(-np.sin(0.2))
    nose_east = np.asarray(from_euler(0.0, 0.0, 0.2)) @ [1.0, 0.0, 0.0]
    assert nose_east[1] == pytest.approx(np.sin(0.2))
    starboard_down = np.asarray(from_euler(0.2, 0.0, 0.0)) @ [0.0, 1.0, 0.0]
    assert starboard_down[2] == pytest.approx(np.sin(0.2))


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("yaw", [0.3, 0.7, -2.5])
@pytest.mark.parametrize("aside", [0.0, 1e-9, 1e-7, 3e-4, 1e-3])
@pytest.mark.parametrize(("dtype", "error"), [(np.float64, 1e-15), (np.float32, 3e-7)])
def test_euler_angles_near_vertical_give_the_same_rotation(pitch, yaw, aside, dtype, error):
    for roll in (0.4, -0.7):
        R = np.asarray(from_euler(roll, pitch * (1 - aside), yaw)).astype(dtype)
        angles = np.asarray(to_euler(R))
        assert angles.dtype == dtype
        assert float(angles[1]) == pytest.approx(pitch, abs=2 * aside + error)
        np.testing.assert_allclose(from_euler(*angles.astype(float)), R, atol=3 * error)


@pytest.mark.parametrize("v", VECTORS)
def test_rotation_vector_matches_scipy(v):
    wanted = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(from_rotation_vector(v), wanted, atol=1e-15)


@pytest.mark.parametrize("v", VECTORS[:3])
def test_rotation_vector_derivative_is_finite_near_zero(v):
    assert np.isfinite(slope_of_rotation(v)).all()
    slope = slope_of_rotation(np.zeros(3))
    np.testing.assert_array_equal(slope[2, 1], [1.0, 0.0, 0.0])


def test_cross_matrix_matches_numpy_cross():
    v, w = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 1.0])
    np.testing.assert_allclose(r.cross_matrix(jnp.asarray(v)) @ w, np.cross(v, w))


def test_wrap_positive_of_tiny_negative_angle_is_zero():
    assert wrap_positive(-1e-17) == 0.0


TURN = np.array([0.05, -0.08, 0.12])
"""A turn of 0.15 rad: ten ticks of the hovercraft's unit at 130 deg/s."""


def _printed_update(R, turn):
    """E as printed in [1] eq. 3.4, applied from the left."""
    v = -turn
    U = np.cross(np.eye(3), v)
    n = np.linalg.norm(v)
    return (np.eye(3) + np.sin(n) / n**2 * U + (1 - np.cos(n)) / n**2 * U @ U) @ R


def test_matrix_update_rotates_in_the_body_frame():
    """B(k) = B(k-1) Eᵀ to rounding; E B, and the printed first term over |v|², are wrong by much more.

    Oracle: the product of scipy's rotations, the turn in the body after the attitude.
    """
    worst = []
    for attitude in RANDOM[:10]:
        wanted = (attitude * Rotation.from_rotvec(TURN)).as_matrix()
        R = attitude.as_matrix()
        np.testing.assert_allclose(rotate_by_vector(R, TURN), wanted, atol=5e-16)
        E = np.asarray(from_rotation_vector(-TURN))
        worst.append(np.abs(E @ attitude.as_matrix() - wanted).max())
        assert np.abs(_printed_update(attitude.as_matrix(), TURN) - wanted).max() > 0.5
    assert 0.1 < max(worst) < 0.3
    assert min(worst) > 0.05


def test_small_matrix_updates_match_integrated_rotation():
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

    def update(R, turn):
        return r.rotate_by_vector(R, turn), None

    R, _ = jax.jit(lambda first: jax.lax.scan(update, first, turns))(jnp.asarray(start))
    np.testing.assert_allclose(R, wanted, atol=2e-6)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
