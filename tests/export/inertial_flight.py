"""The hovercraft flown on an aided INS: an IMU, a compass and a positioning system with white noise."""

from typing import Any

import numpy as np

from trimtab.core.record import Scalar, option, part, period, quantity, record, replace
from trimtab.core.rng import Key, normals
from trimtab.core.signals import measured
from trimtab.core.time import ms, seconds
from trimtab.estimators.aided_inertial_feedforward import AidedInertialFeedforward
from trimtab.links.wire import Wire
from trimtab.scenarios import catalogue


@record
class Inertial:
    """Planar rate and specific force. Source: none."""

    yaw_rate: Scalar = quantity("rad/s", "Rate.", frame="B")
    forward: Scalar = quantity("m/s^2", "Specific force.", frame="B")
    starboard: Scalar = quantity("m/s^2", "Specific force.", frame="B")


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
            return Inertial(motion.w_WB_B[2], motion.a_WB_B[0], motion.a_WB_B[1])
        return Heading(motion.attitude[2]) if self.kind == 1 else Position(motion.p_WB[0], motion.p_WB[1])

    def step(self, t: Any, key: Key, motion: Any) -> Any:
        z = self.sigma * normals(key, t // self.period, 3)
        true = self.measure(motion)
        if self.kind == 0:
            value = Inertial(true.yaw_rate + z[0], true.forward + z[1], true.starboard + z[2])
        elif self.kind == 1:
            value = Heading(true.heading + z[0])
        else:
            value = Position(true.north + z[0], true.east + z[1])
        return key, measured(t, value)


def scenario(name: str = "hovercraft/zero-velocity") -> Any:
    """A scenario of the catalogue with the aided INS in place of the navigation error."""
    made, _ = catalogue.load(name)
    sensors = {
        "imu": Noisy(sigma=np.array([0.0126, 0.082, 0.082])),
        "heading": Noisy(sigma=np.full(3, 0.0126), kind=1),
        "position": Noisy(sigma=np.full(3, 0.0237), kind=2, period=ms(100)),
    }
    world = replace(made.world, sensors=sensors, downlink=Wire(period=ms(1)))
    autopilot = replace(made.autopilot, estimator=AidedInertialFeedforward())
    return replace(made, world=world, autopilot=autopilot, duration=seconds(5), name="inertial flight")
