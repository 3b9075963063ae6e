"""Cart and pole: Barto's equation, conserved quantities, small oscillations, and the motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.vehicles.cart_pole import CartForce, CartPole, CartPoleState

POLE = CartPole()
RNG = np.random.default_rng(4)
STATES = [CartPoleState(*RNG.normal(0, 2, 4)) for _ in range(20)]


@pytest.mark.parametrize("x", STATES[:6])
def test_accelerations_match_bartos_equations(x):
    """[1], appendix, its equations as printed, without friction."""
    F, m, M, l, g = 7.0, 0.1, 1.0, 0.5, 9.8
    s, c, w = np.sin(x.angle), np.cos(x.angle), x.angle_rate
    turn = (g * s + c * (-F - m * l * w**2 * s) / (M + m)) / (l * (4 / 3 - m * c**2 / (M + m)))
    push = (F + m * l * (w**2 * s - turn * c)) / (M + m)
    d = POLE.dynamics(0.0, x, CartForce(F))
    assert [d.speed, d.angle_rate] == pytest.approx([push, turn], rel=1e-12)
    assert [d.position, d.angle] == [x.speed, x.angle_rate]


@pytest.mark.parametrize("x", STATES[:6])
def test_force_inverts_the_dynamics(x):
    d = POLE.dynamics(0.0, x, CartForce(POLE.force(x, 2.5)))
    assert float(d.speed) == pytest.approx(2.5, rel=1e-12)


def total_energy(x, c=POLE):
    """Of cart and pole (J)."""
    ml = c.pole_mass * c.half_length
    moving = (c.cart_mass + c.pole_mass) / 2 * x.speed**2 + ml * x.speed * x.angle_rate * np.cos(x.angle)
    return moving + 2 / 3 * ml * c.half_length * x.angle_rate**2 + ml * c.gravity * np.cos(x.angle)


def fly(x, n, h=1e-3, force=0.0):
    step = jax.jit(lambda x: rk4(lambda t, y: POLE.dynamics(t, y, CartForce(force)), 0.0, x, h))
    x = jax.tree.map(jnp.asarray, x)
    for _ in range(n):
        x = step(x)
    return x


def test_energy_changes_only_by_the_work_done():
    start = CartPoleState(0.0, 0.3, 2.0, 1.0)
    assert total_energy(fly(start, 2000)) == pytest.approx(total_energy(start), abs=1e-10)
    end = fly(start, 500, force=3.0)
    assert total_energy(end) - total_energy(start) == pytest.approx(3.0 * float(end.position), abs=1e-9)


def test_hanging_pole_has_the_pendulum_period():
    """w^2 = (3 g/4 l)/(1 - 3/4 m/(M + m)) about hanging; a quarter of a period from rest."""
    w = np.sqrt(3 * 9.8 / (4 * 0.5) / (1 - 0.75 * 0.1 / 1.1))
    h = np.pi / (2 * w) / 1000
    end = fly(CartPoleState(0.0, 0.0, np.pi + 1e-4, 0.0), 1000, h)
    assert float(end.angle) - np.pi == pytest.approx(0.0, abs=1e-9)
    assert float(end.angle_rate) == pytest.approx(-1e-4 * w, rel=1e-5)
    still = POLE.dynamics(0.0, CartPoleState(0.0, 0.0, np.pi, 0.0), CartForce(0.0))
    assert [still.speed, still.angle_rate] == pytest.approx([0.0, 0.0], abs=1e-14)


@pytest.mark.parametrize("x", STATES[:3])
def test_pole_energy_rate_matches_hinge_acceleration(x):
    """E' = -m l a q' cos q, the basis of energy control."""
    a = 1.7
    rate = CartPoleState(x.speed, a, x.angle_rate, POLE.angle_acceleration(x, a))
    _, slope = jax.jvp(POLE.energy, (jax.tree.map(jnp.asarray, x),), (jax.tree.map(jnp.asarray, rate),))
    assert float(slope) == pytest.approx(-0.1 * 0.5 * a * x.angle_rate * np.cos(x.angle), rel=1e-12)


def test_motion_is_consistent_with_the_dynamics():
    x = STATES[3]
    m = POLE.motion(0, x, CartForce(4.0))
    q = -m.attitude[1]
    up = np.array([np.cos(q), 0.0, -np.sin(q)])  # the rail's direction in B
    d = POLE.dynamics(0.0, x, CartForce(4.0))
    assert m.v_WB_B == pytest.approx(x.speed * up)
    assert m.a_WB_B == pytest.approx(d.speed * up)
    assert m.alpha_WB_B[1] == -d.angle_rate
