"""Tests of the law, alone and in a flight: pytest test_my_law.py"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import build, replace, simulate
from trimtab.core.signals import Estimate, PlanarState

FLOWN = build(f"{Path(__file__).with_name('my_law.py')}:scenario")
LAW = FLOWN.autopilot.law


def step(heading: float, yaw_rate: float = 0.0) -> Any:
    """Return the demand of the law for a heading (rad) and a yaw rate (rad/s)."""
    x = PlanarState(surge_velocity=0.5, sway_velocity=0.0, yaw_rate=yaw_rate, heading=heading)
    return LAW.step(0, LAW.init(None), Estimate(t=0, age=0.0, fresh=True, valid=True, state=x))[1]


def test_rudder_is_zero_on_course():
    """At the desired heading, without a rate of turn, the rudder is at zero."""
    assert float(step(LAW.heading).demand.rudder) == 0.0


def test_turns_the_shorter_way():
    """An error to starboard gives a positive rudder, which turns the bow to port. A full turn is not an error."""
    assert float(step(LAW.heading + 0.1).demand.rudder) > 0
    np.testing.assert_allclose(float(step(LAW.heading + 0.1 + 2 * np.pi).off_course), 0.1, atol=1e-9)
    np.testing.assert_allclose(float(step(LAW.heading + np.pi + 0.1).off_course), 0.1 - np.pi, atol=1e-9)


def test_limits_the_rudder_angle():
    """The rudder angle stays within the limit `most` in both directions."""
    assert float(step(LAW.heading + 3.0, yaw_rate=5.0).demand.rudder) == LAW.most


def test_reaches_the_heading():
    """A flight, compiled to C, ends within 0.1 rad of the desired heading. With zero gains it does not."""
    log = simulate(FLOWN)
    assert abs(log.final["truth.heading"] - LAW.heading) < 0.1
    idle = replace(FLOWN, autopilot=replace(FLOWN.autopilot, law=replace(LAW, k_heading=0.0, k_rate=0.0)))
    assert abs(simulate(idle).final["truth.heading"] - LAW.heading) > 0.5
