"""Keep a hovercraft at rest, to record a log for the calibration of the noise of an inertial unit.

All parts except the inertial unit have a period of 5 ms, so that the log contains every sample of the inertial unit and
only few other rows.
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
    """Return the scenario of a hovercraft at rest, with a duration of five minutes.

    From this time, the white noise can be calibrated to 1 %, and the random walk of the biases roughly.
    """
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
