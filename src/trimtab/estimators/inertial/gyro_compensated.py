"""Aided inertial navigation behind the inverse of its gyro's dynamics.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import numpy as np

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import ms
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.gyro_compensator import CompensatorState, GyroCompensator
from trimtab.estimators.inertial.sensor_watch import NEVER


@record
class CompensatedState:
    """The compensator's memory, its last sample, and the navigation behind it. Source: this module."""

    compensator: CompensatorState = part("Rates as measured before.")
    rate: Any = quantity("rad/s", "Last compensated angular velocity.", frame="B", shape=(3,))
    last: Scalar = quantity("100 ns", "When that sample was measured.", kind="time")
    navigation: Any = part("State of the navigation.")


@record
class CompensatedInertial:
    """Any form of aided inertial navigation, with each gyro sample put through the compensator first.

    A sample that is not the next after the one before (a gap, or the first) begins anew, as if its rate had been there
    for all time. Samples that are older, repeated or not finite pass as they are: the navigation refuses them itself.

    Valid:   samples at the compensator's own rate; with a slower unit, each beyond `gap`, nothing is compensated.
    Source:  [1] section 6.2.1, table 6.6.
    """

    navigation: Any = part("What gets the compensated samples.", default=AidedInertialFeedforward())
    compensator: GyroCompensator = part("Inverse of the gyro.", default=GyroCompensator())
    gap: Scalar = quantity("100 ns", "Longest time between two samples in a row.", default=ms(10), kind="time")

    @property
    def listens(self) -> tuple[str, ...]:
        """As the navigation does."""
        return self.navigation.listens

    def check(self) -> None:
        """What the navigation refuses."""
        self.navigation.check()

    def init(self, key: Key) -> CompensatedState:
        """Nothing measured."""
        o = jnp.zeros(3)
        memory = CompensatorState(y1=o, y2=o)
        return CompensatedState(compensator=memory, rate=o, last=np.int64(NEVER), navigation=self.navigation.init(key))

    def step(self, t: Any, state: CompensatedState, frame: Frame) -> tuple[CompensatedState, Estimate]:
        """The navigation's estimate at integer time t."""
        name = self.navigation.intake.imu
        sample = frame.samples[name]
        y = sample.value.angular_rate
        sound = jnp.all(jnp.isfinite(y))
        new = sample.fresh & sample.valid & (sample.t > state.last) & (sample.t <= t)
        follows = sample.t - state.last <= self.gap
        y1, y2 = (jnp.where(follows, past, y) for past in (state.compensator.y1, state.compensator.y2))
        memory, rate = self.compensator.compensate(CompensatorState(y1=y1, y2=y2), y)
        told = jnp.where(new, jnp.where(sound, rate, y), y)
        frame = replace(
            frame,
            samples={**frame.samples, name: replace(sample, value=replace(sample.value, angular_rate=told))},
        )
        inner, estimate = self.navigation.step(t, state.navigation, frame)
        taken = new & sound
        kept = CompensatedState(
            compensator=CompensatorState(
                y1=jnp.where(taken, memory.y1, state.compensator.y1),
                y2=jnp.where(taken, memory.y2, state.compensator.y2),
            ),
            rate=jnp.where(taken, rate, state.rate),
            last=jnp.where(taken, sample.t, state.last),
            navigation=inner,
        )
        return kept, estimate
