"""Parts that all hovercraft scenarios share: vehicle, actuators, radio and navigation of section 6.1 of the thesis.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Annotated, Any, Literal, NamedTuple

import jax
import numpy as np

from trimtab.actuators.allocation import ThrustVectorAllocation
from trimtab.actuators.drive import NEUTRAL_COMMAND, FanDrive, SpeedController, drive_failsafe
from trimtab.actuators.lookup import full_speed_table, thrust_table
from trimtab.actuators.thruster import Thruster
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.links.latency import bluetooth_link
from trimtab.links.wire import DelayChain, Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import Limit, Supervisor
from trimtab.loop.world import World
from trimtab.scenarios.hovercraft._navigation import Bus, Floor, Navigation, choose_navigation
from trimtab.sensors.navigation_errors import NavigationErrors
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

Links = Annotated[
    Literal["chain", "measured", "none"],
    {
        "chain": "constant delays, as in the thesis's simulation: 36 ms downlink, 40 ms uplink",
        "measured": "random latencies with the statistics of the thesis's Bluetooth measurements",
        "none": "no radio link, because the autopilot is on board the vehicle",
    },
]
Craft = Annotated[
    Literal["thesis", "lighter"],
    {
        "thesis": "the craft of the thesis, 2.6 kg",
        "lighter": "craft of 2.37 kg, with half a pound less electronics and the same radius of gyration",
    },
]
Fan = Annotated[
    Literal["reversible", "variable-pitch"],
    {
        "reversible": "fan of the thesis, with less than half the thrust in reverse, and 150 ms of braking after it",
        "variable-pitch": "variable-pitch fan, with equal thrust forward and in reverse, and no braking",
    },
]
Supervision = Literal["none", "automatic"]
Initial = Literal["rest", "moving"]
"""Initial state of the heading scenarios.

rest: as in [1] fig. 6.12. The heading error is wrapped, so that the craft turns the shortest way. moving: as in [1]
fig. 6.11. The heading error is not wrapped.
"""
MARGIN = 5.0
"""Distance (m) by which a supervised hovercraft may leave the floor area before the flight is ended."""
PAIRING = "free2move/linksys 2.9/22.0"
"""Pair of Bluetooth radios that was used in the flights of the thesis."""
POUND = 0.45359237
LIGHTER = 1 - 0.5 * POUND / float(Hovercraft().mass)
"""Mass of the lighter craft relative to that of the craft of the thesis. The inertia has the same ratio.

