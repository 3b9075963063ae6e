"""A body on a closed path: consistent derivatives, no sideslip, closed laps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.rotation import from_euler
from trimtab.environment.geodetic import STANDARD
from trimtab.vehicles.closed_path import ClosedPath
from trimtab.vehicles.rotating_platform import PlatformDrive

RATE = 2 * np.pi / 20
PATH = ClosedPath(coordinated=RATE)
DRIVE = PlatformDrive(rate=RATE)
ANGLES = np.linspace(0, 2 * np.pi, 13)


@jax.jit
def motion(angle, rate=RATE, command=RATE):
    at = PATH.at(0.0, RATE)
    return PATH.motion(
        0, replace(at, angle=jnp.asarray(angle, float), rate=jnp.asarray(rate, float)), PlatformDrive(rate=command)
    )


def central(f, x, h=1e-5):
    return (np.asarray(f(x + h)) - np.asarray(f(x - h))) / (2 * h)


def R_of(m):
    return np.asarray(from_euler(*m.attitude))


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_velocity_acceleration_and_rates_are_derivatives(angle):
    """By differences along the path, at its rate; all in B."""
    m = motion(angle)
    R = R_of(m)
    v = central(lambda a: motion(a).p_WB, angle) * RATE
    a = central(lambda a: R_of(motion(a)) @ motion(a).v_WB_B, angle) * RATE
    W = R.T @ central(lambda a: R_of(motion(a)), angle) * RATE
    np.testing.assert_allclose(m.v_WB_B, R.T @ v, atol=1e-7)
    np.testing.assert_allclose(m.a_WB_B, R.T @ a, atol=1e-6)
    np.testing.assert_allclose(m.w_WB_B, [W[2, 1], W[0, 2], W[1, 0]], atol=1e-8)
    np.testing.assert_allclose(m.alpha_WB_B, central(lambda a: motion(a).w_WB_B, angle) * RATE, atol=1e-6)


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_flight_is_forward_without_sideslip_or_side_force(angle):
    """Velocity along x, no force across the wings, lift upwards."""
    m = motion(angle)
    v = np.asarray(m.v_WB_B)
    np.testing.assert_allclose(v[1:], 0, atol=1e-9)
    assert v[0] > 5
    felt = np.asarray(m.a_WB_B) - R_of(m).T @ [0, 0, STANDARD]
    assert abs(felt[1]) < 1e-9
    assert felt[2] < -5


def test_lap_closes_and_yaw_is_continuous():
    first, last = motion(ANGLES[0]), motion(ANGLES[-1])
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-12), first, last)
    yaw = [float(motion(a).attitude[2]) for a in np.linspace(0, 2 * np.pi, 400)]
    assert np.abs(np.diff(yaw)).max() < 0.1


@pytest.mark.thorough
def test_integrated_state_matches_the_motion():
    """A lap and a half in steps of 5 ms, the rate changed on the way: position, velocity, attitude are the motion's."""
    x, h = PATH.at(0.3, RATE), 0.005

    @jax.jit
    def step(x, u):
        return rk4(lambda t, x: PATH.dynamics(t, x, u), 0.0, x, h)

    for k in range(2000):
        u = PlatformDrive(rate=RATE * (1.0 if k < 1000 else 0.7))
        x = step(x, u)
    m = PATH.motion(0, x, u)
    R = R_of(m)
    np.testing.assert_allclose(x.position, m.p_WB, atol=1e-6)
    np.testing.assert_allclose(x.velocity, R @ m.v_WB_B, atol=1e-6)
    np.testing.assert_allclose(quaternion.local(x.attitude, quaternion.from_matrix(R)), 0, atol=1e-7)
    assert float(x.rate) == pytest.approx(0.7 * RATE, rel=1e-3)


@pytest.mark.thorough
def test_acceleration_includes_the_rate_change():
    """Above the commanded rate it slows down, along its path."""
    slower = np.asarray(motion(1.0, RATE, 0.5 * RATE).a_WB_B) - np.asarray(motion(1.0).a_WB_B)
    assert slower[0] < -1
    np.testing.assert_allclose(slower[1:], 0, atol=1e-9)
