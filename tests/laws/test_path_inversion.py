"""Fuel ratio and elevator for wanted accelerations: exact against the vehicle, and unreachable accelerations.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import math

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import to_arrays
from trimtab.laws.path_inversion import InputLimits, internal_rates, invert_path
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

CRAFT, DEG = to_arrays(Hypersonic()), math.pi / 180
GRID = np.meshgrid(
    np.linspace(80e3, 95e3, 7),
    np.linspace(7e3, 9e3, 5),
    np.linspace(0, 4, 9) * DEG,
    [-150.0, -20.0, 0.0, 60.0, 150.0],
    [-15.0, 0.0, 8.0],
    [-8.0, 0.0, 12.0],
    indexing="ij",
)


def achieved(h, h_rate, V, alpha, u, q=0.0):
    """Return (h'', V') of the vehicle itself."""
    theta = alpha + np.arcsin(h_rate / V)
    o = np.zeros(np.shape(h))
    rate = CRAFT.dynamics(0.0, HypersonicState(h, V, alpha, theta, q + o, o, o, o, o), u)
    gam, turn = theta - alpha, rate.theta - rate.alpha
    return rate.V * np.sin(gam) + V * turn * np.cos(gam), rate.V


def test_inversion_reproduces_the_wanted_accelerations():
    """[1] eqs. 4-8: |(h'', V') - v| below 1e-9 over the grid, climbing and sinking, for several v."""
    h, V, alpha, h_rate, v1, v2 = (np.ravel(a) for a in GRID)
    found = invert_path(CRAFT, h, h_rate, V, alpha, v1, v2)
    assert np.asarray(found.solvable).all()
    got = achieved(h, h_rate, V, alpha, found.u)
    assert np.abs(np.asarray(got) - [v1, v2]).max() < 1e-9


def test_elevator_matches_the_bisection_root_near_level_flight():
    """[1] eqs. 4-8: the root of R(delta) next to level flight's elevator, searched by bisection; never the far one."""
    air, m, g = CRAFT.forces.aerodynamics, float(CRAFT.m), float(CRAFT.g)
    draws = np.random.default_rng(5)
    for _ in range(40):
        h, V, alpha, h_rate = draws.uniform([80e3, 7e3, 0, -150], [95e3, 9e3, 4 * DEG, 150])
        v1, v2 = draws.uniform([-10, -5], [8, 10])
        sine = h_rate / V
        cosine = math.sqrt(1 - sine**2)
        qS = 6.7429e-5 * math.exp(-(h - 85000) / 21358) * V**2 / 2 * 17

        def R(delta, alpha=alpha, v1=v1, v2=v2, sine=sine, cosine=cosine, qS=qS):
            D = qS * (5.8224 * alpha**2 - 0.045315 * alpha + 0.81993 * delta**2 + 2.7699e-4 * delta + 0.010131)
            L = qS * (4.6773 * alpha + 0.76224 * delta - 0.018714)
            normal = (v1 - v2 * sine) / cosine + g * cosine
            return (m * (v2 + g * sine) + D) * math.tan(alpha) + L - m * normal

        got = invert_path(CRAFT, h, h_rate, V, alpha, v1, v2)
        np.testing.assert_allclose(got.u.delta_e, brentq(R, -3.0, 3.0, xtol=1e-14), atol=1e-10)
        assert abs(R(float(got.u.delta_e))) < 1e-8
    assert float(air.S) == 17.0


def test_inversion_is_accurate_near_zero_angle_of_attack():
    """Near alpha = 0 the quadratic becomes linear, without loss of digits."""
    alphas = np.array([0.0, 1e-16, 1e-12, 1e-8, 1e-5])
    o = np.zeros(5)
    found = invert_path(CRAFT, 85000.0 + o, o, 7700.0 + o, alphas, 1.0 + o, 0.5 + o)
    np.testing.assert_allclose(np.diff(found.u.delta_e), 0, atol=1e-4)
    got = achieved(85000.0 + o, o, 7700.0 + o, alphas, found.u)
    np.testing.assert_allclose(got, [1 + o, 0.5 + o], atol=1e-10)


def test_slope_is_the_derivative_of_the_normal_force():
    """[1] eqs. 4-8: R' = qbar S [(2 CD_d2 delta + CD_d) tan alpha + CL_d]."""
    found = invert_path(CRAFT, 85000.0, 30.0, 7700.0, 0.03, 1.0, 0.5)
    qS = 6.7429e-5 * 7700.0**2 / 2 * 17
    wanted = qS * ((2 * 0.81993 * float(found.u.delta_e) + 2.7699e-4) * math.tan(0.03) + 0.76224)
    np.testing.assert_allclose(found.slope, wanted, rtol=1e-12)


def test_unreachable_acceleration_is_flagged_and_stays_finite():
    """At a negative angle of attack the force has a maximum: the nearest elevator, at zero slope, is returned.

    A formula that replaced the root of a negative number by zero gave 9.5 rad here instead of 1.5 rad.
    """
    found = invert_path(CRAFT, 85000.0, 0.0, 7700.0, -0.3, 200.0, 0.0)
    assert not bool(found.solvable)
    assert float(found.slope) == 0.0
    assert np.isfinite([found.u.Phi, found.u.delta_e]).all()
    scan = np.linspace(-6, 6, 200001)
    air, qS = CRAFT.forces.aerodynamics, 6.7429e-5 * 7700.0**2 / 2 * 17
    force = air.drag(qS / 17, -0.3, scan) * math.tan(-0.3) + air.lift(qS / 17, -0.3, scan)
    np.testing.assert_allclose(scan[np.argmax(force)], found.u.delta_e, atol=1e-4)


def test_climb_rate_above_speed_is_flagged_and_stays_finite():
    got = invert_path(CRAFT, 85000.0, 9000.0, 7700.0, 0.03, 0.0, 0.0)
    assert np.isfinite([got.u.Phi, got.u.delta_e]).all()
    assert not bool(got.solvable)


def test_inputs_are_clipped_to_limits_and_flagged():
    """[1] eqs. 4-8: Phi within 0.02 and 1.5, elevator within -20 and 25.8 deg."""
    limits = InputLimits()
    inside, moved = limits.clip(HypersonicInput(0.5, 0.1))
    assert (float(inside.Phi), float(inside.delta_e), bool(moved)) == (0.5, 0.1, False)
    u, moved = limits.clip(HypersonicInput(np.array([0.0, 2.0, 0.3, 0.3]), np.array([0.0, 0.0, -1.0, 1.0])))
    np.testing.assert_allclose(u.Phi, [0.02, 1.5, 0.3, 0.3])
    np.testing.assert_allclose(u.delta_e, np.array([0.0, 0.0, -20.0, 25.8]) * DEG)
    assert np.asarray(moved).all()


@pytest.mark.thorough
def test_internal_rates_match_the_vehicle_dynamics():
    """[1] eqs. 4-8: Psi is the rows of alpha, Q and the modes of the vehicle itself."""
    draws = np.random.default_rng(2)
    h, h_rate, V = draws.uniform([80e3, -100, 7e3], [95e3, 100, 9e3], (50, 3)).T
    v1, v2 = draws.uniform(-5, 8, (2, 50))
    zeta = draws.uniform([0, -0.1, 0, -5, 0, -5], [0.07, 0.1, 2, 5, 2, 5], (50, 6)).T
    u = invert_path(CRAFT, h, h_rate, V, zeta[0], v1, v2).u
    x = HypersonicState(h, V, zeta[0], zeta[0] + np.arcsin(h_rate / V), *zeta[1:])
    rate = CRAFT.dynamics(0.0, x, u)
    wanted = [rate.alpha, rate.q, rate.eta1, rate.eta1_rate, rate.eta2, rate.eta2_rate]
    got = internal_rates(CRAFT, h, h_rate, V, v1, v2, zeta)
    np.testing.assert_allclose(np.asarray(got), np.asarray(wanted), rtol=1e-10, atol=1e-11)


@pytest.mark.thorough
def test_inversion_is_differentiable_at_the_trim():
    """[1] eqs. 4-8: du/dv is the inverse of dv/du = [0.685649, 86.387771; 24.596085, -40.341697]."""

    def input_for(v):
        u = invert_path(CRAFT, 85000.0, 0.0, 7702.0808, 0.02786913, v[0], v[1]).u
        return jax.numpy.stack([u.Phi, u.delta_e])

    slope = jax.jacfwd(input_for)(np.zeros(2))
    np.testing.assert_allclose(np.linalg.inv(slope), [[0.685649, 86.387771], [24.596085, -40.341697]], rtol=3e-6)


@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_inversion_matches_jax():
    arguments = [np.float64(a) for a in (86e3, 40.0, 7800.0, 0.025, 1.0, 2.0)]
    wanted = invert_path(CRAFT, *arguments)
    got = compile(lambda craft, *a: tuple(invert_path(craft, *a)), CRAFT, *arguments)(CRAFT, *arguments)
    np.testing.assert_allclose(jax.tree.leaves(got), jax.tree.leaves(tuple(wanted)), rtol=1e-12)
