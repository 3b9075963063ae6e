"""What the hovercraft's scenarios share: the simulated autopilot of the source, section 6.1.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, Literal

from trimtab.actuators.allocation import ThrustVectorAllocation
from trimtab.actuators.drive import NEUTRAL_COMMAND, FanDrive, drive_failsafe
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.links.latency import bluetooth_link
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import Limit, Supervisor
from trimtab.loop.world import World
from trimtab.scenarios.hovercraft._navigation import Bus, Floor, Navigation, choose_navigation
from trimtab.sensors.navigation_errors import NavigationErrors
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

Links = Literal["chain", "measured"]
Supervision = Literal["none", "automatic"]
Initial = Literal["rest", "moving"]
"""Of the heading scenarios: [1] fig. 6.12, by the shortest way; fig. 6.11, with its plain difference of headings."""
MARGIN = 5.0
"""How far beyond its floor (m) a supervised hovercraft may get."""
PAIRING = "free2move/linksys 2.9/22.0"
"""The radios that the source flew with."""


def hovercraft_scenario(
    name: str,
    law: Any,
    x: HovercraftState,
    duration_s: float,
    targets: tuple[Target, ...],
    links: Links,
    navigation: Navigation,
    supervisor: Supervision,
    bus: Bus,
    *,
    errors: NavigationErrors | None = None,
    floor: Floor,
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
        supervisor: "automatic" flies as soon as all checks pass, inside a speed envelope, and, where the position is
            known, over the floor and 5 m around it.
        bus: "slave" has the ultrasonic units' samples pass a slow bus on the vehicle, before the radio.
        errors: of "errors"; the source's when None.
        floor: north from, to, east from, to (m), over which the ultrasonic beacons of the others hang.
    """
    if links == "chain":
        downlink, uplink = DelayChain(period=ms(6), steps=6), DelayChain(period=ms(20), steps=2)
    else:
        downlink, uplink = bluetooth_link(PAIRING, "down"), bluetooth_link(PAIRING, "up")
    sensors, estimator = choose_navigation(navigation, errors, floor, bus)
    supervision = None
    if supervisor == "automatic":
        limits = _flight_limits(navigation, floor)
        supervision = Supervisor(neutral=NEUTRAL_COMMAND, automatic=True, limits=limits)
    return Scenario(
        world=World(vehicle=Hovercraft(), sensors=sensors, downlink=downlink, uplink=uplink, actuators=FanDrive()),
        autopilot=Autopilot(estimator=estimator, law=law, allocation=ThrustVectorAllocation(), supervisor=supervision),
        initial=x,
        duration=seconds(duration_s),
        targets=targets,
        failsafe=drive_failsafe(),
        name=name,
    )


def _flight_limits(navigation: Navigation, floor: Floor) -> tuple[Limit, ...]:
    """Reconstructed: far beyond what these flights need, well below what a hall stands."""
    speeds = (
        Limit(fields=("surge_velocity", "sway_velocity"), high=4.0, kind="envelope"),
        Limit(fields=("yaw_rate",), low=-12.0, high=12.0, kind="envelope"),
    )
    if navigation == "errors":
        return speeds
    south, north, west, east = floor
    fence = (("north", south, north), ("east", west, east))
    return speeds + tuple(Limit(fields=(f,), low=low - MARGIN, high=high + MARGIN) for f, low, high in fence)


def velocity_targets(surge: float = 0.0, yaw_rate: float = 0.0, yaw_band: float = 0.32) -> tuple[Target, ...]:
    """Targets of the three velocities (m/s, rad/s), sway at rest; the bands of the first two are 0.1 m/s."""
    return (
        Target("truth.surge_velocity", surge, 0.1),
        Target("truth.sway_velocity", 0.0, 0.1),
        Target("truth.yaw_rate", yaw_rate, yaw_band),
    )


def heading_scenario(
    name: str, law: Any, initial: Initial, links: Links, navigation: Navigation, supervisor: Supervision, bus: Bus
) -> Scenario:
    """Turn to 1 rad from rest by the shortest way, or, as in the source's fig. 6.11, to 5 rad out of a spinning slide.

    The source does not give the first state of its fig. 6.11: it is reconstructed (docs page, Errata). As in the
    source, the error of that flight is the plain difference to a heading that the navigation gives in [0, 2 pi), so
    that the vehicle goes up to 5 rad and not the short way down. With all faults it turns whole circles that way.
    """
    if initial == "rest":
        x, target, errors = HovercraftState(), 1.0, None
    else:
        x, target = HovercraftState(surge_velocity=0.4, sway_velocity=1.2, yaw_rate=4.1), 5.0
        law, errors = replace(law, wrapping="none"), NavigationErrors(heading_range="positive")
    law = replace(law, target=target)
    targets = (*velocity_targets(), Target("truth.heading", target, 5 * DEG))
    return hovercraft_scenario(
        name, law, x, 35, targets, links, navigation, supervisor, bus, errors=errors, floor=(-6, 6, -5, 9)
    )
