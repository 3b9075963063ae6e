"""Locate the end of a rotating arm from ultrasonic ranges: in one filter with the IMU, or as fixes for an INS."""

from typing import Any, Literal

import numpy as np

from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import seconds
from trimtab.environment.acoustics import Air
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.ranging.position import PAIR, RangingPosition
from trimtab.estimators.ranging.tightly_coupled import TightlyCoupled
from trimtab.estimators.ranging.ultrasonic_inertial import UltrasonicInertial
from trimtab.laws.turntable import Turntable
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.navigation._platform import rig_scenario
from trimtab.sensors.imu import Imu
from trimtab.sensors.time_of_flight import CEILING_SQUARE, Beacons, Medium
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging

Coupling = Literal["tight", "loose"]
BeaconCount = Literal["4", "3", "2"]
NOISE = InertialNoise(gyro=1.6e-4, gyro_walk=1e-6, forward=6.8e-3, starboard=6.8e-3, force_walk=3e-4)
"""Noise of the inertial unit that the filter assumes. The random walks are larger than in the data sheet, to cover
errors of scale factor, misalignment and bandwidth."""
START = InertialStart(sigma_gyro_bias=0.02, sigma_force_bias=0.15)
ASSUMED_NOISE = replace(NOISE, position_constant=0.008, heading_constant=0.012)
"""Noise that the loosely coupled filter assumes. It includes constant errors of the position fixes, due to errors of
beacon survey and air temperature. The tightly coupled filter estimates these errors instead.
"""


def scenario(coupling: Coupling = "tight", beacons: BeaconCount = "4") -> Scenario:
    """Return the scenario of the rotating platform with ranges to ultrasonic beacons.

    The platform is that of section 6.2.1 in the thesis (Kulis 2006), but without tilt. Its chapter 7 names ranging as
    future work. All four beacons reply until 5 s, and after this time only as many as the argument `beacons` says.
    """
    silent = np.arange(4) >= int(beacons)
    air = Medium(actual=replace(Air(), temperature=293.65))  # half a degree warmer than the filter assumes
    hung = Beacons(survey_error=0.005, dead=silent, fault_time=seconds(5))
    sensors = {
        "imu": Imu.microstrain_3dm_gx1(),
        "ranging": UltrasonicRanging(beacons=hung, units=PAIR, clients=2, medium=air),
    }

    def estimator(_: Any) -> Any:
        if coupling == "tight":
            return TightlyCoupled(noise=NOISE, start=START, beacons=CEILING_SQUARE, units=PAIR)
        return UltrasonicInertial(
            positioning=RangingPosition(beacons=CEILING_SQUARE, units=PAIR),
            inertial=AidedInertialFeedback(noise=ASSUMED_NOISE, start=START),
        )

    name, law = "navigation/platform-ranging", Turntable(rate=-115.0 * DEG)
    rig = rig_scenario(name, sensors, law, intake=Intake(), estimator=estimator)
    level = replace(rig.world.vehicle, tilt=0.0)
    return replace(rig, world=replace(rig.world, vehicle=level))
