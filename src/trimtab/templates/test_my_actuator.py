"""Tests of the actuator, alone and in a flight: pytest test_my_actuator.py"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import build, replace, simulate

FLOWN = build(f"{Path(__file__).with_name('my_actuator.py')}:scenario")
(MOTOR,) = FLOWN.world.actuators.stages["force"]


def hold(command: float, seconds: float, motor: Any = MOTOR, dt: float = 0.01) -> tuple[float, bool]:
    """Return the position after a command was held for some seconds, and True if it was at a stop."""
    state, out = motor.step(motor.init(0.0), command, dt)
    for _ in range(round(seconds / dt) - 1):
        state, out = motor.step(state, command, dt)
    return float(out.value), bool(out.limited)


def test_friction_blocks_small_commands():
    """A command below the friction has no effect. A larger command is reduced by the friction."""
    assert hold(MOTOR.friction, 1.0) == (0.0, False)
    assert abs(hold(2.0, 1.0)[0] - (2.0 - MOTOR.friction)) < 1e-9
    assert abs(hold(2.0, 1.0, replace(MOTOR, friction=0.0))[0] - 2.0) < 1e-9


def test_lag_does_not_depend_on_the_step():
    """The response to a constant command is 1 - exp(-t/T), in steps of 10 ms and of 1 ms."""
    wanted = (2.0 - MOTOR.friction) * (1 - np.exp(-0.03 / MOTOR.time_constant))
    np.testing.assert_allclose([hold(2.0, 0.03)[0], hold(2.0, 0.03, dt=1e-3)[0]], wanted, rtol=1e-9)


def test_stops_limit_the_position():
    """The output `limited` is True at a stop."""
    for command, stop in ((1e3, MOTOR.high), (-1e3, MOTOR.low)):
        stands, limited = hold(command, 2.0)
        assert abs(stands - stop) < 1e-9
        assert limited


def test_swings_the_pole_up():
    """A flight, compiled to C, ends within 0.1 rad of upright. With a motor that is too weak it does not."""
    assert abs(simulate(FLOWN)["law.lean"][-1]) < 0.1
    weak = replace(FLOWN.world.actuators, stages={"force": replace(MOTOR, low=-0.4, high=0.4)})
    log = simulate(replace(FLOWN, world=replace(FLOWN.world, actuators=weak)))
    assert abs(log["law.lean"][-1]) > 0.5
