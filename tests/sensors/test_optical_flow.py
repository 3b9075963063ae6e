"""Optical flow against a point of the ground that is projected twice, and its limits."""

import jax
import numpy as np
import pytest

from trimtab.core.imperfections import without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion
from trimtab.sensors.optical_flow import OpticalFlow

O = np.zeros(3)
IDEAL = without_any(OpticalFlow())


def motion(height=2.0, v=O, w=O, attitude=O):
    return Motion(
        np.int64(0),
        np.array([0.0, 0.0, -height]),
        np.array(attitude, float),
        np.array(v, float),
        np.array(w, float),
        O,
        O,
    )


def test_flow_matches_a_projected_ground_point():
    """Where the axis meets the ground, seen a moment later from where the vehicle is then."""
    v, w, attitude = np.array([1.3, -0.7, 0.4]), np.array([0.3, -0.2, 0.5]), np.array([0.2, -0.15, 0.7])
    R = np.asarray(from_euler(*attitude))
    seen = IDEAL.measure(motion(2.0, v, w, attitude))
    point = np.array([0.0, 0.0, -2.0]) + R @ [0.0, 0.0, float(seen.distance)]
    assert point[2] == pytest.approx(0.0, abs=1e-12)
    dt = 1e-6
    turn = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) * dt
    later = (np.eye(3) - turn) @ R.T @ (point - np.array([0.0, 0.0, -2.0]) - R @ v * dt)
    np.testing.assert_allclose(seen.flow, later[:2] / later[2] / dt, rtol=1e-5)
    np.testing.assert_allclose([seen.surge_velocity, seen.sway_velocity], v[:2], rtol=1e-12)


def test_rotation_on_the_spot_gives_zero_velocity():
    seen = IDEAL.measure(motion(w=[0.4, -0.3, 1.0]))
    np.testing.assert_allclose(seen.flow, [0.3, 0.4])
    np.testing.assert_allclose([seen.surge_velocity, seen.sway_velocity], 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("at", "usable"),
    [(motion(2.0), True), (motion(0.05), False), (motion(11.0), False), (motion(0.5, [5, 0, 0]), False)],
)
def test_reports_unusable_outside_its_limits(at, usable):
    assert bool(IDEAL.measure(at).usable) == usable


def test_errors_have_the_given_sizes():
    at = motion(3.0, [1.0, 0.0, 0.0])

    def values(sensor, seed=0):
        return rollout(to_arrays(sensor), key(seed), at, np.arange(4000, dtype=np.int64))

    seen = values(replace(IDEAL, noise=0.02))
    assert np.std(seen.surge_velocity) == pytest.approx(0.06, rel=0.05)
    assert np.std(seen.sway_velocity) == pytest.approx(0.06, rel=0.05)
    assert np.std(values(replace(IDEAL, gyro_noise=0.01)).sway_velocity) == pytest.approx(0.03, rel=0.05)
    assert np.std(values(replace(IDEAL, range_noise=0.1)).distance) == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(values(replace(IDEAL, scale_factor=0.1)).surge_velocity, 1.1)
    biases = [float(values(replace(IDEAL, gyro_bias=0.01), s).surge_velocity[0]) - 1 for s in range(60)]
    assert np.std(biases) == pytest.approx(0.03, rel=0.3)


@jax.jit
def rollout(sensor, key, at, k):
    state = sensor.init(key)
    return jax.vmap(lambda k: sensor.step(k * sensor.period, state, at)[1].value)(k)
