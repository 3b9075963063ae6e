"""Turn on the spot at 3 rad/s: brake first, then spin."""

from trimtab.laws.spin import SupervisedSpin
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import (
    Craft,
    Equipment,
    Fan,
    Links,
    Supervision,
    hovercraft_scenario,
    velocity_targets,
)
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState


def scenario(
    links: Links = "chain",
    navigation: Navigation = "errors",
    supervisor: Supervision = "none",
    bus: Bus = "none",
    craft: Craft = "thesis",
    fan: Fan = "reversible",
) -> Scenario[Hovercraft]:
    """Return the scenario of fig. 6.10 and table 6.4 in the thesis (Kulis 2006).

    The craft starts so slowly that the law spins immediately, without braking first.
    """
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    law = SupervisedSpin()
    initial = HovercraftState(yaw_rate=0.1)
    name, targets, floor = "hovercraft/spin", velocity_targets(yaw_rate=3.0, yaw_band=0.15), (-4, 4, -4, 4)
    return hovercraft_scenario(name, law, initial, 22, targets, equipment, floor=floor)