[1] chapter 7 expects that half a pound of electronics can be saved. The position of this mass is not stated in [1]. We
assume that the radius of gyration does not change.
"""


class Equipment(NamedTuple):
    """Equipment that the user chooses for a scenario of the hovercraft.

    links: radio links. "chain": constant delays of 36 ms (downlink) and 40 ms (uplink), as in [1, fig. 6.1].
    "measured": random latencies with the statistics of [1, table 5.1]. "none": autopilot on board [1, chapter 7].
    navigation: navigation system, see `_navigation`.
    supervisor: with "automatic", a supervisor arms as soon as all checks pass, and limits the speeds. If the navigation
    estimates the position, the supervisor also limits the area to the floor and 5 m around it.
    bus: with "slave", a slow bus on board carries the ultrasonic samples to the radio.
    craft, fan: vehicle and thrust fan of the thesis, or those proposed in [1, chapter 7].
    """

    links: Links
    navigation: Navigation
    supervisor: Supervision
    bus: Bus
    craft: Craft
    fan: Fan


def hovercraft_scenario(
    name: str,
    law: Any,
    x: HovercraftState,
    duration_s: float,
    targets: tuple[Target, ...],
    equipment: Equipment,
    *,
    errors: NavigationErrors | None = None,
    floor: Floor,
) -> Scenario[Hovercraft]:
    """Return a hovercraft scenario with a given law and the chosen equipment.

    Args:
        name: name of the scenario in the catalogue.
        law: control law. Its vehicle model is set to the chosen craft.
        x: initial state of the craft.
        duration_s: duration of the flight (s).
        targets: desired values of signals, for the metrics.
        equipment: equipment that the user chose.
        errors: error model of navigation "errors". None: the model of the thesis.
        floor: south, north, west and east limit of the floor area (m). The beacons of a navigation system with
            ultrasonic ranging are above this area.
    """
    downlink, uplink = _choose_links(equipment.links)
    sensors, estimator = choose_navigation(equipment.navigation, errors, floor, equipment.bus)
    supervision = None
    if equipment.supervisor == "automatic":
        limits = _flight_limits(equipment.navigation, floor)
        supervision = Supervisor(neutral=NEUTRAL_COMMAND, automatic=True, limits=limits)
    craft = choose_craft(equipment.craft)
    drive, allocation = _choose_fan(equipment.fan)
    if equipment.craft != "thesis":
        law = jax.tree.map(lambda own: craft if _is_craft(own) else own, law, is_leaf=_is_craft)
    return Scenario(
        world=World(vehicle=craft, sensors=sensors, downlink=downlink, uplink=uplink, actuators=drive),
        autopilot=Autopilot(estimator=estimator, law=law, allocation=allocation, supervisor=supervision),
        initial=x,
        duration=seconds(duration_s),
        targets=targets,
        failsafe=drive_failsafe(),
        name=name,
    )


def choose_craft(craft: Craft) -> Hovercraft:
    """Return the model of the chosen hovercraft."""
    own = Hovercraft()
    return own if craft == "thesis" else replace(own, mass=own.mass * LIGHTER, inertia=own.inertia * LIGHTER)


def _is_craft(own: Any) -> bool:
    return isinstance(own, Hovercraft)


def _choose_links(links: Links) -> tuple[Any, Any]:
    """Return the downlink and the uplink of the chosen type."""
    if links == "measured":
        return bluetooth_link(PAIRING, "down"), bluetooth_link(PAIRING, "up")
    return (
        (Wire(), Wire()) if links == "none" else (DelayChain(period=ms(6), steps=6), DelayChain(period=ms(20), steps=2))
    )


def _choose_fan(fan: Fan) -> tuple[FanDrive, ThrustVectorAllocation]:
    """Return the drive and the allocation of the chosen fan.

    For the variable-pitch fan, a negative speed means a negative pitch.
    """
    if fan == "reversible":
        return FanDrive(), ThrustVectorAllocation()
    even = replace(Thruster(), reverse_ratio=np.array([0.0, 0.0, 0.0, 1.0]))
    drive = FanDrive(controller=SpeedController(brake=0), thruster=even, table=thrust_table(even))
    return drive, ThrustVectorAllocation(thruster=even, table=full_speed_table(even))


def _flight_limits(navigation: Navigation, floor: Floor) -> tuple[Limit, ...]:
    """Return the supervisor's limits. They are our choice: never reached in a normal flight, and safe in a hall."""
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
    """Return the targets of surge velocity (m/s), sway velocity (0 m/s) and yaw rate (rad/s).

    The tolerance bands of surge and sway velocity are 0.1 m/s.
    """
    return (
        Target("truth.surge_velocity", surge, 0.1),
        Target("truth.sway_velocity", 0.0, 0.1),
        Target("truth.yaw_rate", yaw_rate, yaw_band),
    )


def heading_scenario(name: str, law: Any, initial: Initial, equipment: Equipment) -> Scenario[Hovercraft]:
    """Return a scenario in which the craft turns to a heading: from rest to 1 rad, or from a spinning slide to 5 rad.

    From rest, the craft turns the shortest way. The turn from a slide is that of fig. 6.11 of the thesis. Its initial
    state is not stated in the thesis, and was reconstructed (docs page, Errata). As in the thesis, the heading error of
    this flight is not wrapped, and the measured heading is in [0, 2 pi). Therefore the craft turns up to 5 rad,
    although the opposite direction would be shorter. With all imperfections, the craft makes full turns in this flight.
    """
    if initial == "rest":
        x, target, errors = HovercraftState(), 1.0, None
    else:
        x, target = HovercraftState(surge_velocity=0.4, sway_velocity=1.2, yaw_rate=4.1), 5.0
        law, errors = replace(law, wrapping="none"), NavigationErrors(heading_range="positive")
    law = replace(law, target=target)
    targets = (*velocity_targets(), Target("truth.heading", target, 5 * DEG))
    return hovercraft_scenario(name, law, x, 35, targets, equipment, errors=errors, floor=(-6, 6, -5, 9))
