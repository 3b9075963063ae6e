"""Drive a car with a minimum turning radius along the shortest path to a pose, over a radio link. Textbook example."""

from typing import Annotated, Literal

import numpy as np

from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.design.dubins_paths import shortest_path
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.virtual_target import VirtualTarget
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPose
from trimtab.vehicles.dubins_car import CarTurn, DubinsCar, DubinsCarState

TICK = ms(50)
GOALS = {
    "LSR": (4.0, -4.0, 45.0),
    "RSL": (4.0, 3.0, 0.0),
    "LSL": (5.0, -4.0, -135.0),
    "RSR": (4.0, 4.0, 180.0),
    "RLR": (-1.0, -1.0, 180.0),
    "LRL": (0.0, 2.0, 135.0),
}
"""Path type, a sequence of L (left turn), S (straight) and R (right turn) -> goal pose to which the shortest path has
this type: north, east (m) and heading (degrees)."""
RADIUS = 1.0
"""Turning radius of the path (m). The car's minimum turning radius is smaller, 0.8 m, so that the car can correct
deviations to both sides in a turn."""
Word = Annotated[
    Literal["LSR", "RSL", "LSL", "RSR", "RLR", "LRL"],
    {word: f"to {n:g} m north, {e:g} m east, heading {h:g} degrees" for word, (n, e, h) in GOALS.items()},
]


def scenario(word: Word = "LSR") -> Scenario:
    """Return the scenario of the car. All parameters are our choice.

    The car starts 30 cm to the right of the path, and does not stop at the goal.
    """
    car = DubinsCar()
    north, east, heading = GOALS[word]
    path = shortest_path((0.0, 0.0, 0.0), (north, east, np.deg2rad(heading)), RADIUS, float(car.speed))
    path = replace(path, lengths=np.round(path.lengths, 9))  # rounded, for the same numbers on every machine
    steering = FirstOrderLag(time_constant=0.05, low=-1.25, high=1.25)
    world = World(
        vehicle=car,
        sensors={"navigation": NoisyPlanarPose(position_noise=0.02, heading_noise=0.01, period=TICK)},
        actuators=ActuatorBank(CarTurn(0.0), {"turn_rate": steering}, period=TICK),
        downlink=DelayChain(period=TICK, steps=1),
        uplink=DelayChain(period=TICK, steps=1),
        max_step=TICK,
    )
    autopilot = Autopilot(Passthrough(), VirtualTarget(reference=path, craft=car), DirectAllocation(), period=TICK)
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=DubinsCarState(0.0, 0.3, 0.0),
        duration=seconds(10),
        targets=(Target("law.cross_track", 0.0, 0.15), Target("law.heading_error", 0.0, 0.2)),
        truth_sensor=PlanarPose(),
        name="dubins/path",
    )
