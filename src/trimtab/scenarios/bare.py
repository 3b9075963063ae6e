"""A scenario with nothing in it but wires: what a scenario file begins with that names no base."""

from typing import Any

from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World


def scenario() -> Scenario:
    """No vehicle, no sensor, no law: settings put them there, and `scenarios.build` refuses what lacks one."""
    nothing: Any = None
    return Scenario(
        world=World(vehicle=nothing, sensors={}, actuators=nothing, downlink=Wire(), uplink=Wire()),
        autopilot=Autopilot(estimator=nothing, law=nothing, allocation=nothing),
        initial=nothing,
        name="bare",
    )
