"""Empty scenario that contains ideal links only. It is the base of a scenario file that names no base."""

from typing import Any

from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World


def scenario() -> Scenario:
    """Return a scenario without vehicle, sensor or law. Settings must add them; `scenarios.build` checks this."""
    nothing: Any = None
    return Scenario(
        world=World(vehicle=nothing, sensors={}, actuators=nothing, downlink=Wire(), uplink=Wire()),
        autopilot=Autopilot(estimator=nothing, law=nothing, allocation=nothing),
        initial=nothing,
        name="bare",
    )
