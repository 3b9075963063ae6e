"""`rudder-hovercraft/…`: braking, holding a heading and holding a place with one-way thrust."""

import numpy as np
import pytest

from trimtab import Campaign
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

SPREAD = {
    "initial.surge_velocity": "uniform(-0.8,0.8)",
    "initial.yaw_rate": "uniform(-3,3)",
    "initial.heading": "uniform(-3.1,3.1)",
    "world.vehicle.mass": "normal(100%, 10%)",
    "world.vehicle.inertia": "normal(100%, 15%)",
    "world.vehicle.thrust_quadratic": "normal(100%, 15%)",
    "world.vehicle.offset": "normal(0,0.003)",
    "world.vehicle.deflection": "normal(100%, 10%)",
}
"""Errors of the law's model of the craft, and initial motion."""


def test_craft_brakes_by_turning_its_nose() -> None:
    log = simulate(build("rudder-hovercraft/brake"), seed=0)
    speed = np.hypot(log["truth.surge_velocity"], log["truth.sway_velocity"])
    assert speed[log.t >= 5.0].max() < 0.15
    assert log["actuators.u.throttle"].min() >= 0.0
    assert abs(log["truth.heading"]).max() > np.pi / 2


@pytest.mark.thorough
def test_craft_holds_its_heading_while_it_drives() -> None:
    log = simulate(build("rudder-hovercraft/heading"), seed=0)
    late = log.t >= 8.0
    assert abs(log["truth.heading"][late] - np.pi / 2).max() < np.radians(4)
    assert abs(log["truth.surge_velocity"][late] - 0.6).max() < 0.03


@pytest.mark.thorough
def test_craft_stays_at_its_place_from_any_heading() -> None:
    for heading in (0.0, 2.0, 4.0):
        log = simulate(build("rudder-hovercraft/place", {"initial.heading": str(heading)}), seed=0)
        distance = np.hypot(log["truth.north"], log["truth.east"])
        assert distance[log.t >= 30.0].max() < 0.6


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["brake", "heading", "place"])
def test_goal_is_reached_by_a_craft_that_differs_from_the_model(name: str) -> None:
    result = Campaign(f"rudder-hovercraft/{name}", runs=2000, spread=SPREAD).run()
    assert result.success.low > 0.995
