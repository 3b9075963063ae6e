"""Turn to a heading at a constant rate, then damp the motion (bang-bang control)."""

from trimtab.laws.heading import HeadingBangBang
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import Craft, Equipment, Fan, Initial, Links, Supervision, heading_scenario
from trimtab.vehicles.hovercraft import Hovercraft


def scenario(
    initial: Initial = "rest",
    links: Links = "chain",
    navigation: Navigation = "errors",
    supervisor: Supervision = "none",
    bus: Bus = "none",
    craft: Craft = "thesis",
    fan: Fan = "reversible",
) -> Scenario[Hovercraft]:
    """Return the scenario of figs. 6.11 and 6.12 in the thesis (Kulis 2006): turn rate 1.5 rad/s, tolerance 1 deg."""
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    return heading_scenario("hovercraft/heading-bang-bang", HeadingBangBang(turn_rate=1.5), initial, equipment)
