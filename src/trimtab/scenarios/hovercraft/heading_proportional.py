"""Turn to a heading at a rate proportional to the heading error, then damp the motion."""

from trimtab.laws.heading import HeadingProportional
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
    """Return the scenario of figs. 6.11 and 6.12 in the thesis (Kulis 2006): gain 1.0 1/s, tolerance 1 deg.

    `--set autopilot.law.form=literal` selects the law exactly as published.
    """
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    return heading_scenario("hovercraft/heading-proportional", HeadingProportional(k=1.0), initial, equipment)
