"""The surface vessel against its publication's matrices, and properties that hold for any parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import marine

from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import seconds
from trimtab.environment.current import Current
from trimtab.environment.wind import Wind
from trimtab.vehicles.surface_vessel import TURN, HullDamping, SurfaceVessel, VesselControls, VesselState, WindLoad

XG = 0.046
NOTHING = VesselControls(0.0, 0.0)


def random_states(n, seed=1):
    rng = np.random.default_rng(seed)
    u, v, r = rng.uniform(-0.8, 1.0, n), rng.uniform(-0.4, 0.4, n), rng.uniform(-0.5, 0.5, n)
    return list(zip(u, v, r, rng.uniform(-3, 3, n), rng.uniform(-0.6, 0.6, n), rng.uniform(-33, 33, n), strict=True))


def test_accelerations_match_the_published_matrices():
    """About the centre of mass here, amidships there: v' = v_O' + x_g r'."""
    vessel = SurfaceVessel(current=Current(north=-0.2, east=0.3))
    accelerations = jax.jit(vessel.accelerations)
    for u, v, r, psi, delta, rps in random_states(200):
        x = VesselState(u, v + XG * r, r, 0.0, 0.0, psi, delta, rps * TURN)
        want = marine.cybership((u, v, r), delta, rps, (-0.2, 0.3), psi)
        want[1] += XG * want[2]
        np.testing.assert_allclose(np.array(accelerations(to_arrays(x))), want, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
def test_constant_current_is_equivalent_to_moving_frame():
    """A constant current is a frame that moves along: the same motion, seen from a drifting raft."""
    current, flow = Current(north=0.15, east=-0.25), np.array([0.15, -0.25])
    u = VesselControls(0.2, 100.0)
    still, moving = SurfaceVessel(), SurfaceVessel(current=current)
    a = to_arrays(VesselState(surge_velocity=0.4, heading=0.5, shaft_speed=90.0))
    along, across = current.in_plane(a.heading)
    b = to_arrays(replace(a, surge_velocity=a.surge_velocity + along, sway_velocity=a.sway_velocity + across))
    step = jax.jit(lambda vessel, x: rk4(lambda t, x: vessel.dynamics(t, x, u), 0.0, x, 0.02))
    for _ in range(500):
        a, b = step(still, a), step(moving, b)
    drift = 10.0 * flow
    np.testing.assert_allclose([b.north - a.north, b.east - a.east], drift, atol=1e-9)
    assert float(b.heading) == pytest.approx(float(a.heading), abs=1e-9)


def test_undamped_unforced_vessel_conserves_energy():
    free = SurfaceVessel(damping=HullDamping(*[0.0] * 15))
    x = to_arrays(VesselState(0.6, 0.2, 0.4))

    def energy(x):
        v = x.sway_velocity - XG * x.yaw_rate
        m11, m22, m23, m33 = 25.8, 33.8, 23.8 * XG, 2.76
        r = x.yaw_rate
        return (m11 * x.surge_velocity**2 + m22 * v**2 + 2 * m23 * v * r + m33 * r**2) / 2

    before = energy(x)
    step = jax.jit(lambda x: rk4(lambda t, x: free.dynamics(t, x, NOTHING), 0.0, x, 0.02))
    for _ in range(500):
        x = step(x)
    assert abs(float(x.surge_velocity) - 0.6) > 0.01, "it has turned"
    assert float(energy(x)) == pytest.approx(before, rel=1e-8)


def test_surge_damping_dissipates_energy():
    damping = HullDamping()
    u, v, r = np.array(random_states(300, seed=4)).T[:3]
    X, _, _ = jax.jit(damping.wrench)(u, v, r)
    assert (X * u <= 0).all()


def test_positive_rudder_turns_the_vessel_to_port():
    vessel = SurfaceVessel()
    straight = VesselState(surge_velocity=0.6, shaft_speed=105.0)
    _, dv, dr = vessel.accelerations(to_arrays(replace(straight, rudder=0.2)))
    assert dv > 0
    assert dr < 0
    _, dv0, dr0 = vessel.accelerations(to_arrays(straight))
    assert (float(dv0), float(dr0)) == (0.0, 0.0), "alike to both sides"


def test_servos_are_limited_in_angle_and_rate():
    vessel = SurfaceVessel()
    told = VesselControls(2.0, 1e4)
    d = vessel.dynamics(0.0, to_arrays(VesselState()), told)
    assert float(d.rudder) == pytest.approx(np.radians(30))
    at_stop = vessel.dynamics(0.0, to_arrays(VesselState(rudder=np.radians(35), shaft_speed=2000 / 60 * TURN)), told)
    np.testing.assert_allclose([at_stop.rudder, at_stop.shaft_speed], 0.0, atol=1e-12)


def test_wind_load_depends_on_relative_wind():
    load = WindLoad(wind=Wind(north=-3.0))
    X, Y, N = load.wrench(to_arrays(VesselState()))
    assert X < 0
    np.testing.assert_allclose([Y, N], 0.0, atol=1e-15)
    X, Y, N = load.wrench(to_arrays(VesselState(heading=np.pi / 2)))
    assert Y > 0, "from starboard ahead of east: the wind to the south comes from port"
    np.testing.assert_allclose(X, 0.0, atol=1e-12)
    np.testing.assert_allclose(load.wrench(to_arrays(VesselState(surge_velocity=-3.0))), 0.0, atol=1e-15)


def test_motion_is_the_derivative_of_the_pose():
    vessel, x, u = (
        SurfaceVessel(current=Current(north=0.1)),
        to_arrays(VesselState(0.5, 0.1, 0.3, 1, 2, 0.7, 0.2, 80)),
        NOTHING,
    )
    dynamics = jax.jit(lambda x: vessel.dynamics(0.0, x, u))
    m, d = jax.jit(lambda x: vessel.motion(seconds(1), x, u))(x), dynamics(x)
    c, s = np.cos(x.heading), np.sin(x.heading)
    R = np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(R @ np.array(m.v_WB_B[:2]), [d.north, d.east], rtol=1e-12)
    h = 1e-6
    later = jax.tree.map(lambda a, b: a + h * b, x, d)
    after = dynamics(later)
    np.testing.assert_allclose(
        R @ np.array(m.a_WB_B[:2]), [(after.north - d.north) / h, (after.east - d.east) / h], atol=1e-5
    )
    assert float(m.alpha_WB_B[2]) == pytest.approx(float(d.yaw_rate))


def test_steady_speed_balances_thrust_and_resistance():
    """At 1000 rpm: 2 T(n, u) = 0.72253 u + 1.32742 u² + 5.86643 u³, solved here by bisection."""
    n, low, high = 1000 / 60, 0.0, 1.0
    for _ in range(60):
        u = (low + high) / 2
        T = 3.65034e-3 * n * n - 1.52468e-4 * n * u
        low, high = (u, high) if 0.72253 * u + 1.32742 * u**2 + 5.86643 * u**3 < 2 * T else (low, u)
    x = to_arrays(VesselState(surge_velocity=u, shaft_speed=n * TURN))
    assert float(SurfaceVessel().accelerations(x)[0]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.thorough
def test_vessel_is_course_unstable():
    """The linear model of sway and yaw at 1000 rpm has a root on the right: damping cannot hold Munk's moment."""
    vessel, n = SurfaceVessel(), 1000 / 60 * TURN

    def rates(z):
        return jnp.stack(vessel.accelerations(VesselState(0.5818, z[0], z[1], shaft_speed=n))[1:])

    roots = np.linalg.eigvals(np.array(jax.jacfwd(rates)(jnp.zeros(2))))
    A = (
        np.array([(marine.cybership((0.5818, 1e-7 * i, 1e-7 * j), 0, n / TURN))[1:] for i, j in ((1, 0), (0, 1))]).T
        / 1e-7
    )
    T = np.array([[1, -XG], [0, 1]])  # amidships from the centre of mass
    want = np.linalg.eigvals(np.linalg.inv(T) @ A @ T)
    np.testing.assert_allclose(sorted(roots), sorted(want), atol=1e-4)
    assert sorted(roots)[1] == pytest.approx(0.774, abs=0.005)
