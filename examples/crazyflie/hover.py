"""Fly a Crazyflie to a place: trimtab run examples/crazyflie/hover.py:scenario --plot hover.png"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from crazyflie import FIXED, RPM, Crazyflie
from crazyflow.control.transform import motor_force2rotor_vel
from mellinger import Mellinger

from trimtab import Autopilot, Scenario, Target, World, ms, seconds
from trimtab.actuators.allocation import DirectAllocation
from trimtab.actuators.rotor_allocation import RotorDrive
from trimtab.core.spatial_reference import FixedPlace
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain
from trimtab.sensors.multirotor_state import MultirotorStateSensor
from trimtab.vehicles.quadrotor import MultirotorState

PERIOD = ms(2)


def scenario() -> Scenario:
    """Return a flight from the ground to a place 0.5 m above it, with motion capture and a radio."""
    slow, fast = motor_force2rotor_vel(np.array([0.0128, 0.12]), FIXED["rpm2thrust"]) / RPM
    world = World(
        vehicle=Crazyflie(),
        sensors={"state": MultirotorStateSensor(period=PERIOD)},
        downlink=DelayChain(period=PERIOD, steps=1),
        uplink=DelayChain(period=PERIOD, steps=1),
        actuators=RotorDrive(least=float(slow), most=float(fast), period=PERIOD),
        max_step=PERIOD,
    )
    law = Mellinger(reference=FixedPlace((0.3, 0.0, -0.5)))
    autopilot = Autopilot(Passthrough("state"), law, DirectAllocation(), period=PERIOD)
    return Scenario(world, autopilot, MultirotorState(), seconds(5), (Target("law.distance", 0.0, 0.05),))
