"""The heading autopilot on a ship model, and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.rotation import wrap
from trimtab.laws.steering import Steering

DT = 0.02


def turn_ship(steering, asked, seconds, *, speed=0.58, heading=0.0, gain=0.5, lag=2.0, bias=0.0, read=lambda psi: psi):
    """Return headings, yaw rates and rudders of a ship T r' + r = -K (U/U0)² (rudder + bias), a row per step."""

    @jax.jit
    def step(state, psi, r):
        state, rudder = steering.steer(state, jnp.asarray(asked), read(psi), r, jnp.asarray(speed), DT)
        torque = -gain * (speed / steering.speed) ** 2 * (rudder + bias)
        return state, psi + DT * r, r + DT * (torque - r) / lag, rudder

    state, psi, r, rows = steering.init(), jnp.asarray(heading), jnp.asarray(0.0), []
    for _ in range(round(seconds / DT)):
        state, psi, r, rudder = step(state, psi, r)
        rows.append((float(psi), float(r), float(rudder), float(state.heading), float(state.yaw_rate)))
    return np.array(rows)


@pytest.mark.thorough
def test_turns_to_the_heading_the_shorter_way():
    rows = turn_ship(Steering(), asked=3.0, heading=-3.0, seconds=60)
    assert np.all(np.diff(rows[:150, 0]) <= 0), "from -3 down to 3 - 2 pi"
    assert rows[-1, 0] == pytest.approx(3.0 - 2 * np.pi, abs=0.02)


@pytest.mark.thorough
def test_compass_wrap_at_south_leaves_steering_unchanged():
    smooth = turn_ship(Steering(), asked=3.6, heading=2.8, seconds=30)
    jumping = turn_ship(Steering(), asked=3.6, heading=2.8, seconds=30, read=wrap)
    np.testing.assert_allclose(jumping[:, :3], smooth[:, :3], atol=1e-9)
    assert smooth[-1, 0] > np.pi


@pytest.mark.thorough
def test_integral_action_compensates_a_rudder_bias():
    rows = turn_ship(Steering(ki=0.1), asked=0.5, seconds=150, bias=0.1)
    assert rows[-1, 0] == pytest.approx(0.5, abs=1e-3)
    assert rows[-1, 2] == pytest.approx(-0.1, abs=2e-3)
    assert abs(turn_ship(Steering(ki=0.0), asked=0.5, seconds=150, bias=0.1)[-1, 0] - 0.5) > 0.05


def test_heading_reference_is_critically_damped_and_rate_limited():
    rows = turn_ship(Steering(fastest=0.1), asked=1.0, seconds=40)
    assert np.abs(rows[:, 4]).max() == pytest.approx(0.1)
    assert rows[:, 3].max() <= 1.0 + 1e-6
    slow = Steering(frequency=0.5, fastest=10.0)
    t = DT * np.arange(1, 1001)
    exact = 1 - (1 + 0.5 * t) * np.exp(-0.5 * t)  # step answer of w²/(s + w)²
    np.testing.assert_allclose(turn_ship(slow, asked=1.0, seconds=20)[:, 3], exact, atol=DT)


def test_rudder_is_limited_and_integral_held_at_the_limit():
    steering = Steering(limit=0.05, ki=0.5)
    rows = turn_ship(steering, asked=2.0, seconds=20)
    assert np.abs(rows[:, 2]).max() == pytest.approx(0.05)
    state = steering.init()
    for _ in range(100):
        state, _ = steering.steer(state, 0.0, jnp.asarray(2.0), jnp.asarray(1.0), 0.58, DT)
    assert float(state.integral) == 0.0


def test_rudder_scales_with_inverse_square_of_limited_speed():
    steering = Steering(speed=1.0, slowest=0.5)

    def rudder(speed):
        state, _ = steering.steer(steering.init(), 0.0, jnp.asarray(0.0), jnp.asarray(0.0), speed, DT)
        return float(steering.steer(state, 0.0, jnp.asarray(0.05), jnp.asarray(0.0), speed, DT)[1])

    assert rudder(2.0) == pytest.approx(rudder(1.0) / 4)
    assert rudder(0.1) == pytest.approx(4 * rudder(1.0))
