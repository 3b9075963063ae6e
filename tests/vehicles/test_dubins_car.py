"""Dubins' car: circles, the turn-rate limit, and the motion."""

import jax
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.vehicles.dubins_car import CarTurn, DubinsCar, DubinsCarState

CAR = DubinsCar(speed=1.3, radius=0.8)
MOST = 1.3 / 0.8


def drive(x, turn_rate, seconds, n=400):
    step = jax.jit(lambda x: rk4(lambda t, y: CAR.dynamics(t, y, CarTurn(turn_rate)), 0.0, x, seconds / n))
    x = jax.tree.map(np.float64, x)
    for _ in range(n):
        x = step(x)
    return x


@pytest.mark.parametrize("turn_rate", [0.4, -0.9, MOST])
def test_constant_turn_rate_gives_a_circle(turn_rate):
    """Half a turn: across by the diameter, to the right for a positive rate; a whole one: back."""
    start = DubinsCarState(2.0, -1.0, 0.7)
    half = drive(start, turn_rate, np.pi / abs(turn_rate))
    right = 2 * CAR.speed / turn_rate * np.array([-np.sin(0.7), np.cos(0.7)])
    assert [half.north - 2.0, half.east + 1.0] == pytest.approx(right, abs=1e-8)
    back = drive(half, turn_rate, np.pi / abs(turn_rate))
    assert [back.north, back.east] == pytest.approx([2.0, -1.0], abs=1e-8)
    assert float(back.heading) == pytest.approx(0.7 + np.sign(turn_rate) * 2 * np.pi)


def test_zero_turn_rate_gives_a_straight_line():
    end = drive(DubinsCarState(0.0, 0.0, 2.0), 0.0, 3.0)
    assert [end.north, end.east, end.heading] == pytest.approx([3.9 * np.cos(2.0), 3.9 * np.sin(2.0), 2.0])


@pytest.mark.parametrize("told", [-9.0, -1.7, 1.7, 9.0])
def test_turn_rate_is_limited_by_minimum_radius(told):
    rate = CAR.dynamics(0.0, DubinsCarState(), CarTurn(told))
    assert float(rate.heading) == pytest.approx(np.sign(told) * MOST)


@pytest.mark.parametrize("turn_rate", [-0.6, 0.0, 5.0])
def test_motion_is_the_derivative_of_the_position(turn_rate):
    x, u, h = DubinsCarState(1.0, 2.0, 2.4), CarTurn(turn_rate), 1e-4
    m = CAR.motion(0, x, u)
    R = np.array([[np.cos(2.4), -np.sin(2.4)], [np.sin(2.4), np.cos(2.4)]])
    before, after = drive(x, turn_rate, -h, 1), drive(x, turn_rate, h, 1)
    velocity = np.array([after.north - before.north, after.east - before.east]) / (2 * h)
    acceleration = np.array([after.north + before.north - 2.0, after.east + before.east - 4.0]) / h**2
    assert R @ np.asarray(m.v_WB_B[:2]) == pytest.approx(velocity, abs=1e-6)
    assert R @ np.asarray(m.a_WB_B[:2]) == pytest.approx(acceleration, abs=1e-5)
    assert float(m.w_WB_B[2]) == pytest.approx(float(after.heading - before.heading) / (2 * h))
    assert [float(v) for v in m.p_WB] == [1.0, 2.0, 0.0]
    assert [float(v) for v in m.attitude] == [0.0, 0.0, 2.4]
