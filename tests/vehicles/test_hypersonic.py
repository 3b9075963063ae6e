"""The hypersonic vehicle: published numbers, the algebraic loop, units, motion, disturbances.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

from trimtab.core.integrate import rk4
from trimtab.core.record import Quantity, leaves, replace, to_arrays, with_leaf
from trimtab.core.rotation import from_euler
from trimtab.vehicles import imperial
from trimtab.vehicles.hypersonic import Disturbance, Hypersonic, HypersonicInput, HypersonicState
from trimtab.vehicles.hypersonic_aerodynamics import KMODES, FlexibleModes, RigidForces

H, V = 85000.0, 7702.0808
DEG = math.pi / 180
NAMES = tuple(HypersonicState.__dataclass_fields__)
QUOTED = (1.5153 * DEG, 0.2514, 11.4635 * DEG)
"""alpha, Phi, delta_e at which the truth model behind the curves trims, and this one does not."""


def _with(kmode, **changes):
    return replace(Hypersonic(**changes), modes=FlexibleModes(kmode=kmode))


def _row(x):
    return np.array([float(getattr(x, n)) for n in NAMES])


def _state(values):
    return HypersonicState(*(float(v) for v in values))


def _plain(x, u, kmode, g=1.39e16 / 20988500.0**2):
    """[1] eqs. 1-3 in plain numbers: the nine derivatives, with the loop as a 3x3 system."""
    h, v, a, th, q, e1, d1, e2, d2 = x
    Phi, de = u
    rho = 6.7429e-5 * math.exp(-(h - 85000) / 21358)
    qS = rho * v**2 / 2 * 17
    L = qS * (4.6773 * a + 0.76224 * de - 0.018714)
    D = qS * (5.8224 * a**2 - 0.045315 * a + 0.81993 * de**2 + 2.7699e-4 * de + 0.010131)
    T = (-3.7693e5 * a**3 + 2.6814e4 * a**2 + 3.5542e4 * a + 6.3785e3) * Phi
    T += -3.7225e4 * a**3 - 1.7277e4 * a**2 - 2.4216e3 * a - 1.0090e2
    M = 8.36 * T + qS * 17 * (6.2926 * a**2 + 2.1335 * a + 0.18979 - 1.2897 * de)
    r1 = -2 * 0.02 * 16.5 * d1 - 272.25 * e1 + 1.4013e3 * a**2 + 4.5737e3 * a + 117.52
    r2 = -2 * 0.02 * 20 * d2 - 400 * e2 - 5.0227e3 * a**2 + 2.8633e3 * a + 1.2465e3 * de - 44.201
    solved = np.linalg.solve(*_loop(kmode, M, r1, r2))
    gam = th - a
    Vr = (T * math.cos(a) - D) / 300 - g * math.sin(gam)
    ar = -(T * math.sin(a) + L) / (300 * v) + q + g / v * math.cos(gam)
    return np.array([v * math.sin(gam), Vr, ar, q, solved[0], d1, solved[1], d2, solved[2]])


def _loop(kmode, M, r1, r2, I=5e5, psi=(136.82, 329.22)):
    """Matrix and right-hand side of [Q'; eta1''; eta2''], [1] eq. 1."""
    p1, p2 = psi
    if kmode == "parker":
        return np.array([[I, -p1, -p2], [p1, 1, 0], [p2, 0, 1]]), np.array([M, r1, r2])
    a1, a2 = (p1, p2) if kmode == "paper" else (p1 / I, p2 / I)
    cross = p1 * p2 / I if kmode == "paper" else p1 * p2 / I**2
    rigid = [I, -p1, -p2]
    return np.array([rigid, [0, 1, cross], [0, cross, 1]]), np.array([M, r1 - a1 * M / I, r2 - a2 * M / I])


@functools.cache
def _trim(g=Hypersonic.g):
    """alpha, Phi, delta_e of level flight at the reference point, by a solver that knows nothing of the model."""
    craft = Hypersonic(g=g)

    def residual(z):
        rate = craft.dynamics(0.0, craft.level_state(H, V, z[0], z[2]), HypersonicInput(z[1], z[2]))
        return [float(rate.V), float(rate.alpha) * V, float(rate.q)]

    return fsolve(residual, [0.03, 0.3, 0.2], xtol=1e-14)


def _at_trim():
    alpha, Phi, delta_e = _trim()
    return Hypersonic().level_state(H, V, alpha, delta_e), HypersonicInput(Phi, delta_e)


def _random(seed):
    rng = np.random.default_rng(seed)
    x = [H, V, 0.03, 0.03, 0, 0.9, 0, 0.7, 0] + rng.normal(size=9) * [3e3, 3e2, 0.02, 0.02, 0.02, 0.3, 3, 0.3, 3]
    return x, np.array([0.3, 0.2]) + rng.normal(size=2) * [0.1, 0.1]


@pytest.mark.parametrize("kmode", KMODES)
def test_check_01_algebraic_loop_is_solved_exactly(kmode):
    """The 3x3 solve against the closed form, relative 1e-12 (here each mode)."""
    rng = np.random.default_rng(1)
    modes = FlexibleModes(kmode=kmode)
    for M, r1, r2 in rng.normal(size=(50, 3)) * [1e5, 300, 300]:
        got = np.array([float(v) for v in modes.solve_accelerations(5e5, M, r1, r2)])
        np.testing.assert_allclose(got, np.linalg.solve(*_loop(kmode, M, r1, r2)), rtol=1e-12)


def test_check_01_determinant_of_the_algebraic_loop():
    """627105.52 +- 0.01; what 1 lbf ft of moment turns, too."""
    assert np.linalg.det(_loop("parker", 0, 0, 0)[0]) == pytest.approx(627105.52, abs=0.01)
    assert 1 / float(FlexibleModes().solve_accelerations(5e5, 1.0, 0.0, 0.0)[0]) == pytest.approx(627105.52, abs=0.01)


def test_check_02_trim_matches_the_reference():
    """Alpha, Phi, delta_e to 1e-5 relative, residual below 1e-10."""
    alpha, Phi, delta_e = _trim()
    np.testing.assert_allclose([alpha / DEG, Phi, delta_e / DEG], [1.596784, 0.264449, 12.427146], rtol=1e-5)
    x, u = _at_trim()
    for kmode in KMODES:
        assert np.abs(_row(_with(kmode).dynamics(0.0, x, u))).max() < 1e-10
    assert (x.eta1, x.eta2) == (pytest.approx(0.903851, rel=1e-5), pytest.approx(0.755137, rel=1e-5))


def test_forces_at_trim_match_the_oracle():
    """Oracle, forces."""
    f = Hypersonic().forces_at(*_at_trim())
    got = [float(f.qbar), float(f.T), float(f.L), float(f.D), Hypersonic.m * Hypersonic.g]
    np.testing.assert_allclose(got, [2000.0132, 1769.4663, 9416.840, 1768.779, 9466.147], rtol=1e-6)


def test_sea_level_gravity_changes_the_trim():
    """Oracle, gravity."""
    alpha, Phi, delta_e = _trim(32.174)
    np.testing.assert_allclose([alpha / DEG, Phi, delta_e / DEG], [1.644566, 0.268090, 12.539973], rtol=1e-5)
    assert Hypersonic().g == pytest.approx(31.5538239, abs=5e-8)


def test_published_trim_point_is_not_an_equilibrium():
    """Oracle, trim: V' +0.3484, V gamma' -2.2244 ft/s^2, M/Iyy 0.01926 rad/s^2, N_i/w_i^2 0.8796 and 0.6935."""
    alpha, Phi, delta_e = QUOTED
    craft = Hypersonic()
    x, u = craft.level_state(H, V, alpha, delta_e), HypersonicInput(Phi, delta_e)
    along, normal = craft.path_accelerations(0.0, x, u)
    assert float(along) == pytest.approx(0.3484, abs=1e-4)
    assert float(normal) == pytest.approx(-2.2244, abs=1e-4)
    assert float(craft.forces_at(x, u).M) / craft.Iyy == pytest.approx(0.01926, abs=1e-5)
    assert (x.eta1, x.eta2) == (pytest.approx(0.8796, abs=1e-4), pytest.approx(0.6935, abs=1e-4))


@pytest.mark.parametrize("kmode", KMODES)
def test_dynamics_match_the_written_out_equations(kmode):
    craft = _with(kmode)
    for seed in range(8):
        x, u = _random(seed)
        got = _row(craft.dynamics(0.0, _state(x), HypersonicInput(*u)))
        want = _plain(x, u, kmode)
        scale = np.array([1e3, 1e2, 1, 1, 1, 1, 1e2, 1, 1e2])
        np.testing.assert_allclose(got / scale, want / scale, rtol=1e-11, atol=1e-13)


def test_flexible_modes_do_not_change_forces_or_path():
    """[1] eqs. 1-3: aerodynamic forces and moment do not depend on eta; the path's accelerations neither."""
    x, u = _at_trim()
    bent = replace(x, eta1=5.0, eta1_rate=-30.0, eta2=-2.0, eta2_rate=10.0)
    craft = Hypersonic()
    assert craft.forces_at(x, u) == craft.forces_at(bent, u)
    assert craft.path_accelerations(0.0, x, u) == craft.path_accelerations(0.0, bent, u)
    assert abs(float(craft.dynamics(0.0, bent, u).q) - float(craft.dynamics(0.0, x, u).q)) > 0.1


@pytest.mark.thorough
def test_dynamics_are_affine_in_inputs_except_drag():
    """[1] eq. 4: everything in Phi; in the elevator all but V', whose slope of drag is 40.34, not 20.19."""
    x, u = _at_trim()
    craft = Hypersonic()
    curve = jax.jacfwd(jax.jacfwd(lambda v: jnp.stack(_leaves(craft, x, v))))(jnp.array([u.Phi, u.delta_e]))
    by_elevator = dict(zip(NAMES, np.asarray(curve[:, 1, 1]), strict=True))
    np.testing.assert_array_equal(np.asarray(curve[:, 0]), 0.0)
    assert by_elevator.pop("V") == pytest.approx(-2 * 2000.0132 * 17 * 0.81993 / 300, rel=1e-6)
    assert not any(by_elevator.values())
    slope = jax.grad(lambda d: craft.forces_at(x, HypersonicInput(u.Phi, d)).D)(u.delta_e) / craft.m
    air = craft.forces.aerodynamics
    secant = 2000.0132 * air.S * (air.CD_d2 * u.delta_e + air.CD_d) / craft.m
    assert (float(slope), secant) == (pytest.approx(40.34, abs=5e-3), pytest.approx(20.19, abs=5e-3))


def _leaves(craft, x, v):
    return [*jax.tree.leaves(craft.dynamics(0.0, x, HypersonicInput(v[0], v[1])))]


def test_open_loop_poles_match_the_reference():
    """[1] eqs. 4-8, the plant at the trim with u held."""
    x, u = _at_trim()
    craft = Hypersonic()
    slope = jax.jit(jax.jacfwd(lambda row: jnp.stack(jax.tree.leaves(craft.dynamics(0.0, HypersonicState(*row), u)))))
    poles = np.linalg.eigvals(np.asarray(slope(jnp.asarray(_row(x)))))
    for want, digits in [(1.6957, 1e-4), (-1.7658, 1e-4), (-8.0e-4 + 0.0419j, 1e-4), (0, 1e-6)]:
        assert np.abs(poles - want).min() < digits
    for want in (-0.3053 + 15.960j, -0.3455 + 18.393j):
        assert np.abs(poles - want).min() < 1e-3
    assert (poles.real > 1e-6).sum() == 1


def _in_si(record):
    """The same record, every number in the SI."""
    for path, _, declared in leaves(record):
        if isinstance(declared, Quantity):
            record = with_leaf(record, path, lambda value, d: value * imperial.factor(d.unit))
    return record


@pytest.mark.parametrize("kmode", KMODES)
def test_units_are_consistent(kmode):
    """In SI numbers the same equations give the same motion: every declared unit is right, and `author` mixes units."""
    craft, per_radian = _with(kmode), Disturbance(moment=300.0, along=20.0, normal=-50.0)
    craft = replace(craft, disturbance=per_radian)
    values, inputs = _random(3)
    x, u = _state(values), HypersonicInput(*inputs)
    want = _row(_in_si(craft.dynamics(0.0, x, u)))
    got = _row(_in_si(craft).dynamics(0.0, _in_si(x), u))
    agrees = np.isclose(got, want, rtol=1e-11, atol=1e-12)
    assert agrees.all() == (kmode != "author")


def test_motion_is_consistent_with_the_dynamics():
    """Altitude, and velocity turned into the world, differentiated along the dynamics."""
    craft = Hypersonic()
    values, inputs = _random(5)
    x, u = to_arrays(_state(values)), HypersonicInput(*inputs)

    def world(x):
        m = craft.motion(0, x, u)
        return m.p_WB, from_euler(m.attitude[0], m.attitude[1], m.attitude[2]) @ m.v_WB_B, m.attitude, m.w_WB_B

    derivatives = jax.jit(lambda x: (jax.jvp(world, (x,), (craft.dynamics(0.0, x, u),)), craft.motion(0, x, u)))
    ((_, v_W, _, w), rates), m = derivatives(x)
    turn = from_euler(*m.attitude)
    assert float(v_W[2]) == pytest.approx(float(rates[0][2]), rel=1e-12)
    np.testing.assert_allclose(rates[1], turn @ m.a_WB_B, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(rates[2], w, atol=1e-15)
    np.testing.assert_allclose(rates[3], m.alpha_WB_B, rtol=1e-12)
    assert float(np.linalg.norm(m.v_WB_B)) == pytest.approx(values[1] * 0.3048, rel=1e-12)
    assert float(jnp.arctan2(m.v_WB_B[2], m.v_WB_B[0])) == pytest.approx(values[2], rel=1e-12)


def test_disturbance_enters_the_right_equations():
    """The moment joins M, in the flexible rows too; forces join m V' and m V gamma'."""
    x, u = _at_trim()
    push = Disturbance(moment=2e5, along=30.0, normal=600.0, start=2.0, duration=1.0)
    craft = Hypersonic(disturbance=push)
    quiet, pushed = (_row(craft.dynamics(t, x, u)) for t in (1.9, 2.0))
    change = dict(zip(NAMES, pushed - quiet, strict=True))
    assert change.pop("V") == pytest.approx(30 / 300)
    assert change.pop("alpha") == pytest.approx(-600 / 300 / V)
    turn = 2e5 / 627105.5208
    assert change.pop("q") == pytest.approx(turn)
    assert change.pop("eta1_rate") == pytest.approx(-136.82 * turn)
    assert change.pop("eta2_rate") == pytest.approx(-329.22 * turn)
    assert not any(change.values())
    np.testing.assert_array_equal(_row(craft.dynamics(3.0, x, u)), quiet)


@pytest.mark.parametrize("h", [0.005, 0.001, 0.0125])
def test_integrated_disturbance_impulse_is_exact(h):
    """50 ms of 20 ft/s: what the four stages of a step see at its edges adds up."""
    push = Disturbance(normal=300 * 20 / 0.05, start=0.05, duration=0.05)
    total = 0.0
    for k in range(round(0.15 / h)):
        total = rk4(lambda t, y: push.activation(t) * push.normal / 300, k * h, total, h)
    assert float(total) == pytest.approx(20.0, rel=1e-12)


def test_parameters_can_vary_across_a_batch():
    """Plants of a campaign: every quantity carries an axis of its own."""
    craft = to_arrays(Hypersonic())
    x, u = _at_trim()
    masses = jnp.array([300.0, 306.0, 330.0])
    rates = jax.vmap(lambda m: replace(craft, m=m).dynamics(0.0, x, u).V)(masses)
    faster = replace(x, V=V * 1.1)
    net = float(craft.dynamics(0.0, faster, u).V)
    np.testing.assert_allclose(rates, 0.0, atol=1e-12)  # level: thrust equals drag at any mass
    rates = jax.vmap(lambda m: replace(craft, m=m).dynamics(0.0, faster, u).V)(masses)
    np.testing.assert_allclose(rates, net * 300 / np.asarray(masses), rtol=1e-12)
    assert RigidForces().dynamic_pressure(H, V) == pytest.approx(2000.0132, abs=1e-4)
