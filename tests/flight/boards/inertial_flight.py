"""The hovercraft flown on an aided INS: an IMU, a compass and a positioning system with white noise."""

from typing import Any

import numpy as np

from trimtab.core.record import Scalar, option, part, period, quantity, record, replace
from trimtab.core.rng import Key, normals
from trimtab.core.signals import new_sample
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.links.wire import Wire
from trimtab.scenarios import catalogue
from trimtab.sensors.imu import InertialReading
from trimtab.vehicles.hovercraft import HovercraftState

NOISE = InertialNoise(gyro=0.0126**2, gyro_walk=1e-8, forward=0.082**2, starboard=0.082**2, force_walk=1e-8)
"""That of the sensors below."""


@record
class Heading:
    """A heading. Source: none."""

    heading: Scalar = quantity("rad", "Heading.", kind="angle")


@record
class Position:
    """A position. Source: none."""

    north: Scalar = quantity("m", "North.", frame="W")
    east: Scalar = quantity("m", "East.", frame="W")


@record
class Noisy:
    """A sensor with white noise. Source: none."""

    sigma: Scalar = quantity("1", "Standard deviation of each number.", shape=(3,))
    key: Any = part("Of its noise.", default=None)
    kind: int = option("Which of the three it is.", default=0, choices=(0, 1, 2))
    period: int = period("How often it measures.", default=ms("6.5536"))

    def init(self, key: Key) -> Key:
        return key

    def measure(self, motion: Any) -> Any:
        if self.kind == 0:
            return InertialReading(motion.a_WB_B, motion.w_WB_B, np.bool_(False), np.bool_(False))
        return Heading(motion.attitude[2]) if self.kind == 1 else Position(motion.p_WB[0], motion.p_WB[1])

    def step(self, t: Any, key: Key, motion: Any) -> Any:
        z = self.sigma * normals(key, t // self.period, 3)
        true = self.measure(motion)
        if self.kind == 0:
            rate, force = true.angular_rate.at[2].add(z[0]), true.specific_force.at[:2].add(z[1:])
            value = replace(true, angular_rate=rate, specific_force=force)
        elif self.kind == 1:
            value = Heading(true.heading + z[0])
        else:
            value = Position(true.north + z[0], true.east + z[1])
        return key, new_sample(t, value)


def scenario(name: str = "hovercraft/zero-velocity") -> Any:
    """A scenario of the catalogue with the aided INS in place of the navigation error."""
    made, _ = catalogue.load_scenario(name)
    sensors = {
        "imu": Noisy(sigma=np.array([0.0126, 0.082, 0.082])),
        "heading": Noisy(sigma=np.full(3, 0.0126), kind=1),
        "position": Noisy(sigma=np.full(3, 0.0237), kind=2, period=ms(100)),
    }
    world = replace(made.world, sensors=sensors, downlink=Wire(period=ms(1)))
    autopilot = replace(made.autopilot, estimator=AidedInertialFeedforward(noise=NOISE))
    start = HovercraftState(surge_velocity=0.2, sway_velocity=-0.7, yaw_rate=3.0)  # within the gyro's range
    changed = {"world": world, "autopilot": autopilot, "initial": start, "duration": seconds(5)}
    return replace(made, **changed, name="inertial flight")
