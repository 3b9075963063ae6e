"""The torpedo against the sums of forces of its publication, and properties that hold for any parameters."""

import jax
import numpy as np
import pytest
from oracles import marine
from scipy.optimize import fsolve

from trimtab.core import quaternion
from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import seconds
from trimtab.environment.current import Current
from trimtab.vehicles.torpedo import CRUISE, RPM, Torpedo, TorpedoControls, TorpedoHull, TorpedoState

ZG = 0.0196
NOTHING = TorpedoControls(0.0, 0.0, 0.0)


quaternion_of = jax.jit(quaternion.from_euler)


def state_of(nu, euler, rudder=0.0, stern=0.0, shaft=CRUISE):
    """The state of the centre of mass, from velocities nu (6,) of the centre of buoyancy."""
    u, v, w, p, q, r = nu
    velocity = np.array([u + q * ZG, v - p * ZG, w])
    attitude = np.array(quaternion_of(*map(float, euler)))
    return to_arrays(TorpedoState(np.zeros(3), attitude, velocity, np.array([p, q, r]), rudder, stern, shaft))


def test_accelerations_match_the_published_force_sums():
    accelerations = jax.jit(Torpedo().accelerations)
    rng = np.random.default_rng(2)
    for _ in range(200):
        nu = rng.uniform(-1, 1, 6) * [2, 0.5, 0.5, 1, 0.6, 0.6]
        euler, fins = rng.uniform(-1, 1, 3), rng.uniform(-0.23, 0.23, 2)
        want = marine.remus(nu, euler, *fins)
        dv, dw = accelerations(state_of(nu, euler, *fins))
        moved = want[:3] + np.cross(want[3:], [0, 0, ZG])
        np.testing.assert_allclose(np.array(dv), moved, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(np.array(dw), want[3:], rtol=1e-9, atol=1e-10)


def test_kinematics_match_euler_angle_rates():
    nu, euler = np.array([1.5, 0.2, -0.1, 0.3, -0.2, 0.4]), np.array([0.3, -0.5, 1.2])
    x = state_of(nu, euler)
    d = Torpedo().dynamics(0.0, x, NOTHING)
    rates = marine.kinematics(np.concatenate([np.array(x.velocity), nu[3:]]), euler)
    np.testing.assert_allclose(np.array(d.position), rates[:3], rtol=1e-12)
    h = 1e-7
    turned = marine.euler_of(np.array(x.attitude) + h * np.array(d.attitude))
    np.testing.assert_allclose((np.array(turned) - euler) / h, rates[3:], atol=1e-6)


def test_level_trim_at_1500_rpm_matches_the_publication():
    """The same seven unknowns over the publication's equations: 1.477 m/s, 2.7 degrees nose down, rolled by 5.3."""

    def level(y):
        u, v, w, phi, theta, dr, ds = y
        nu = np.array([u, v, w, 0, 0, 0])
        return np.append(marine.remus(nu, (phi, theta, 0.0), dr, ds), marine.kinematics(nu, (phi, theta, 0.0))[2])

    y = fsolve(level, [1.5, 0, -0.07, -0.09, -0.05, 0, -0.15], xtol=1e-13)
    dv, dw = Torpedo().accelerations(state_of([*y[:3], 0, 0, 0], (y[3], y[4], 0.0), y[5], y[6]))
    np.testing.assert_allclose(np.concatenate([dv, dw]), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(y[3:]), [-5.322, -2.685, -0.928, -9.338], atol=2e-3)
    assert y[0] == pytest.approx(1.4766, abs=1e-4)


@pytest.mark.thorough
def test_constant_current_is_equivalent_to_moving_frame():
    current = Current(north=0.15, east=-0.25)
    u, still, moving = TorpedoControls(0.05, -0.1, CRUISE), Torpedo(), Torpedo(current=current)
    a = state_of([1.5, 0.1, 0.0, 0.1, 0, 0.1], (-0.05, -0.03, 0.4))
    flow = np.array(current.in_body(quaternion.to_matrix(a.attitude).T))
    b = to_arrays(replace(a, velocity=a.velocity + flow))
    step = jax.jit(lambda torpedo, x: rk4(lambda t, x: torpedo.dynamics(t, x, u), 0.0, x, 0.02))
    for _ in range(250):
        a, b = step(still, a), step(moving, b)
    np.testing.assert_allclose(np.array(b.position - a.position), [5 * 0.15, -5 * 0.25, 0], atol=1e-6)
    np.testing.assert_allclose(np.array(b.attitude), np.array(a.attitude), atol=1e-7)


@pytest.mark.thorough
def test_body_without_water_conserves_energy_and_momentum():
    dry = TorpedoHull(**dict.fromkeys(TorpedoHull.__dataclass_fields__, 0.0))
    free = Torpedo(buoyancy=299.0, lowered=0.0, hull=dry, thrust=0.0, torque=0.0)
    J = np.diag([0.177, 3.45, 3.45])
    x = state_of([1.0, 0.2, -0.3, 0.5, 0.4, -0.3], (0.3, 0.2, 0.1), shaft=0.0)

    def kept(x):
        R = np.array(quaternion.to_matrix(x.attitude))
        w, v = np.array(x.rate), np.array(x.velocity)
        return np.concatenate([R @ J @ w, R @ v, [w @ J @ w]])

    before = kept(x)
    step = jax.jit(lambda x: rk4(lambda t, x: free.dynamics(t, x, NOTHING), 0.0, x, 0.02))
    for _ in range(300):
        x = step(x)
    np.testing.assert_allclose(kept(x), before, rtol=1e-5, atol=1e-6)


def test_roll_period_at_rest_includes_added_inertia():
    """Roll: (Ixx - Kpdot - (m zg)^2/(m - Yvdot)) phi'' = -zg W phi: a period of 1.277 s for small angles."""
    neutral = Torpedo(buoyancy=299.0)
    x = state_of(np.zeros(6), (1e-3, 0.0, 0.0), shaft=0.0)
    m = 299 / 9.81
    inertia = 0.177 + 0.0704 - (m * ZG) ** 2 / (m + 35.5)
    _, dw = neutral.accelerations(x)
    side = inertia - 1.93**2 * (m * ZG) ** 2 / ((m + 35.5) ** 2 * 8.33)  # yaw gives way too
    assert float(dw[0]) == pytest.approx(-ZG * 299 * np.sin(1e-3) / side, rel=1e-2)
    assert 2 * np.pi * np.sqrt(inertia / (ZG * 299)) == pytest.approx(1.277, abs=1e-3)


def test_fins_and_propeller_have_the_correct_signs():
    torpedo = Torpedo(buoyancy=299.0, torque=0.0)

    def turning(**fins):
        dv, dw = torpedo.accelerations(state_of([1.5, 0, 0, 0, 0, 0], (0, 0, 0), **fins))
        return np.array(dv), np.array(dw)

    _, dw = turning(rudder=0.1)
    assert dw[2] < 0, "positive rudder turns to port"
    _, dw = turning(stern=0.1)
    assert dw[1] < 0, "positive stern planes push the nose down"
    assert turning(shaft=1600 * RPM)[0][0] > turning(shaft=1500 * RPM)[0][0] > turning(shaft=-500 * RPM)[0][0]
    light = Torpedo().accelerations(state_of(np.zeros(6), (0, 0, 0), shaft=0.0))[0]
    assert light[2] < 0, "lighter than water, it rises"


def test_fins_are_limited_in_angle_and_rate():
    told = TorpedoControls(1.0, -1.0, 1e4)
    d = Torpedo().dynamics(0.0, state_of(np.zeros(6), (0, 0, 0)), told)
    np.testing.assert_allclose([d.rudder, d.stern], np.radians([60, -60]))
    limit = np.radians(13.6)
    d = Torpedo().dynamics(0.0, state_of(np.zeros(6), (0, 0, 0), rudder=limit, stern=-limit), told)
    np.testing.assert_allclose([d.rudder, d.stern], 0.0, atol=1e-12)


def test_motion_is_the_derivative_of_the_position():
    torpedo, x = Torpedo(current=Current(east=0.2)), state_of([1.5, 0.2, -0.1, 0.3, -0.2, 0.4], (0.3, -0.5, 1.2))
    dynamics = jax.jit(lambda x: torpedo.dynamics(0.0, x, NOTHING))
    m, d = jax.jit(lambda x: torpedo.motion(seconds(1), x, NOTHING))(x), dynamics(x)
    R = np.array(quaternion.to_matrix(x.attitude))
    np.testing.assert_allclose(R @ np.array(m.v_WB_B), np.array(d.position), rtol=1e-12)
    h = 1e-6
    later = jax.tree.map(lambda a, b: a + h * b, x, d)
    after = dynamics(later)
    np.testing.assert_allclose(R @ np.array(m.a_WB_B), (np.array(after.position) - np.array(d.position)) / h, atol=2e-5)
    np.testing.assert_allclose(np.array(m.attitude), [0.3, -0.5, 1.2], rtol=1e-12)


def test_attitude_is_normalised_after_a_step():
    x = replace(state_of(np.zeros(6), (0.1, 0.2, 0.3)), attitude=np.array([2.0, 0, 0, 1.0]))
    q = np.array(Torpedo().after_step(0.0, x).attitude)
    assert q @ q == pytest.approx(1.0, abs=1e-15)
