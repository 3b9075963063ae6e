"""Tests of the vehicle with several parameter values, and in a flight: pytest test_my_vehicle.py"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import build, replace, simulate
from trimtab.core.record import leaves

FLOWN = build(f"{Path(__file__).with_name('my_vehicle.py')}:scenario")
BIKE, REST = FLOWN.world.vehicle, FLOWN.world.actuators.neutral_input
UPRIGHT = replace(FLOWN.initial, heading=0.0)


def rates(x: Any, u: Any) -> Any:
    """Return the derivative of the state as an array, in the order of the state's fields."""
    return np.array([float(value) for _, value, _ in leaves(BIKE.dynamics(0.0, x, u))])


def test_upright_is_an_equilibrium():
    """All derivatives are zero for an upright bicycle with a straight handlebar."""
    assert not rates(UPRIGHT, REST).any()


def test_falls_to_the_side_of_the_lean():
    """The lean accelerates by g/h per radian (1/s^2), like an inverted pendulum."""
    fall = rates(replace(UPRIGHT, lean=1e-3), REST)[1]
    np.testing.assert_allclose(fall, 9.80665 / BIKE.height * 1e-3, rtol=1e-6)


def test_curve_balances_the_lean():
    """The lean stays constant if the centripetal acceleration v^2 tan(steer)/base is g tan(lean)."""
    lean = 0.2
    steer = np.arctan(9.80665 * np.tan(lean) * BIKE.base / BIKE.speed**2)
    _, fall, turn = rates(replace(UPRIGHT, lean=lean), replace(REST, steer=steer))
    assert abs(fall) < 1e-12
    assert turn > 0


def test_left_and_right_are_symmetric():
    """For a state mirrored to the other side, all derivatives change their sign."""
    one = rates(replace(UPRIGHT, lean=0.3, lean_rate=0.1), replace(REST, steer=0.2))
    other = rates(replace(UPRIGHT, lean=-0.3, lean_rate=-0.1), replace(REST, steer=-0.2))
    np.testing.assert_allclose(one, -other, rtol=1e-12)


def test_reaches_its_course_upright():
    """A flight, compiled to C, ends on course and upright. The bicycle must first steer to the wrong side."""
    log = simulate(FLOWN)
    assert abs(log.final["truth.heading"]) < 0.05
    assert abs(log.final["truth.lean"]) < 0.02
    assert log["truth.heading"].min() < FLOWN.initial.heading
