"""The hovercraft: energy, equilibria, motion that agrees with the dynamics, and friction.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.core.record import to_arrays
from trimtab.core.rotation import planar
from trimtab.core.signals import PlanarForce
from trimtab.core.time import ms
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

NO_FORCE = PlanarForce(0.0, 0.0)
TUMBLING = HovercraftState(0.2, -0.7, 6.4, 1.0, -2.0, 0.3)
FRICTION = Friction(
    force_coulomb=0.2,
    force_viscous=0.3,
    force_quadratic=0.1,
    torque_coulomb=0.01,
    torque_viscous=0.02,
    torque_quadratic=0.03,
)
NAMES = ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading")


def _row(x):
    return np.array([float(getattr(x, n)) for n in NAMES])


@jax.jit
def _run(craft, x, u, h, n):
    return jax.lax.fori_loop(0, n, lambda i, x: rk4(lambda t, x: craft.dynamics(t, x, u), i * h, x, h), x)


def _textbook(t, y, m, J, d, FX, FY):
    """[1] eqs. 2.10 and 2.11 as printed, in momenta: y = PX, PY, Pi, x, y, phi."""
    PX, PY, Pi, _, _, phi = y
    B = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    return np.array([PY * Pi / J + FX, -PX * Pi / J + FY, -d * FY, *(B @ [PX / m, PY / m]), Pi / J])


def test_default_parameters_match_the_thesis():
    craft = Hovercraft()
    assert (craft.mass, craft.inertia, craft.arm) == (2.6, 0.096, 0.32)
    assert craft.arm**2 * craft.mass == pytest.approx(0.26624)


@pytest.mark.parametrize("seed", range(5))
def test_dynamics_match_the_published_equations(seed):
    rng = np.random.default_rng(seed)
    m, J, d = rng.uniform(0.5, 3, 3)
    x = HovercraftState(*rng.normal(size=6))
    FX, FY = rng.normal(size=2)
    got = _row(Hovercraft(m, J, d).dynamics(0.0, x, PlanarForce(FX, FY)))
    scale = np.array([m, m, J, 1, 1, 1])
    np.testing.assert_allclose(got * scale, _textbook(0.0, _row(x) * scale, m, J, d, FX, FY), rtol=1e-13, atol=1e-15)


def test_trajectory_matches_an_independent_integrator():
    from scipy.integrate import solve_ivp

    craft, u = Hovercraft(), PlanarForce(0.8, -0.2)
    scale = np.array([2.6, 2.6, 0.096, 1, 1, 1])
    truth = solve_ivp(
        _textbook, (0, 3), _row(TUMBLING) * scale, args=(2.6, 0.096, 0.32, 0.8, -0.2), rtol=1e-12, atol=1e-13
    )
    got = _row(_run(craft, TUMBLING, u, 1e-3, 3000))
    np.testing.assert_allclose(got, truth.y[:, -1] / scale, rtol=1e-9, atol=1e-9)


def test_unforced_energy_drift_is_of_integration_order():
    """Fourth order: sixteenth of the energy drift or better for half the step, and tiny at 1 ms."""
    craft = Hovercraft()
    start = float(craft.energy(TUMBLING))
    drift = [abs(float(craft.energy(_run(craft, TUMBLING, NO_FORCE, h, round(8 / h)))) - start) for h in (0.08, 0.04)]
    assert drift[0] > 15 * drift[1] > 0
    assert float(craft.energy(_run(craft, TUMBLING, NO_FORCE, 1e-3, 8000))) == pytest.approx(start, rel=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_energy_rate_equals_power_at_the_rudder_pivot(seed):
    """dE/dt = F . (velocity of the point (-d, 0)) = FX u + FY (v - d r)."""
    rng = np.random.default_rng(seed)
    craft, x, u = Hovercraft(), HovercraftState(*rng.normal(size=6)), PlanarForce(*rng.normal(size=2))
    rate = jax.jvp(craft.energy, (x,), (craft.dynamics(0.0, x, u),))[1]
    power = u.FX * x.surge_velocity + u.FY * (x.sway_velocity - craft.arm * x.yaw_rate)
    assert float(rate) == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize(
    "velocities", [(0, 0, 0), (0.4, -0.3, 0), (0, 0, 2.0)], ids=["rest", "translation", "rotation"]
)
def test_rest_translation_and_rotation_are_unforced_equilibria(velocities):
    """[1] section 2.1: (0,0,0), (c1,c2,0), (0,0,c) and no other."""
    x = HovercraftState(*map(float, velocities), heading=0.7)
    assert (_row(Hovercraft().dynamics(0.0, x, NO_FORCE))[:3] == 0).all()


def test_translation_with_rotation_is_not_an_equilibrium():
    x = HovercraftState(0.4, -0.3, 2.0)
    assert np.abs(_row(Hovercraft().dynamics(0.0, x, NO_FORCE))[:2]).min() > 0.5


def test_only_rest_is_an_equilibrium_of_full_dynamics():
    """[1] section 2.1: (0, 0, 0, c1, c2, c3)."""
    rest = HovercraftState(north=3.0, east=-4.0, heading=1.0)
    assert (_row(Hovercraft().dynamics(0.0, rest, NO_FORCE)) == 0).all()
    moving = HovercraftState(0.4, -0.3, 0.0)
    assert np.abs(_row(Hovercraft().dynamics(0.0, moving, NO_FORCE))).max() > 0.1


def test_forces_and_heading_have_the_correct_signs():
    """Thrust ahead speeds up; a force to starboard at the tail slides to starboard and turns the nose to port."""
    craft, rest = Hovercraft(), HovercraftState()
    ahead = craft.dynamics(0.0, rest, PlanarForce(1.0, 0.0))
    assert float(ahead.surge_velocity) > 0
    assert float(ahead.yaw_rate) == 0
    starboard = craft.dynamics(0.0, rest, PlanarForce(0.0, 1.0))
    assert float(starboard.sway_velocity) > 0
    assert float(starboard.yaw_rate) == pytest.approx(-0.32 / 0.096)
    east = craft.dynamics(0.0, HovercraftState(surge_velocity=1.0, heading=np.pi / 2), NO_FORCE)
    assert float(east.east) == pytest.approx(1.0)


@pytest.mark.parametrize("friction", [None, FRICTION], ids=["frictionless", "friction"])
def test_motion_accelerations_match_second_differences(friction):
    """Oracle: central differences of the inertial velocity and of the yaw rate along an integrated path."""
    craft, u, h = Hovercraft(friction=friction), PlanarForce(0.9, 0.4), 1e-4
    before, after = _run(craft, TUMBLING, u, -h, 1), _run(craft, TUMBLING, u, h, 1)
    motion = craft.motion(ms(5), to_arrays(TUMBLING), u)

    def inertial(x):
        return np.asarray(planar(x.heading)) @ [float(x.surge_velocity), float(x.sway_velocity)]

    in_world = (inertial(after) - inertial(before)) / (2 * h)
    in_body = np.asarray(planar(TUMBLING.heading)).T @ in_world
    np.testing.assert_allclose(motion.a_WB_B[:2], in_body, rtol=1e-6, atol=1e-6)
    turn = (float(after.yaw_rate) - float(before.yaw_rate)) / (2 * h)
    assert float(motion.alpha_WB_B[2]) == pytest.approx(turn, rel=1e-6)
    path = (np.array([after.north, after.east]) - np.array([before.north, before.east])) / (2 * h)
    np.testing.assert_allclose(planar(TUMBLING.heading) @ motion.v_WB_B[:2], path, rtol=1e-6)


def test_motion_equals_the_state_and_is_planar():
    motion = Hovercraft().motion(ms(5), to_arrays(TUMBLING), to_arrays(PlanarForce(1.0, 2.0)))
    assert motion.t == ms(5)
    np.testing.assert_array_equal(motion.p_WB, [1.0, -2.0, 0.0])
    np.testing.assert_array_equal(motion.attitude, [0.0, 0.0, 0.3])
    np.testing.assert_array_equal(motion.v_WB_B, [0.2, -0.7, 0.0])
    np.testing.assert_array_equal(motion.w_WB_B, [0.0, 0.0, 6.4])
    assert motion.a_WB_B[2] == 0
    assert (motion.alpha_WB_B[:2] == 0).all()


@pytest.mark.parametrize(
    "velocities", [(0.3, -0.4, 2.0), (-1.0, 0.0, -0.5), (0.001, 0.002, 0.003), (0, 0, 1), (1, 0, 0)]
)
def test_friction_matches_its_formula_and_dissipates(velocities):
    u, v, r = map(float, velocities)
    f = FRICTION
    speed = np.hypot(u, v)
    size = f.force_coulomb * np.tanh(speed / f.slip_speed) + f.force_viscous * speed + f.force_quadratic * speed**2
    along = (np.array([u, v]) / speed) if speed else np.zeros(2)
    torque = f.torque_coulomb * np.tanh(abs(r) / f.slip_rate) + f.torque_viscous * abs(r) + f.torque_quadratic * r**2
    wrench = np.array([float(w) for w in f.wrench(u, v, r)])
    np.testing.assert_allclose(wrench, [*(-size * along), -torque * np.sign(r)], rtol=1e-12, atol=1e-15)
    assert wrench @ [u, v, r] < 0


def test_energy_loss_rate_equals_friction_power():
    craft = Hovercraft(friction=FRICTION)
    rate = jax.jvp(craft.energy, (TUMBLING,), (craft.dynamics(0.0, TUMBLING, NO_FORCE),))[1]
    velocities = _row(TUMBLING)[:3]
    assert float(rate) == pytest.approx(float(np.dot(FRICTION.wrench(*velocities), velocities)), rel=1e-12)
    energies = [float(craft.energy(_run(craft, TUMBLING, NO_FORCE, 1e-3, n))) for n in (0, 200, 1000, 3000)]
    assert energies == sorted(energies, reverse=True)
    assert energies[-1] < 0.5 * energies[0]


def test_zero_friction_coefficients_equal_no_friction():
    u = PlanarForce(0.3, 0.1)
    with_zeros = _row(Hovercraft(friction=Friction()).dynamics(0.0, TUMBLING, u))
    np.testing.assert_array_equal(with_zeros, _row(Hovercraft().dynamics(0.0, TUMBLING, u)))


@pytest.mark.thorough
@pytest.mark.parametrize("x", [HovercraftState(), TUMBLING], ids=["rest", "tumbling"])
def test_jacobians_are_finite_at_rest_and_in_motion(x):
    craft = to_arrays(Hovercraft(friction=FRICTION))
    x, u = to_arrays(x), to_arrays(PlanarForce(0.1, 0.2))
    slope = jax.jacfwd(lambda x: craft.dynamics(0.0, x, u))(x)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))
    by_mass = jax.jacfwd(lambda c: c.dynamics(0.0, x, u))(craft)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_mass))


@pytest.mark.thorough
def test_friction_derivative_at_rest_includes_coulomb_term():
    """Towards rest the force is -(c0/v0 + c1) v: the derivative at rest must say so, not drop the dry part."""
    small = 1e-7
    wanted = (float(FRICTION.wrench(small, 0.0, 0.0)[0]) - float(FRICTION.wrench(-small, 0.0, 0.0)[0])) / (2 * small)
    got = jax.jacfwd(lambda v: FRICTION.wrench(v, 0.0, 0.0)[0])(0.0)
    assert wanted == pytest.approx(-(0.2 / 0.01 + 0.3), rel=1e-6)
    assert float(got) == pytest.approx(wanted, rel=1e-6)
