"""Common parts of the hovercraft's scenarios: the thesis's simulated autopilot, section 6.1.

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
        "chain": "the constant delays of the thesis's simulation, 36 ms down and 40 ms up",
        "measured": "random latencies with the statistics of the thesis's Bluetooth table",
        "none": "no radio link: the autopilot is on board",
    },
]
Craft = Annotated[
    Literal["thesis", "lighter"],
    {
        "thesis": "the thesis's craft, 2.6 kg",
        "lighter": "craft without half a pound of electronics: 2.37 kg, with an equal radius of gyration",
    },
]
Fan = Annotated[
    Literal["reversible", "variable-pitch"],
    {
        "reversible": "the thesis's fan: braked for 150 ms out of reverse, less than half the thrust in reverse",
        "variable-pitch": "variable-pitch fan: no brake, equal thrust in reverse and forward",
    },
]
Supervision = Literal["none", "automatic"]
Initial = Literal["rest", "moving"]
"""Targets of the heading scenarios: [1] fig. 6.12, by the shortest way; fig. 6.11, with a plain difference."""
MARGIN = 5.0
"""Distance (m) beyond its floor that a supervised hovercraft may reach."""
PAIRING = "free2move/linksys 2.9/22.0"
"""Radios that the thesis flew with."""
POUND = 0.45359237
LIGHTER = 1 - 0.5 * POUND / float(Hovercraft().mass)
"""Ratio of mass and inertia of the lighter craft: [1] chapter 7 expects to save half a pound of electronics.

Its position is not given; the mass is removed evenly, so that the radius of gyration stays (reconstructed).
"""


class Equipment(NamedTuple):
    """Choices of the thesis's scenarios; the defaults are the thesis's.

    links: "chain", the constant delays of [1, fig. 6.1], 36 ms down and 40 ms up; "measured", random latencies with the
    statistics of [1, table 5.1]; "none", no link in the loop, as with processing on board [1, chapter 7].
    navigation: the navigation system, see `_navigation`.  supervisor: "automatic" flies as soon as all
    checks pass, inside a speed envelope, and, where the position is known, over the floor and 5 m around it.
    bus: "slave" has the ultrasonic units' samples pass a slow bus on the vehicle, before the radio.
    craft, fan: vehicle and thrust fan, the thesis's or its chapter 7's.
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
    """Return a scenario around a law, with the thesis's vehicle, actuators, radio and navigation errors.

    Args:
        name: in the catalogue.
        law: the law; its model becomes that of the craft that flies.
        x: first state.
        duration_s: length (s).
        targets: where signals should go, for the metrics.
        equipment: what was chosen.
        errors: of navigation "errors"; the thesis's when None.
        floor: north from, to, east from, to (m), over which the ultrasonic beacons of the others hang.
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
    """Return the vehicle."""
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
    """Return drive and allocation; for a propeller with variable pitch a negative speed is a negative pitch."""
    if fan == "reversible":
        return FanDrive(), ThrustVectorAllocation()
    even = replace(Thruster(), reverse_ratio=np.array([0.0, 0.0, 0.0, 1.0]))
    drive = FanDrive(controller=SpeedController(brake=0), thruster=even, table=thrust_table(even))
    return drive, ThrustVectorAllocation(thruster=even, table=full_speed_table(even))


def _flight_limits(navigation: Navigation, floor: Floor) -> tuple[Limit, ...]:
    """Return the limits of the supervisor: reconstructed, far beyond what these flights need, and safe for a hall."""
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
    """Return targets of the three velocities (m/s, rad/s), sway at rest; the bands of the first two are 0.1 m/s."""
    return (
        Target("truth.surge_velocity", surge, 0.1),
        Target("truth.sway_velocity", 0.0, 0.1),
        Target("truth.yaw_rate", yaw_rate, yaw_band),
    )


def heading_scenario(name: str, law: Any, initial: Initial, equipment: Equipment) -> Scenario[Hovercraft]:
    """Turn to 1 rad from rest by the shortest way, or, as in the thesis's fig. 6.11, to 5 rad out of a spinning slide.

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
    return hovercraft_scenario(name, law, x, 35, targets, equipment, errors=errors, floor=(-6, 6, -5, 9))
