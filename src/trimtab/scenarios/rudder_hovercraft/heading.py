"""Turn to a heading with one-way thrust and hold it: the craft drives along it at constant speed."""

from trimtab.core.rotation import DEG
from trimtab.laws.turn_then_push import TurnThenPush
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.rudder_hovercraft._craft import Links, Navigation, shop_scenario
from trimtab.vehicles.hovercraft import HovercraftState


def scenario(navigation: Navigation = "noisy", links: Links = "msp") -> Scenario:
    """Return the scenario: from rest to 90 degrees and 0.6 m/s. A heading cannot be held at rest. All values are our
    choice."""
    targets = (
        Target("truth.heading", 90 * DEG, 8 * DEG),
        Target("truth.surge_velocity", 0.6, 0.1),
        Target("truth.sway_velocity", 0.0, 0.1),
    )
    law = TurnThenPush(speed=0.6, course=90 * DEG)
    return shop_scenario("rudder-hovercraft/heading", law, HovercraftState(), 20, targets, navigation, links)
