"""Aided inertial navigation with gyro samples that are corrected for the gyro's identified dynamics.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, part, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.second_order import Section
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import ms
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.sensor_watch import NEVER


@record
class CompensatorState:
    """State of the gyro compensator: the last two gyro samples, of any shape. Source: [1] eq. 6.2."""

    y1: Any = quantity("rad/s", "Previous gyro sample.")
    y2: Any = quantity("rad/s", "Second to last gyro sample.")


@record
class GyroCompensator:
    """Difference equation that inverts a second-order gyro model.

        u_k = (y_k + a1 y_{k-1} + a2 y_{k-2})/b0          [1, eq. 6.2 inverted]

    y is the output of the gyro and u the compensated rate. The compensator is causal and always stable. It amplifies
    white noise by a factor of 4.6 in standard deviation, and a signal at half the sampling rate by a factor of 7.3 (4.4
    and 7.0 with the printed b0). Above 15 Hz the gain of the identified model is too low. The compensated rate is
    therefore too large, e.g. by a factor of 1.5 at 20 Hz.

    Valid:   for samples every 6.5536 ms.    Source: [1] eq. 6.2 and table 6.5.
    """

    b0: Scalar = quantity(
        "1",
        "Coefficient of the newest true angular rate in the gyro model.",
        default=0.3236,
        above=0,
        source="[1] eq. 6.2",
    )
    a1: Scalar = quantity("1", "Coefficient of the gyro's previous output.", default=-0.9805, source="[1] eq. 6.2")
    a2: Scalar = quantity(
        "1", "Coefficient of the gyro's output two samples ago.", default=0.2898, source="[1] eq. 6.2"
    )
    normalised: bool = option(
        "True to use b0 = 1 + a1 + a2, so that a constant rate stays unchanged.", default=True, choices=(True, False)
    )

    def section(self) -> Section:
        """Return the compensator as a difference equation."""
        b0 = 1 + self.a1 + self.a2 if self.normalised else self.b0
        return Section(b0=1 / b0, b1=self.a1 / b0, b2=self.a2 / b0)

    def start(self, y: Any) -> CompensatorState:
        """Return the compensator's state for a measured rate y that has been constant for all time."""
        return CompensatorState(y1=jnp.asarray(y), y2=jnp.asarray(y))

    def compensate(self, state: CompensatorState, y: Any) -> tuple[CompensatorState, Any]:
        """Return the next state, and the compensated rate for the newest measured rate y."""
        s = self.section()
        return CompensatorState(y1=y, y2=state.y1), s.b0 * y + s.b1 * state.y1 + s.b2 * state.y2


@record
class CompensatedState:
    """State of the gyro compensator and of the navigation that uses its output. Source: this module."""

    compensator: CompensatorState = part("State of the gyro compensator.")
    rate: Any = quantity("rad/s", "Last compensated angular velocity.", frame="B", shape=(3,))
    last: Scalar = quantity("100 ns", "Time at which the last gyro sample was measured.", kind="time")
    navigation: Any = part("State of the navigation.")


@record
class CompensatedInertial:
    """Aided inertial navigation with any filter, with each gyro sample compensated for the gyro's dynamics first.

    The first sample, and a sample after a gap, restart the compensator as if the rate had been constant for all time.
    Samples that are late, repeated or not finite pass unchanged, because the navigation rejects them.

    Valid:   for samples at the compensator's sampling rate. If the time between samples exceeds `gap`, nothing is
             compensated.
    Source:  [1] sections 6.2.1.3 and 6.2.1.5, table 6.6.
    """

    navigation: Any = part("Navigation that uses the compensated samples.", default=AidedInertialFeedforward())
    compensator: GyroCompensator = part("Compensator: inverse of the gyro's dynamics.", default=GyroCompensator())
    gap: Scalar = quantity(
        "100 ns", "Longest time between samples that does not restart the compensator.", default=ms(10), kind="time"
    )

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors that the navigation reads."""
        return self.navigation.listens

    def check(self) -> None:
        """Raise InputError if the navigation's settings are invalid."""
        self.navigation.check()

    def init(self, key: Key) -> CompensatedState:
        """Return the initial state of compensator and navigation, before any measurement."""
        o = jnp.zeros(3)
        return CompensatedState(
            compensator=self.compensator.start(o), rate=o, last=np.int64(NEVER), navigation=self.navigation.init(key)
        )

    def step(self, t: Any, state: CompensatedState, frame: Frame) -> tuple[CompensatedState, Estimate]:
        """Return the new state and the navigation's estimate at integer time t."""
        name = self.navigation.intake.imu
        sample = frame.samples[name]
        y = sample.value.angular_rate
        sound = jnp.all(jnp.isfinite(y))
        new = sample.fresh & sample.valid & (sample.t > state.last) & (sample.t <= t)
        follows = sample.t - state.last <= self.gap
        before = tree_where(follows, state.compensator, self.compensator.start(y))
        memory, rate = self.compensator.compensate(before, y)
        passed_rate = jnp.where(new, jnp.where(sound, rate, y), y)
        frame = replace(
            frame,
            samples={**frame.samples, name: replace(sample, value=replace(sample.value, angular_rate=passed_rate))},
        )
        inner, estimate = self.navigation.step(t, state.navigation, frame)
        use = new & sound
        new_state = CompensatedState(
            compensator=tree_where(use, memory, state.compensator),
            rate=jnp.where(use, rate, state.rate),
            last=jnp.where(use, sample.t, state.last),
            navigation=inner,
        )
        return new_state, estimate
