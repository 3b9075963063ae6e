"""What the hovercraft's scenarios share: the simulated autopilot of the source, section 6.1.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, Literal

from trimtab.actuators.allocation import ThrustVectorAllocation
from trimtab.actuators.drive import FanDrive
from trimtab.core.time import ms, seconds
from trimtab.links.bluetooth import bluetooth
from trimtab.links.delay_chain import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.scenarios.hovercraft._navigation import Floor, Navigation, equipment
from trimtab.sensors.navigation_errors import NavigationErrors
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

Links = Literal["chain", "measured"]
PAIRING = "free2move/linksys 2.9/22.0"
"""The radios that the source flew with."""


def flight(
    name: str,
    law: Any,
    x: HovercraftState,
    duration_s: float,
    targets: tuple[Target, ...],
    links: Links = "chain",
    navigation: Navigation = "errors",
    *,
    errors: NavigationErrors | None = None,
    floor: Floor = (-5, 5, -5, 5),
) -> Scenario:
    """A scenario around a law, on the source's vehicle, actuators, radio and navigation errors.

    Args:
        name: in the catalogue.
        law: what flies it.
        x: first state.
        duration_s: length (s).
        targets: where signals should go, for the metrics.
        links: "chain", the constant delays of [1, fig. 6.1], 36 ms down and 40 ms up; "measured", random latencies with
            the statistics of [1, table 5.1].
        navigation: what the vehicle finds its way with, see `_navigation`.
        errors: of "errors"; the source's when None.
        floor: north from, to, east from, to (m), over which the ultrasonic beacons of the others hang.
    """
    if links == "chain":
        downlink, uplink = DelayChain(period=ms(6), steps=6), DelayChain(period=ms(20), steps=2)
    else:
        downlink, uplink = bluetooth(PAIRING, "down"), bluetooth(PAIRING, "up")
    sensors, estimator = equipment(navigation, errors, floor)
    world = World(
        vehicle=Hovercraft(),
        sensors=sensors,
        downlink=downlink,
        uplink=uplink,
        actuators=FanDrive(),
    )
    autopilot = Autopilot(estimator=estimator, law=law, allocation=ThrustVectorAllocation())
    return Scenario(
        world=world, autopilot=autopilot, initial=x, duration=seconds(duration_s), targets=targets, name=name
    )


def towards(surge: float = 0.0, sway: float = 0.0, yaw_rate: float = 0.0, **bands: float) -> tuple[Target, ...]:
    """Targets of the three velocities; a band is 0.1 m/s or 0.32 rad/s where none is given."""
    return (
        Target("truth.surge_velocity", surge, bands.get("surge_band", 0.1)),
        Target("truth.sway_velocity", sway, bands.get("sway_band", 0.1)),
        Target("truth.yaw_rate", yaw_rate, bands.get("yaw_band", 0.32)),
    )
