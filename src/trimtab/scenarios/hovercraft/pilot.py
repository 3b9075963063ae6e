"""Fly with a pilot's stick, moved by a script or by hand on the console: drive, turn while moving, stop, spin."""

from typing import Annotated, Literal

from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.laws.piloted import Piloted
from trimtab.logs.metrics import Target
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor, stick_script
from trimtab.scenarios.hovercraft._navigation import Bus, Navigation
from trimtab.scenarios.hovercraft._thesis import (
    Craft,
    Equipment,
    Fan,
    Links,
    Supervision,
    hovercraft_scenario,
    velocity_targets,
)
from trimtab.vehicles.hovercraft import HovercraftState

StickSource = Annotated[
    Literal["script", "console"],
    {
        "script": "scripted demonstration: drive ahead, turn while moving, stop, spin",
        "console": "stick of the pilot console; in a simulation the stick is not moved, so the vehicle stays at rest",
    },
]
DEMONSTRATION = stick_script(
    (seconds(0), 0.0, 0.0, "manual"),
    (seconds(2), 0.75, 0.0, "assisted"),
    (seconds(8), 0.75, 0.6, "assisted"),
    (seconds(20), 0.75, 0.0, "assisted"),
    (seconds(24), 0.0, 0.0, "assisted"),
    (seconds(32), 0.0, 0.6, "damped"),
)


def scenario(
    stick: StickSource = "script",
    links: Links = "chain",
    navigation: Navigation = "errors",
    supervisor: Supervision = "none",
    bus: Bus = "none",
    craft: Craft = "thesis",
    fan: Fan = "reversible",
) -> Scenario:
    """Return the scenario of a flight with a pilot.

    Stick and law are our choice. Vehicle, radio and navigation are those of the thesis (Kulis 2006).
    """
    equipment = Equipment(links, navigation, supervisor, bus, craft, fan)
    name, law, initial, floor = "hovercraft/pilot", Piloted(), HovercraftState(), (-10, 20, -10, 20)
    if stick == "console":
        targets, duration = velocity_targets(), 600
    else:
        rate = 0.6 * float(law.yaw_range)
        targets, duration = (Target("truth.surge_velocity", 0.0, 0.2), Target("truth.yaw_rate", rate, 0.3)), 42
    flown = hovercraft_scenario(name, law, initial, duration, targets, equipment, floor=floor)
    if stick == "console":
        return add_stick_sensor(flown)
    return replace(flown, world=replace(flown.world, sensors={**flown.world.sensors, law.stick: DEMONSTRATION}))
