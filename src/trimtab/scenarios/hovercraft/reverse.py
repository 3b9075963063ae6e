"""Accelerate backwards to a constant momentum of -1.98 kg m/s, which is 0.76 m/s."""

from trimtab.laws.velocity import ReverseMomentum
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
    """Return the scenario of fig. 6.9 and table 6.3 in the thesis (Kulis 2006)."""
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    mass = float(choose_craft(craft).mass)
    law = ReverseMomentum(k1=1.5, k2=1.0, theta=1.44, reference=-1.98 / 2.6 * mass)
    initial = HovercraftState(sway_velocity=-0.1, yaw_rate=0.1)
    name, targets, floor = "hovercraft/reverse", velocity_targets(surge=-1.98 / 2.6), (-13, 2, -6, 3)
    return hovercraft_scenario(name, law, initial, 15, targets, equipment, floor=floor)
