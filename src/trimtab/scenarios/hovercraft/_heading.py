"""What the two heading scenarios share: [1] figs. 6.11 (moving) and 6.12 (rest)."""

from typing import Any, Literal

import numpy as np

from trimtab.core.record import replace
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import Links, Supervised, flight, towards
from trimtab.sensors.navigation_errors import NavigationErrors
from trimtab.vehicles.hovercraft import HovercraftState

Initial = Literal["moving", "rest"]
TOLERANCE = np.pi / 180


def heading_flight(
    name: str, law: Any, initial: Initial, links: Links, navigation: Navigation, supervisor: Supervised, bus: Bus
) -> Scenario:
    """Turn to 5 rad out of a spinning slide, or to 1 rad from rest.

    The source does not give the first state of its fig. 6.11: it is reconstructed (docs page, Errata). As in the
    source, the error of that flight is the plain difference to a heading that the navigation gives in [0, 2 pi), so
    that the vehicle goes up to 5 rad and not the short way down.
    """
    if initial == "rest":
        x, target, errors = HovercraftState(), 1.0, None
    else:
        x, target = HovercraftState(surge_velocity=0.4, sway_velocity=1.2, yaw_rate=4.1), 5.0
        law, errors = replace(law, wrapping="none"), NavigationErrors(heading_range="positive")
    law = replace(law, target=target)
    targets = (*towards(), Target("truth.heading", target, 5 * TOLERANCE))
    return flight(name, law, x, 35, targets, links, navigation, supervisor, bus, errors=errors, floor=(-6, 6, -5, 9))
