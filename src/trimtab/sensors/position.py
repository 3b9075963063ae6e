"""Sensors that give a position: a direct one, noisy and late, and an encoder whose arm is known.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace
from trimtab.core.rng import Key, normal2
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms, seconds
from trimtab.sensors.encoder import Encoder
from trimtab.sensors.late_fix import LateFix, LateSensorState


@record
class PositionReading:
    """A measured position. Source: docs page, Position."""

    north: Scalar = quantity("m", "Along the world's x axis.", frame="W")
    east: Scalar = quantity("m", "Along the world's y axis.", frame="W")


@record
class PositionSensor:
    """A position as some other system gives it: noisy, now and then, and late.

        z = (p + R_WB l)_north,east + w

    It stands for the fixes of an ultrasonic network, without its ranges.

    Frames:  lever arm in B, position in W.    Not modelled: errors that hang together in time or with the place.
    Source:  [1] section 6.2.1. Latency reconstructed, see docs Errata.
    """

    noise: Scalar = imperfection(
        "m", "Standard deviation of each coordinate of each measurement.", "position-noise", default=0.0044
    )
    lever_arm: Any = quantity("m", "Of the point located.", frame="B", default=(0.0, 0.0, 0.0), shape=(3,))
    timing: LateFix = part(
        "When it is measured and comes out.",
        default=LateFix(),
        off={"position-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    period: int = period("How often it is looked whether one has come out.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Refuse a period at which measurements would be missed."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> LateSensorState:
        """Nothing measured."""
        o = jnp.asarray(0.0)
        return LateSensorState(key, self.timing.initial_state(PositionReading(o, o)))

    def measure(self, motion: Motion) -> PositionReading:
        """The measurement h(x) of a motion, without noise."""
        p = motion.p_WB + from_euler(*motion.attitude) @ jnp.asarray(self.lever_arm)
        return PositionReading(north=p[0], east=p[1])

    def step(self, t: Any, state: LateSensorState, motion: Motion) -> tuple[LateSensorState, Sample]:
        """The newest position that is out at integer time t."""
        true, (wn, we) = self.measure(motion), normal2(state.key, self.timing.measurement_number(t))
        reading = PositionReading(true.north + self.noise * wn, true.east + self.noise * we)
        late, sample = self.timing.deliver(t, state.late, reading)
        return LateSensorState(state.key, late), sample


@record
class EncoderPosition:
    """The place of an arm's end out of the encoder on its shaft.

        z = R (cos al, sin al)

    Frames:  W, origin on the shaft; al is what the encoder reads, the direction of the arm.
    Not modelled: a shaft that leans; it shifts the place by 1 - cos of that angle.
    Source:  [1] section 6.2.1.
    """

    encoder: Encoder = part("On the shaft.", default=Encoder(zero=math.pi / 2, period=seconds(1)))
    arm: Scalar = quantity("m", "From the shaft to the body.", default=0.3048, low=0, source="[1] 12 in")

    @property
    def period(self) -> int:
        """That of the encoder."""
        return self.encoder.period

    def init(self, key: Key) -> Any:
        """State of the encoder."""
        return self.encoder.init(key)

    def measure(self, motion: Motion) -> PositionReading:
        """The measurement h(x) of a motion, without steps."""
        return self._arm_end(self.encoder.measure(motion).angle)

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Sample]:
        """The sample at integer time t."""
        state, sample = self.encoder.step(t, state, motion)
        return state, new_sample(t, self._arm_end(sample.value.angle))

    def _arm_end(self, angle: Any) -> PositionReading:
        return PositionReading(north=self.arm * jnp.cos(angle), east=self.arm * jnp.sin(angle))
