"""Keep a vehicle with the hovercraft's inertial unit at rest: the log from which to calibrate its noise.

Everything but the inertial unit has a period of 5 ms, shorter than the unit's tick. The log, written each millisecond
at which something is due, thus contains every sample of the unit, and no more rows than needed.
"""

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.velocity import ZeroVelocity
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.imu import Imu
from trimtab.sensors.navigation_errors import PlanarNavigation
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

TICK = ms(5)


def scenario() -> Scenario:
    """Five minutes: enough for the white noise to a percent and for a first look at the walk of the biases."""
    world = World(
        vehicle=Hovercraft(),
        sensors={"imu": Imu.microstrain_3dm_gx1(), "navigation": PlanarNavigation(period=TICK)},
        downlink=Wire(period=TICK),
        uplink=Wire(period=TICK),
        actuators=DirectActuation(period=TICK),
        max_step=TICK,
    )
    autopilot = Autopilot(
        estimator=Passthrough("navigation"), law=ZeroVelocity(), allocation=DirectAllocation(), period=TICK
    )
    return Scenario(
        world=world, autopilot=autopilot, initial=HovercraftState(), duration=seconds(300), name="navigation/still"
    )
