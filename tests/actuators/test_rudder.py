"""Rudder: the pulse map and its inverse, stops, and the direction of the force.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import interp1d

from trimtab.actuators.rudder import DEG, RudderGeometry, RudderServo
from trimtab.core.errors import InputError
from trimtab.core.record import replace, to_arrays

SERVO = to_arrays(RudderServo())
GEOMETRY = RudderGeometry()
MS = np.linspace(1.0, 2.0, 21)
ANGLES = 35 * np.sin(72 * DEG * (MS - 1.5) / 0.5) / np.sin(72 * DEG)
angle = jax.jit(jax.vmap(SERVO.angle))
pulse = jax.jit(jax.vmap(SERVO.pulse))
angle_of_one, pulse_of_one = jax.jit(SERVO.angle), jax.jit(SERVO.pulse)


def test_map_points_match_the_reconstructed_plot():
    assert np.allclose(np.degrees(SERVO.angles), ANGLES, atol=1e-12)
    assert np.allclose(np.degrees(angle(MS * 1e-3)), ANGLES, atol=1e-9)
    assert float(angle_of_one(1.5e-3)) == pytest.approx(0.0, abs=1e-12)


def test_map_is_linear_between_and_beyond_points():
    wide = np.random.default_rng(0).uniform(0.2, 2.8, 500)
    oracle = interp1d(MS, ANGLES, fill_value="extrapolate")
    assert np.allclose(np.degrees(angle(wide * 1e-3)), oracle(wide), atol=1e-9)


def test_inverse_is_linear_between_and_beyond_points():
    wide = np.random.default_rng(1).uniform(-130, 130, 500)
    oracle = interp1d(ANGLES, MS, fill_value="extrapolate")
    assert np.allclose(np.asarray(pulse(wide * DEG)) * 1e3, oracle(wide), atol=1e-9)


@settings(deadline=None)
@given(st.floats(-2.3, 2.3))
def test_angle_to_pulse_round_trip(theta):
    assert float(angle_of_one(pulse_of_one(theta))) == pytest.approx(theta, abs=1e-12)


@settings(deadline=None)
@given(st.floats(-1e-3, 4e-3))
def test_pulse_to_angle_round_trip(width):
    assert float(pulse_of_one(angle_of_one(width))) == pytest.approx(width, abs=1e-14)


def test_angle_is_limited_at_the_stops():
    got = np.degrees(SERVO.limit_angle(np.array([-90.0, -35.1, -20.0, 30.0, 31.0]) * DEG))
    assert np.allclose(got, [-35, -35, -20, 30, 30])
    assert np.array_equal(
        SERVO.is_at_stop(np.array([-35.0, -34.9, 0.0, 29.9, 30.0]) * DEG), [True, False, False, False, True]
    )


@pytest.mark.parametrize(("psi", "theta"), [(14.6, -19.87), (-17.4, 24.93)])
def test_rudder_angle_matches_table_4_2(psi, theta):
    """[1] eq. 4.3 at the two rows of table 4.2 (printed there as -20 and 25)."""
    assert np.degrees(GEOMETRY.rudder_angle(psi * DEG)) == pytest.approx(theta, abs=0.005)


def test_force_angles_at_the_stops_match_the_thesis():
    assert np.degrees(GEOMETRY.force_angle(30 * DEG)) == pytest.approx(-21.0, abs=0.05)
    assert np.degrees(GEOMETRY.force_angle(-35 * DEG)) == pytest.approx(25.4, abs=0.05)


@given(st.floats(-2, 2))
def test_force_angle_to_rudder_round_trip(psi):
    assert GEOMETRY.force_angle(GEOMETRY.rudder_angle(psi)) == pytest.approx(psi, abs=1e-14)


def test_pulse_map_gradient_matches_the_slope():
    slope = jax.grad(SERVO.angle)(1.52e-3)
    assert slope == pytest.approx((ANGLES[11] - ANGLES[10]) * DEG / 50e-6)
    assert jax.grad(SERVO.pulse)(SERVO.angle(1.52e-3)) == pytest.approx(1 / slope)


def test_rejects_decreasing_angles_and_bad_stops():
    RudderServo().check()
    with pytest.raises(InputError, match="angles: the angles must increase"):
        RudderServo(angles=np.array(SERVO.angles)[::-1]).check()
    with pytest.raises(InputError, match="stops"):
        replace(RudderServo(), angle_max=36 * DEG).check()
    with pytest.raises(InputError, match="stops"):
        replace(RudderServo(), angle_max=-36 * DEG).check()
