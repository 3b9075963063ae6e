"""Parts that all scenarios of the shop's hovercraft share: craft, motor, servo, flight controller and navigation."""

from typing import Annotated, Any, Literal

import numpy as np

from trimtab.actuators.backlash import Backlash, DeadBand
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.failsafe import Failsafe
from trimtab.actuators.lag import FirstOrderLag
from trimtab.actuators.rudder_allocation import RudderAllocation
from trimtab.actuators.servo_frame import ServoFrame
from trimtab.actuators.servo_pulse import ServoPulse
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain, Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPose
from trimtab.vehicles.hovercraft import HovercraftState
from trimtab.vehicles.rudder_hovercraft import RudderHovercraft, RudderThrottle

Navigation = Annotated[
    Literal["noisy"],
    {"noisy": "true pose and velocity with white noise"},
]
Links = Annotated[
    Literal["msp", "none"],
    {
        "msp": "commands reach the flight controller by cable 20 ms after they are computed",
        "none": "no delay, because the autopilot is on the flight controller",
    },
]
RUDDER_MAX = 0.6
"""Largest rudder angle to either side (rad)."""
PERIOD = ms(10)
"""Period of the autopilot, and of the commands to the flight controller."""
SAFE = RudderThrottle(throttle=0.0, rudder=0.0)


def shop_actuators() -> ActuatorBank:
    """Return the actuators: a motor with speed controller that needs 5 % of throttle to turn, and a standard servo.

    The servo moves 60 degrees in 0.15 s. Its dead band is 4 µs, and its linkage has a play of about one degree.
    """
    rate = 60 * DEG / 0.15
    return ActuatorBank(
        neutral_input=SAFE,
        stages={
            "throttle": (
                ServoPulse(values=np.array([0.0, 1.0])),
                DeadBand(half_width=0.05, cuts=True),
                FirstOrderLag(time_constant=0.12, low=0.0, high=1.0),
            ),
            "rudder": (
                ServoPulse(values=np.array([-RUDDER_MAX, RUDDER_MAX])),
                ServoFrame(frame=ms(20)),
                FirstOrderLag(time_constant=0.03, rate_limit=rate, low=-RUDDER_MAX, high=RUDDER_MAX),
                Backlash(width=0.02),
            ),
        },
    )


def shop_failsafe() -> Failsafe:
    """Return the failsafe: propeller at rest, rudders in the middle."""
    return Failsafe(
        safe=SAFE,
        low=RudderThrottle(throttle=0.0, rudder=-RUDDER_MAX),
        high=RudderThrottle(throttle=1.0, rudder=RUDDER_MAX),
    )


def shop_scenario(
    name: str,
    law: Any,
    x: HovercraftState,
    duration_s: float,
    targets: tuple[Target, ...],
    navigation: Navigation,
    links: Links,
) -> Scenario[RudderHovercraft]:
    """Return a scenario of the shop's hovercraft.

    Args:
        name: name of the scenario in the catalogue.  law: control law.
        x: initial state of the craft.  duration_s: duration of the flight (s).
        targets: desired values of signals, for the metrics.
        navigation, links: equipment that the user chose.
    """
    sensors = {"navigation": NoisyPlanarPose(period=PERIOD)}
    uplink = DelayChain(period=PERIOD, steps=2) if links == "msp" else Wire()
    return Scenario(
        world=World(
            vehicle=RudderHovercraft(), sensors=sensors, downlink=Wire(), uplink=uplink, actuators=shop_actuators()
        ),
        autopilot=Autopilot(
            estimator=Passthrough("navigation"),
            law=law,
            allocation=RudderAllocation(rudder_max=RUDDER_MAX),
            period=PERIOD,
        ),
        initial=x,
        duration=seconds(duration_s),
        targets=targets,
        failsafe=shop_failsafe(),
        truth_sensor=PlanarPose(),
        name=name,
    )
