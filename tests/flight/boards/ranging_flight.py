"""The hovercraft flown on raw ranges: an IMU, an ultrasonic network and the tightly coupled filter."""

from typing import Any

import numpy as np

from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.ranging.position import PAIR
from trimtab.estimators.ranging.tightly_coupled import TightlyCoupled
from trimtab.links.wire import Wire
from trimtab.scenarios import catalogue
from trimtab.sensors.imu import Imu
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging
from trimtab.vehicles.hovercraft import HovercraftState

NOISE = InertialNoise(gyro=0.0126**2, gyro_walk=1e-8, forward=0.082**2, starboard=0.082**2, force_walk=1e-8)
SLOTS = 20
"""Those of 0.1 s and a few more."""


def scenario(name: str = "hovercraft/zero-velocity") -> Any:
    """A scenario of the catalogue with the tightly coupled filter in place of the navigation error."""
    made, _ = catalogue.load_scenario(name)
    ranging = UltrasonicRanging(units=PAIR, clients=2, collisions=False, period=ms(2))
    sensors = {"imu": Imu.microstrain_3dm_gx1(), "ranging": ranging}
    world = replace(made.world, sensors=sensors, downlink=Wire(period=ms(1)))
    estimator = TightlyCoupled(
        noise=NOISE,
        start=InertialStart(sigma_gyro_bias=np.deg2rad(0.7), sigma_force_bias=0.1),
        intake=Intake(heading="", position="ranging", slots=SLOTS),
    )
    autopilot = replace(made.autopilot, estimator=estimator)
    start = HovercraftState(surge_velocity=0.2, sway_velocity=-0.4, yaw_rate=1.5)
    changed = {"world": world, "autopilot": autopilot, "initial": start, "duration": seconds(5)}
    return replace(made, **changed, name="ranging flight")
