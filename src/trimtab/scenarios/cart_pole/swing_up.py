"""Swing up a pole on a cart by energy control, then catch and balance the pole. A textbook example."""

from typing import Annotated, Literal

import numpy as np

from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import FirstOrderLag
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.swing_up import SwingUp
from trimtab.links.wire import Wire
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.flight_state import TrueState
from trimtab.sensors.rail_encoders import RailEncoders
from trimtab.vehicles.cart_pole import CartForce, CartPole, CartPoleState

TICK = ms(10)
Start = Annotated[
    Literal["hanging", "leaning"], {"hanging": "0.1 rad from the hanging position", "leaning": "0.2 rad from upright"}
]


def scenario(start: Start = "hanging") -> Scenario:
    """Return the swing-up scenario. The masses are those of Barto (1983). Force limit and motor lag are our
    assumptions."""
    motor = FirstOrderLag(time_constant=0.02, low=-10.0, high=10.0)
    world = World(
        vehicle=CartPole(),
        sensors={"encoders": RailEncoders(period=TICK)},
        actuators=ActuatorBank(CartForce(0.0), {"force": motor}, period=TICK),
        downlink=Wire(period=TICK),
        uplink=Wire(period=TICK),
        max_step=TICK,
    )
    autopilot = Autopilot(Passthrough("encoders"), SwingUp(), DirectAllocation(), period=TICK)
    angle = np.pi - 0.1 if start == "hanging" else 0.2
    return Scenario(
        world=world,
        autopilot=autopilot,
        initial=CartPoleState(0.0, 0.0, angle, 0.0),
        duration=seconds(15),
        targets=(Target("law.lean", 0.0, 0.05), Target("truth.position", 0.0, 0.1)),
        truth_sensor=TrueState(),
        name="cart-pole/swing-up",
    )
