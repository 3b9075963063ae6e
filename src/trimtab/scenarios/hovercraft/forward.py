"""From rest to a constant forward momentum of 2.8 kg m/s, which is 1.08 m/s."""

from trimtab.laws.velocity import ForwardMomentum
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import Links, Supervision, hovercraft_scenario, velocity_targets
from trimtab.vehicles.hovercraft import HovercraftState


def scenario(
    links: Links = "chain", navigation: Navigation = "errors", supervisor: Supervision = "none", bus: Bus = "none"
) -> Scenario:
    """[1] fig. 6.8, table 6.2."""
    law, initial = ForwardMomentum(k1=1.0, k2=4.0, reference=2.8), HovercraftState()
    name, targets, floor = "hovercraft/forward", velocity_targets(surge=2.8 / 2.6), (-2, 18, -4, 5)
    return hovercraft_scenario(name, law, initial, 15, targets, links, navigation, supervisor, bus, floor=floor)
