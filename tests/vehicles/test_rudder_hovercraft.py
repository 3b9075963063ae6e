"""The hovercraft with a one-way propeller and rudders: forces, turns, and what one-way thrust cannot do."""

import jax
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.vehicles.hovercraft import Friction, HovercraftState
from trimtab.vehicles.rudder_hovercraft import RudderHovercraft, RudderThrottle

CRAFT = RudderHovercraft()


def test_straight_thrust_follows_the_curve() -> None:
    f = CRAFT.force(RudderThrottle(throttle=0.5, rudder=0.0))
    np.testing.assert_allclose([f.FX, f.FY], [0.3 * 0.5 + 1.3 * 0.25, 0.0], rtol=1e-12)


def test_rudders_turn_the_stream_by_their_deflection() -> None:
    f = CRAFT.force(RudderThrottle(throttle=1.0, rudder=0.5))
    np.testing.assert_allclose([f.FX, f.FY], [1.6 * np.cos(0.35), -1.6 * np.sin(0.35)], rtol=1e-12)


def test_positive_rudder_turns_the_nose_to_starboard() -> None:
    d = CRAFT.dynamics(0.0, to_arrays(HovercraftState()), RudderThrottle(throttle=1.0, rudder=0.5))
    assert float(d.yaw_rate) == pytest.approx(0.2 * 1.6 * np.sin(0.35) / 0.012, rel=1e-12)


def test_throttle_below_zero_gives_no_reverse_thrust() -> None:
    beyond, ends = ([CRAFT.thrust(c) for c in pair] for pair in ((-1.0, 2.0), (0.0, 1.0)))
    np.testing.assert_array_equal(beyond, ends)


def test_propeller_offset_to_starboard_turns_to_port() -> None:
    craft = replace(CRAFT, offset=0.01)
    d = craft.dynamics(0.0, to_arrays(HovercraftState()), RudderThrottle(throttle=1.0, rudder=0.0))
    assert float(d.yaw_rate) == pytest.approx(-0.01 * 1.6 / 0.012, rel=1e-12)


def test_rudders_without_thrust_have_no_effect() -> None:
    d = CRAFT.dynamics(0.0, to_arrays(HovercraftState()), RudderThrottle(throttle=0.0, rudder=0.6))
    assert float(d.yaw_rate) == float(d.sway_velocity) == 0.0


def test_friction_dissipates_energy() -> None:
    rest = RudderThrottle(throttle=0.0, rudder=0.0)
    for seed in range(20):
        s, w, r = np.random.default_rng(seed).uniform(-2, 2, 3)
        x = to_arrays(HovercraftState(surge_velocity=s, sway_velocity=w, yaw_rate=r))
        d = CRAFT.dynamics(0.0, x, rest)
        assert CRAFT.mass * (s * d.surge_velocity + w * d.sway_velocity) + CRAFT.inertia * r * d.yaw_rate < 0


def test_a_turn_from_rest_pushes_the_craft_at_least_by_its_impulse() -> None:
    """Without friction: the push along the nose is at least J r/(arm tan psi_max) for a yaw rate r."""
    craft = to_arrays(replace(CRAFT, friction=Friction()))
    u, x, dt = RudderThrottle(throttle=0.3, rudder=0.6), to_arrays(HovercraftState()), 0.01
    forces = []

    @jax.jit
    def advance(x):
        return rk4(lambda t, y: craft.dynamics(t, y, u), 0.0, x, dt)

    for _ in range(50):
        forces.append(float(craft.force(u).FX))
        x = advance(x)
    impulse = sum(forces) * dt
    assert impulse == pytest.approx(CRAFT.inertia * float(x.yaw_rate) / (CRAFT.arm * np.tan(0.7 * 0.6)), rel=1e-9)
