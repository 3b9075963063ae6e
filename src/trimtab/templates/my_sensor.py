"""A sensor of your own: trimtab run my_sensor.py:scenario"""

from typing import Any

from trimtab import Scenario, build, ms, period, record, replace
from trimtab.core.quantity import imperfection
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, PlanarState, Sample, new_sample


@record
class MySensor:  # its fields are settings: --set world.sensors.navigation.rate_noise=0
    """Sensor of velocity, rate of turn and heading, with noise and a gyro bias for each flight. Source: this file."""

    # --without sensor-noise sets an `imperfection` of this group to zero
    velocity_noise: Any = imperfection("m/s", "Standard deviation of the velocity noise.", "sensor-noise", default=0.02)
    rate_noise: Any = imperfection("rad/s", "Standard deviation of the yaw rate noise.", "sensor-noise", default=0.01)
    heading_noise: Any = imperfection("rad", "Standard deviation of the heading noise.", "sensor-noise", default=0.02)
    rate_bias: Any = imperfection("rad/s", "Standard deviation of the gyro bias.", "gyro-bias", default=0.02)
    period: int = period("Time between samples.", default=ms(10))

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random numbers, which differs from flight to flight."""
        return key

    def measure(self, motion: Motion) -> PlanarState:
        """Return the measurement without error. Vectors of the motion have shape (3,); v_WB_B and w_WB_B are in B."""
        u, v, r = motion.v_WB_B[0], motion.v_WB_B[1], motion.w_WB_B[2]  # forward, starboard: m/s; clockwise: rad/s
        return PlanarState(surge_velocity=u, sway_velocity=v, yaw_rate=r, heading=motion.attitude[2])

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at integer time t (100 ns). normal2() returns two standard normal random numbers."""
        x, k = self.measure(motion), t // self.period
        (n0, n1), (n2, n3), (bias, _) = normal2(state, k, 0), normal2(state, k, 1), normal2(state, 0, 2)
        measured = PlanarState(
            surge_velocity=x.surge_velocity + self.velocity_noise * n0,
            sway_velocity=x.sway_velocity + self.velocity_noise * n1,
            yaw_rate=x.yaw_rate + self.rate_bias * bias + self.rate_noise * n2,
            heading=x.heading + self.heading_noise * n3,
        )
        return state, new_sample(t, measured)


def scenario() -> Scenario:
    """Return the scenario: a hovercraft drives forward. This sensor replaces its navigation."""
    base = build("hovercraft/forward")
    world = replace(base.world, sensors={"navigation": MySensor()})
    return replace(base, world=world, name="my_sensor")
