"""The platform's motion against derivatives of its position, and against the upright formulas of the source."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.core.record import to_arrays
from trimtab.core.rotation import from_euler
from trimtab.sensors.imu import Imu
from trimtab.vehicles.rotating_platform import PlatformDrive, PlatformState, RotatingPlatform

RIG = RotatingPlatform(tilt=0.2, lean=0.7, time_constant=0.08)
COMMAND = PlatformDrive(rate=2.5)


def state(t, rig=RIG, first=-1.0, heading=0.3):
    """The exact answer of the lag to a constant command."""
    decay = jnp.exp(-t / rig.time_constant)
    rate = COMMAND.rate + (first - COMMAND.rate) * decay
    turned = COMMAND.rate * t + (first - COMMAND.rate) * rig.time_constant * (1 - decay)
    zero = jnp.zeros(())
    return PlatformState(heading + turned, rate, zero, zero, zero, zero)


def motion(t, rig=RIG):
    return rig.motion(0, state(t, rig), COMMAND)


@jax.jit
def derivatives(t):
    """Return the motion, its rotation matrix, and derivatives: position's first and second, rotation's, turn rate's."""

    def pose(t):
        m = motion(t)
        return m.p_WB, from_euler(*m.attitude), m.w_WB_B

    velocity, turning, alpha = jax.jacfwd(pose)(t)
    return motion(t), pose(t)[1], velocity, jax.jacfwd(jax.jacfwd(lambda t: pose(t)[0]))(t), turning, alpha


@pytest.mark.parametrize("t", [0.05, 3.0, *(pytest.param(t, marks=pytest.mark.thorough) for t in (0.0, 0.4))])
def test_velocities_and_accelerations_are_derivatives_of_the_pose(t):
    m, R, velocity, acceleration, turned, alpha = jax.tree.map(np.asarray, derivatives(t))
    np.testing.assert_allclose(R @ m.v_WB_B, velocity, atol=1e-12)
    np.testing.assert_allclose(R @ m.a_WB_B, acceleration, atol=1e-11)
    turning = R.T @ turned
    np.testing.assert_allclose([turning[2, 1], turning[0, 2], turning[1, 0]], m.w_WB_B, atol=1e-12)
    np.testing.assert_allclose(alpha, m.alpha_WB_B, atol=1e-11)


def test_upright_motion_matches_the_thesis():
    """[1] section 6.2.1: phi = al + pi/2, F = (R W', R W²), X tangential, Y inward."""
    rig = RotatingPlatform()
    m, x = jax.jit(lambda t: (motion(t, rig), state(t, rig)))(0.1)
    R, W = rig.arm, x.yaw_rate
    angle = x.heading - np.pi / 2
    np.testing.assert_allclose(m.p_WB, [R * np.cos(angle), R * np.sin(angle), 0], atol=1e-15)
    np.testing.assert_allclose(m.a_WB_B, [R * (COMMAND.rate - W) / rig.time_constant, R * W**2, 0], atol=1e-15)
    np.testing.assert_allclose(m.attitude, [0, 0, x.heading], atol=1e-15)
    inward = from_euler(*m.attitude) @ jnp.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(inward, -m.p_WB / R, atol=1e-15)


def test_integrated_state_matches_the_motion():
    rig, x, h = RIG, to_arrays(RIG.rest_state(0.3)), 1e-3
    step = jax.jit(lambda x: rk4(lambda t, x: rig.dynamics(t, x, COMMAND), 0.0, x, h))
    for _ in range(500):
        x = step(x)
    m = rig.motion(0, x, COMMAND)
    np.testing.assert_allclose([x.north, x.east], m.p_WB[:2], atol=1e-10)
    np.testing.assert_allclose([x.surge_velocity, x.sway_velocity], m.v_WB_B[:2], atol=1e-12)
    exact = state(0.5, rig, first=0.0)
    np.testing.assert_allclose([x.heading, x.yaw_rate], [exact.heading, exact.yaw_rate], atol=1e-9)


def test_lean_gives_a_constant_acceleration_in_world_axes():
    """At rest an accelerometer feels g sin(tilt) away from where the axis leans, whatever the heading."""
    rig = RotatingPlatform(arm=0.0, tilt=0.0086, lean=0.7)
    for heading in (0.0, 1.0, 4.0):
        m = rig.motion(0, rig.rest_state(heading), PlatformDrive(0.0))
        level = np.asarray(from_euler(0.0, 0.0, heading) @ Imu().measure(m).specific_force)
        expected = -9.80665 * np.sin(0.0086) * np.array([np.cos(0.7), np.sin(0.7)])
        np.testing.assert_allclose(level[:2], expected, atol=2e-5)
        assert m.attitude[2] == pytest.approx(heading, abs=2e-5)


def test_yaw_is_unwrapped_over_full_turns():
    for turns in (-3, 0, 5):
        m = RIG.motion(0, RIG.rest_state(0.4 + 2 * np.pi * turns), COMMAND)
        assert m.attitude[2] == pytest.approx(0.4 + 2 * np.pi * turns, abs=0.02)
