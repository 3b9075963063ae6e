"""Avoid the ground in an F-16 that is banked and diving at 1000 ft: roll the wings level, then pull up."""

import math
from typing import Annotated, Literal

import numpy as np

from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms, seconds
from trimtab.laws.ground_avoidance import GroundAvoidance, LoadFactorControl
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.scenarios.f16._navigation import STATION, TICK, Navigation, equipment
from trimtab.sensors.flight_instruments import FlightInstruments
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT

Start = Annotated[
    Literal["dive", "inverted"],
    {
        "dive": "27 degrees nose down, 22.5 degrees of bank",
        "inverted": "inverted: 162 degrees of bank, one degree nose down",
    },
]
Gains = Annotated[
    Literal["actuators", "published"],
    {
        "actuators": "gains designed for the lag of the control surfaces and the delay of the loop",
        "published": "gains of AeroBenchVV, designed without the surfaces' lag; with the lag the roll loop is unstable",
    },
]
SURFACES = {"elevator": (25.0, 60.0), "aileron": (21.5, 80.0), "rudder": (30.0, 120.0)}
"""Control surface -> maximum deflection in either direction (deg), and maximum rate (deg/s)."""
BANDWIDTH = 20.2
"""Bandwidth of the control surfaces' first-order lag (rad/s)."""

FOR_ACTUATORS = GroundAvoidance(
    control=LoadFactorControl(
        longitudinal=np.array([-1.576818, -0.4483116, -0.2468268]),
        lateral=np.array(
            [
                [0.6473613, -0.1181201, -0.2357431, -0.760525, -0.3533955],
                [-0.1518247, 0.0380294, -0.5557529, 0.1756036, -1.5305269],
            ]
        ),
    ),
    roll_gain=2.0,
    roll_damping=0.0,
    most_roll=2.5,
)
"""Ground avoidance law with the gains that the module `_gains` computes from the weights "actuators".

For comparison: the law of AeroBenchVV has a roll gain of 4, a roll damping of 2, and no limit on the roll rate demand.
"""


def scenario(start: Start = "dive", gains: Gains = "actuators", navigation: Navigation = "instruments") -> Scenario:
    """Return the ground avoidance scenario.

    The two initial states are those of AeroBenchVV. The sensor errors are our choice.
    """
    law = FOR_ACTUATORS if gains == "actuators" else GroundAvoidance()
    control = law.control
    trim = F16Controls(elevator=control.trim_elevator, aileron=0.0, rudder=0.0, throttle=control.throttle)
    bank, pitch, length = (
        (-math.pi / 8, -0.15 * math.pi, 6) if start == "dive" else (-0.9 * math.pi, -0.005 * math.pi, 10)
    )
    first = first_state(bank, pitch)
    sensors, estimator = equipment(navigation, first)
    world = World(
        vehicle=F16FlatEarth(),
        sensors=sensors,
        downlink=Wire(period=TICK),
        uplink=Wire(period=TICK),
        actuators=surfaces(trim),
        max_step=ms(5),
    )
    autopilot = Autopilot(estimator, law, DirectAllocation(), period=TICK)
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=first,
        duration=seconds(length),
        targets=(Target("law.load_error", 0.0, 0.1), Target("truth.roll", 0.0, 5 * DEG)),
        truth_sensor=FlightInstruments(lever_arm=STATION, period=TICK),
        name="f16/gcas",
    )


def surfaces(trim: F16Controls) -> ActuatorBank:
    """Return elevator, aileron and rudder with command limits, lag and maximum rate, and a throttle with limits only.

    Source: B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft control and simulation", 3rd ed., 2015, table 3.5-1.
    """
    stages = {
        name: (
            FirstOrderLag(time_constant=0.0, low=-most * DEG, high=most * DEG),
            FirstOrderLag(time_constant=1 / BANDWIDTH, rate_limit=rate * DEG),
        )
        for name, (most, rate) in SURFACES.items()
    }
    ends = FirstOrderLag(time_constant=0.0, low=0.0, high=1.0)
    return ActuatorBank(trim, {**stages, "throttle": (ends,)}, period=ms(5))


def first_state(bank: float, pitch: float, altitude: float = 1000 * FOOT, speed: float = 540 * FOOT) -> F16State:
    """Return an initial state with heading north and no rotation, with the angle of attack and power of AeroBenchVV.

    bank and pitch are in rad, altitude in m, speed in m/s.
    """
    rest = F16State(*[0.0] * 13)
    return replace(rest, speed=speed, alpha=2.1215 * DEG, roll=bank, pitch=pitch, altitude=altitude, power=0.09)
