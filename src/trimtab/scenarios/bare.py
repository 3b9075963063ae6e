"""Empty scenario that contains only ideal radio links. It is the base of a scenario file that names no base."""

from typing import Any

from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World


def scenario() -> Scenario:
    """Return a scenario without vehicle, sensors and autopilot. Settings must add these parts (see
    `scenarios.build`)."""
    nothing: Any = None
    return Scenario(
        world=World(vehicle=nothing, sensors={}, actuators=nothing, downlink=Wire(), uplink=Wire()),
        autopilot=Autopilot(estimator=nothing, law=nothing, allocation=nothing),
        initial=nothing,
        name="bare",
    )
