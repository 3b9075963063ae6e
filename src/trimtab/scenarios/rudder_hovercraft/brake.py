"""Brake with one-way thrust: turn the nose against the velocity, then push until the craft rests."""

from trimtab.laws.turn_then_push import TurnThenPush
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.rudder_hovercraft._craft import Links, Navigation, shop_scenario
from trimtab.vehicles.hovercraft import HovercraftState


def scenario(navigation: Navigation = "noisy", links: Links = "msp") -> Scenario:
    """Return the scenario: the craft drives north at 1.2 m/s, and must come to rest. All values are our choice."""
    targets = (
        Target("truth.surge_velocity", 0.0, 0.15),
        Target("truth.sway_velocity", 0.0, 0.15),
        Target("truth.yaw_rate", 0.0, 0.3),
    )
    initial = HovercraftState(surge_velocity=1.2)
    return shop_scenario("rudder-hovercraft/brake", TurnThenPush(), initial, 20, targets, navigation, links)
