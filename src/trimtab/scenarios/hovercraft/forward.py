"""Accelerate from rest to a constant forward momentum of 2.8 kg m/s, which is 1.08 m/s."""

from trimtab.laws.velocity import ForwardMomentum
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import (
    Craft,
    Equipment,
    Fan,
    Links,
    Supervision,
    choose_craft,
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
    """Return the scenario of fig. 6.8 and table 6.2 in the thesis (Kulis 2006)."""
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    mass = float(choose_craft(craft).mass)
    law, initial = ForwardMomentum(k1=1.0, k2=4.0, reference=2.8 / 2.6 * mass), HovercraftState()
    name, targets, floor = "hovercraft/forward", velocity_targets(surge=2.8 / 2.6), (-2, 18, -4, 5)
    return hovercraft_scenario(name, law, initial, 15, targets, equipment, floor=floor)
