"""Drive to a place with one-way thrust and stay near it, with any heading."""

from trimtab.laws.turn_then_push import TurnThenPush
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.rudder_hovercraft._craft import Links, Navigation, shop_scenario
from trimtab.vehicles.hovercraft import HovercraftState


def scenario(navigation: Navigation = "noisy", links: Links = "msp") -> Scenario:
    """Return the scenario: from 2 m beside the place and at rest, to within 0.6 m of it. All values are our choice."""
    targets = (Target("truth.north", 0.0, 0.6), Target("truth.east", 0.0, 0.6))
    law = TurnThenPush(goal="place", speed=0.5)
    initial = HovercraftState(north=-2.0, east=1.5, heading=0.5)
    return shop_scenario("rudder-hovercraft/place", law, initial, 60, targets, navigation, links)
