"""Dive two metres and turn to starboard in a current, with an underwater vehicle that is unstable in pitch and yaw."""

from typing import Annotated, Any, Literal

import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.environment.current import Current
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.diving import Diving
from trimtab.links.latency import MeasuredLatency, gamma_table
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.dive import DiveSensor
from trimtab.vehicles.torpedo import CRUISE, Torpedo, TorpedoControls, TorpedoState

Links = Annotated[
    Literal["aboard", "acoustic"],
    {
        "aboard": "the autopilot is on board; a bus delays samples by 50 ms and commands by 50 ms",
        "acoustic": "the autopilot is on a buoy about 60 m away; latency about 90 ms each way, 5 % of packets lost",
    },
]
TICK = ms(50)
LEVEL = TorpedoState(
    position=np.array([0.0, 0.0, 3.0]),
    attitude=np.array([0.997861, -0.063210, -0.016609, -0.001052]),
    velocity=np.array([1.760493, 0.007017, -0.058203]),
    rudder=-0.015563,
    stern=-0.119350,
    shaft_speed=CRUISE * 1750 / 1500,
)
"""Trim state at constant depth and 1750 rpm. The propeller's torque rolls the vehicle by 7 degrees. Buoyancy and fins
pitch the vehicle 1.9 degrees nose down."""


def scenario(links: Links = "aboard") -> Scenario:
    """Return the dive scenario. The vehicle is that of Prestero (2001). Gains, links, noise and current are our
    choice."""
    torpedo = Torpedo(current=Current(north=-0.2, east=0.2))
    drift = np.asarray(torpedo.current.in_body(quaternion.to_matrix(LEVEL.attitude).T))
    world = World(
        vehicle=torpedo,
        sensors={
            "dive": DiveSensor(
                depth_noise=0.02,
                attitude_noise=0.005,
                heading_noise=0.01,
                velocity_noise=0.02,
                rate_noise=0.005,
                period=TICK,
            )
        },
        downlink=_link(links),
        uplink=_link(links),
        actuators=DirectActuation(neutral_input=TorpedoControls(-0.0156, -0.1194, LEVEL.shaft_speed), period=TICK),
        max_step=TICK,
    )
    autopilot = Autopilot(Passthrough("dive"), Diving(depth=5.0, heading=30 * DEG), DirectAllocation(), TICK)
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=replace(LEVEL, velocity=np.round(LEVEL.velocity + drift, 6)),
        duration=seconds(30),
        targets=(Target("truth.position[2]", 5.0, 0.3), Target("law.depth_error", 0.0, 0.3)),
        truth_sensor=DiveSensor(),
        name="torpedo/depth",
    )


def _link(links: Links) -> Any:
    if links == "aboard":
        return DelayChain(period=TICK, steps=1)
    latency = np.round(gamma_table(mean=0.09, sd=0.015, shift=0.06), 5)
    return MeasuredLatency(latency=latency, loss=0.05, send_period=TICK, period=TICK, capacity=16)
