"""Turn to a heading at a constant rate, and damp when there: bang-bang."""

from trimtab.laws.heading import HeadingBangBang
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import Initial, Links, Supervision, heading_scenario


def scenario(
    initial: Initial = "rest",
    links: Links = "chain",
    navigation: Navigation = "errors",
    supervisor: Supervision = "none",
    bus: Bus = "none",
) -> Scenario:
    """[1] figs. 6.11 and 6.12: |Om| = 1.5 rad/s, tolerance 1 deg."""
    return heading_scenario(
        "hovercraft/heading-bang-bang", HeadingBangBang(turn_rate=1.5), initial, links, navigation, supervisor, bus
    )
