"""Bring a spinning, sliding hovercraft to rest. A good first scenario to try."""

from trimtab.laws.velocity import ZeroVelocity
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
    """Return the scenario of fig. 6.7 and table 6.1 in the thesis (Kulis 2006)."""
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    law = ZeroVelocity(k1=1.0, k2=2.5)
    initial = HovercraftState(surge_velocity=0.2, sway_velocity=-0.7, yaw_rate=6.4)
    name, targets, floor = "hovercraft/zero-velocity", velocity_targets(), (-4, 4, -6, 3)
    return hovercraft_scenario(name, law, initial, 15, targets, equipment, floor=floor)
