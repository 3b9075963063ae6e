import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import Key, key
from trimtab.core.signals import Motion
from trimtab.environment.acoustics import Air
from trimtab.sensors.time_of_flight import (
    CEILING,
    Beacons,
    Medium,
    RangeErrors,
    actual_positions,
    audible_beacons,
    corrupt_ranges,
    measured_range,
    responding_beacons,
    unit_position,
    unit_velocity,
)

NETWORK = Beacons()
UNIT = np.array([0.3, -0.4, 0.0])
QUIET = RangeErrors(noise=0.0)


def test_ranges_match_the_calibration_table():
    """[1] table 5.2: heights and angles give the measured ranges, within 1.2e-4 and the rounding."""
    for degrees, measured in ((10, 274.83), (20, 288.83), (30, 315.07), (35, 334.25)):
        away = 2.7048 * np.tan(np.radians(degrees))
        seen = measured_range(np.array([[away, 0.0, -CEILING]]), jnp.zeros(3))
        assert float(seen[0]) == pytest.approx(measured / 100, rel=1.6e-4)


def test_beacons_are_audible_within_reach_and_cone():
    beacons = Beacons(map=np.array([[0, 0, -9.1], [0, 0, -9.2], [2.69, 0, -2.7], [2.71, 0, -2.7], [0, 0, 2.7]]))
    np.testing.assert_array_equal(audible_beacons(beacons, beacons.map, np.zeros(3)), [True, False, True, False, False])


def test_beacon_faults_begin_at_fault_time():
    moved = np.zeros((4, 3))
    moved[1] = [0.5, 0, 0]
    beacons = replace(NETWORK, moved=moved, dead=np.array([False, False, False, True]), fault_time=50)
    at = jax.jit(lambda t: (actual_positions(beacons, key(0), t), responding_beacons(beacons, NETWORK.map, UNIT, t)))
    (before, all_respond), (after, three_respond) = at(49), at(50)
    np.testing.assert_array_equal(before, NETWORK.map)
    np.testing.assert_array_equal(after, NETWORK.map + moved)
    assert all_respond.all()
    np.testing.assert_array_equal(three_respond, [True, True, True, False])


def test_survey_error_is_drawn_once_per_run():
    beacons = replace(NETWORK, survey_error=0.02)
    keys = Key(np.full(3000, 5, np.uint32), np.arange(3000, dtype=np.uint32))
    error = np.asarray(jax.jit(jax.vmap(lambda k: actual_positions(beacons, k, 0)))(keys)) - NETWORK.map
    assert error.std((0, 1)) == pytest.approx([0.02] * 3, rel=0.04)
    flat = error.reshape(3000, 12)
    assert (abs(np.corrcoef(flat.T) - np.eye(12)) < 4.5 / np.sqrt(3000)).all()
    at = jax.jit(lambda t: actual_positions(beacons, key(5), t))
    np.testing.assert_array_equal(at(0), at(10**9))


def test_speed_of_sound_scales_ranges():
    """15 °C taken for 20: 0.9 % too short."""
    medium = Medium(actual=Air(temperature=293.15, humidity=0.0), assumed=Air(temperature=288.15, humidity=0.0))
    ratio = corrupt_ranges(jnp.array([3.0]), key(0), 0, QUIET, medium, 0.0)[0] / 3.0
    assert float(ratio) == pytest.approx(np.sqrt(288.15 / 293.15), abs=1e-4)


@pytest.mark.thorough
def test_noise_strays_and_echoes_have_given_size_and_rate():
    errors = RangeErrors(noise=0.004, stray_probability=0.1, stray_size=3.0, echo_probability=0.2, echo_size=1.0)
    ranges = jnp.full(4, 5.0)

    def off(e):
        f = jax.jit(jax.vmap(lambda k: corrupt_ranges(ranges, key(3), k, e, Medium(), 0.0)))
        return np.asarray(f(np.arange(5000))) - 5.0

    noise = off(replace(errors, stray_probability=0.0, echo_probability=0.0))
    assert noise.std() == pytest.approx(0.004, rel=0.025)
    assert abs(noise.mean()) < 4 * 0.004 / np.sqrt(20000)
    stray = off(replace(errors, echo_probability=0.0)) - noise
    hit = stray != 0
    assert hit.mean() == pytest.approx(0.1, abs=0.009)
    assert stray[hit].std() == pytest.approx(3 / np.sqrt(3), rel=0.05)
    echo = off(errors) - stray - noise
    hit = abs(echo) > 1e-12
    assert hit.mean() == pytest.approx(0.2, abs=0.012)
    assert echo.min() > -1e-12
    assert echo[hit].mean() == pytest.approx(0.5, abs=0.03)


@pytest.mark.thorough
def test_unit_velocity_includes_vehicle_rotation():
    """Position and velocity of a unit, against differences of the position."""
    lever = np.array([0.3, 0.1, -0.2])

    def motion(s):
        attitude = jnp.array([0.1, -0.2, 0.5 + 2.0 * s])
        return Motion(0, jnp.array([1.0, 2.0, -0.5]) + s * jnp.array([0.5, -0.3, 0.0]), attitude, *[jnp.zeros(3)] * 4)

    R = np.asarray(jax.jacobian(lambda b: unit_position(motion(0.0), b))(lever))
    spin = R.T @ np.array([0, 0, 2.0])  # yaw turns about the world's z axis
    moving = replace(motion(0.0), v_WB_B=R.T @ np.array([0.5, -0.3, 0.0]), w_WB_B=spin)
    expected = jax.jacfwd(lambda s: unit_position(motion(s), lever))(0.0)
    np.testing.assert_allclose(unit_velocity(moving, lever), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [({"map": np.zeros(3)}, "map"), ({"moved": np.zeros(3)}, "moved"), ({"dead": np.zeros(3, bool)}, "dead")],
)
def test_rejects_beacon_arrays_of_wrong_shape(changes, problem):
    NETWORK.check()
    with pytest.raises(InputError, match=f"Beacons.{problem}"):
        replace(NETWORK, **changes).check()


def test_beacon_crystal_error_is_constant_over_a_run():
    ranges, ping = jnp.array([3.0, 5.0]), jax.jit(lambda n: corrupt_ranges(ranges, key(0), n, QUIET, Medium(), 1e-3))
    first, later = np.asarray(ping(0)) / ranges - 1, np.asarray(ping(7)) / ranges - 1
    np.testing.assert_allclose(later, first, rtol=1e-12)
    assert abs(first[0] - first[1]) > 1e-5
