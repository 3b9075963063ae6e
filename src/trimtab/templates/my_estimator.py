"""An estimator of your own: trimtab run my_estimator.py:scenario"""

from typing import Any

import jax.numpy as jnp

from trimtab import Scenario, build, option, part, quantity, record, replace, seconds
from trimtab.core.record import tree_where
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds
from trimtab.sensors.planar_pose import PlanarPoseState


@record
class MyEstimatorState:  # kept from one control period to the next
    """State of the estimator: the last estimate. Source: this file."""

    pose: PlanarPoseState = part("Velocity in B, rate of turn, heading and position.")
    begun: Any = quantity("1", "True after the first measurement has arrived.", kind="flag")


@record
class MyEstimator:  # its fields are settings: --set autopilot.estimator.share=1
    """Low-pass filter of the measured velocities. Other measurements pass unchanged. Source: this file."""

    sensor: str = option("Name of the sensor that the estimator reads.", default="navigation")
    share: Any = quantity("1", "Weight of a new measurement, 1 for no filter.", default=0.3, above=0, high=1)

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors whose samples the estimator needs."""
        return (self.sensor,)

    def init(self, key: Any) -> MyEstimatorState:
        """Return the initial state, before any measurement."""
        return MyEstimatorState(PlanarPoseState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), jnp.zeros((), bool))

    def step(self, t: Any, state: Any, frame: Frame) -> tuple[MyEstimatorState, Estimate]:
        """Return the estimate at integer time t (100 ns). Use jnp.where or tree_where instead of `if` on a sample."""
        sample = frame.samples[self.sensor]  # .fresh: True if not yet read; .valid: False before the first sample
        z, x, share = sample.value, state.pose, jnp.where(state.begun, self.share, 1.0)
        filtered = replace(
            z,
            surge_velocity=x.surge_velocity + share * (z.surge_velocity - x.surge_velocity),  # m/s, in B
            sway_velocity=x.sway_velocity + share * (z.sway_velocity - x.sway_velocity),
            yaw_rate=x.yaw_rate + share * (z.yaw_rate - x.yaw_rate),  # rad/s
        )
        new = MyEstimatorState(tree_where(sample.fresh, filtered, x), state.begun | sample.valid)
        age = to_seconds(t - sample.t)  # s
        return new, Estimate(t=t, age=age, fresh=sample.fresh, valid=new.begun, state=new.pose)


def scenario() -> Scenario:
    """Return the scenario: a model ship follows way-points in a current. This estimator replaces the base's."""
    base = build("vessel/path")
    autopilot = replace(base.autopilot, estimator=MyEstimator())
    return replace(base, autopilot=autopilot, duration=seconds(20), name="my_estimator")
