"""Common parts of the hovercraft's scenarios: the simulated autopilot of section 6.1 of the thesis.

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
        "none": "no radio link: the autopilot is on board the vehicle",
    },
]
Craft = Annotated[
    Literal["thesis", "lighter"],
    {
        "thesis": "the craft of the thesis, 2.6 kg",
        "lighter": "craft with half a pound less electronics: 2.37 kg, same radius of gyration",
    },
]
Fan = Annotated[
    Literal["reversible", "variable-pitch"],
    {
        "reversible": "fan of the thesis: less than half the thrust in reverse, 150 ms of braking after reverse",
        "variable-pitch": "variable-pitch fan: equal thrust forward and in reverse, no braking",
    },
]
Supervision = Literal["none", "automatic"]
Initial = Literal["rest", "moving"]
"""Initial state of the heading scenarios. rest: [1] fig. 6.12, where the heading error is wrapped to the shortest turn.

moving: [1] fig. 6.11, where the heading error is not wrapped.
"""
MARGIN = 5.0
"""Distance (m) that a supervised hovercraft may move beyond its floor."""
PAIRING = "free2move/linksys 2.9/22.0"
"""Pair of Bluetooth radios used in the thesis's flights."""
POUND = 0.45359237
LIGHTER = 1 - 0.5 * POUND / float(Hovercraft().mass)
"""Mass of the lighter craft, and likewise its inertia, relative to the craft of the thesis.

[1] chapter 7 expects to save half a pound of electronics. The position of this mass is not given. We assume
that the radius of gyration does not change.
"""


class Equipment(NamedTuple):
    """Equipment that the user chooses for a scenario of the thesis.

    links: "chain", the constant delays of [1, fig. 6.1], 36 ms downlink and 40 ms uplink; "measured", random latencies
    with the statistics of [1, table 5.1]; "none", no link in the loop, as with processing on board [1, chapter 7].
    navigation: the navigation system, see `_navigation`.  supervisor: "automatic" flies as soon as all checks pass, and
    limits the speeds. If the navigation estimates the position, it also limits the area, to the floor and 5 m around
    the floor.
    bus: with "slave", a slow bus on the vehicle carries the ultrasonic samples to the radio.
    craft, fan: vehicle and thrust fan of the thesis, or those that its chapter 7 proposes.
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
    """Return a scenario with a law and the thesis's vehicle, actuators, radio and navigation errors.

    Args:
        name: name in the catalogue.
        law: the law. Its vehicle model is set to the chosen craft.
        x: initial state.
        duration_s: duration of the flight (s).
        targets: desired values of signals, for the metrics.
        equipment: the chosen equipment.
        errors: error model of navigation "errors". None: that of the thesis.
        floor: south, north, west and east limit of the floor (m). Beacons, if the navigation uses any, are above it.
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
    """Return the chosen vehicle."""
    own = Hovercraft()
    return own if craft == "thesis" else replace(own, mass=own.mass * LIGHTER, inertia=own.inertia * LIGHTER)


def _is_craft(own: Any) -> bool:
    return isinstance(own, Hovercraft)


def _choose_links(links: Links) -> tuple[Any, Any]:
    """Return downlink and uplink."""
    if links == "measured":
        return bluetooth_link(PAIRING, "down"), bluetooth_link(PAIRING, "up")
    return (
        (Wire(), Wire()) if links == "none" else (DelayChain(period=ms(6), steps=6), DelayChain(period=ms(20), steps=2))
    )


def _choose_fan(fan: Fan) -> tuple[FanDrive, ThrustVectorAllocation]:
    """Return drive and allocation. With a variable-pitch propeller, a negative speed means a negative pitch."""
    if fan == "reversible":
        return FanDrive(), ThrustVectorAllocation()
    even = replace(Thruster(), reverse_ratio=np.array([0.0, 0.0, 0.0, 1.0]))
    drive = FanDrive(controller=SpeedController(brake=0), thruster=even, table=thrust_table(even))
    return drive, ThrustVectorAllocation(thruster=even, table=full_speed_table(even))


def _flight_limits(navigation: Navigation, floor: Floor) -> tuple[Limit, ...]:
    """Return the supervisor's limits, our own choice. They are far beyond these flights, and safe in a hall."""
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
    """Return targets of surge, sway and yaw rate (m/s, rad/s). The target of sway is 0; surge and sway have bands of
    0.1 m/s."""
    return (
        Target("truth.surge_velocity", surge, 0.1),
        Target("truth.sway_velocity", 0.0, 0.1),
        Target("truth.yaw_rate", yaw_rate, yaw_band),
    )


def heading_scenario(name: str, law: Any, initial: Initial, equipment: Equipment) -> Scenario[Hovercraft]:
    """Return a scenario that turns to a heading: from rest to 1 rad, or from a spinning slide to 5 rad.

    The turn from rest takes the shortest way. The turn from a slide is that of the thesis's fig. 6.11. The thesis does
    not give its initial state, which is reconstructed (docs page, Errata). As in the thesis, the heading error of this
    flight is not wrapped, and the navigation gives a heading in [0, 2 pi). So the vehicle turns up to 5 rad, although
    the way down would be shorter. With all imperfections, it makes whole turns in this flight.
    """
    if initial == "rest":
        x, target, errors = HovercraftState(), 1.0, None
    else:
        x, target = HovercraftState(surge_velocity=0.4, sway_velocity=1.2, yaw_rate=4.1), 5.0
        law, errors = replace(law, wrapping="none"), NavigationErrors(heading_range="positive")
    law = replace(law, target=target)
    targets = (*velocity_targets(), Target("truth.heading", target, 5 * DEG))
    return hovercraft_scenario(name, law, x, 35, targets, equipment, errors=errors, floor=(-6, 6, -5, 9))
