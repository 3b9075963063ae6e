"""Position sensors: one that measures the position with noise and latency, and an encoder on the shaft of an arm.

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
    """Sample of a measured position. Source: docs page, Position."""

    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W")
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W")


@record
class PositionSensor:
    """Sensor of the horizontal position with noise, a measurement interval and latency.

        z = (p + R_WB l)_north,east + w

    p is the vehicle's position, l the lever arm and w white noise. The sensor represents the position fixes of an
    ultrasonic network. The ranges to the beacons are not modelled.

    Frames:  lever arm in B, position in W.    Not modelled: errors correlated in time or in space.
    Source:  [1] section 6.2.1. The latency is reconstructed, see docs Errata.
    """

    noise: Scalar = imperfection(
        "m", "Standard deviation of the noise of each measured coordinate.", "position-noise", default=0.0044
    )
    lever_arm: Any = quantity(
        "m", "Position in B of the point whose position is measured.", frame="B", default=(0.0, 0.0, 0.0), shape=(3,)
    )
    timing: LateFix = part(
        "Timing of the measurements: interval, latency and time stamp.",
        default=LateFix(),
        off={"position-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    period: int = period("Time between checks for a new measurement.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the period is too long to catch every measurement."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> LateSensorState:
        """Return the initial state, before any measurement."""
        o = jnp.asarray(0.0)
        return LateSensorState(key, self.timing.initial_state(PositionReading(o, o)))

    def measure(self, motion: Motion) -> PositionReading:
        """Return the measurement h(x) for the vehicle's motion, without noise."""
        p = motion.p_WB + from_euler(*motion.attitude) @ jnp.asarray(self.lever_arm)
        return PositionReading(north=p[0], east=p[1])

    def step(self, t: Any, state: LateSensorState, motion: Motion) -> tuple[LateSensorState, Sample]:
        """Return the newest position that has arrived at time t (unit: 100 ns)."""
        true, (wn, we) = self.measure(motion), normal2(state.key, self.timing.measurement_number(t))
        reading = PositionReading(true.north + self.noise * wn, true.east + self.noise * we)
        late, sample = self.timing.deliver(t, state.late, reading)
        return LateSensorState(state.key, late), sample


@record
class EncoderPosition:
    """Position of the end of an arm, computed from the encoder on the arm's shaft.

        z = R (cos al, sin al)

    Frames:  W, origin on the shaft; R is the length of the arm, al the encoder's reading: the direction of the arm.
    Not modelled: a tilted shaft, which shifts the position by up to R (1 - cos(tilt)).
    Source:  [1] section 6.2.1.
    """

    encoder: Encoder = part("Encoder on the shaft of the arm.", default=Encoder(zero=math.pi / 2, period=seconds(1)))
    arm: Scalar = quantity(
        "m", "Length of the arm, from the shaft to the body.", default=0.3048, low=0, source="[1] 12 in"
    )

    @property
    def period(self) -> int:
        """Return the encoder's period."""
        return self.encoder.period

    def init(self, key: Key) -> Any:
        """Return the initial state of the encoder."""
        return self.encoder.init(key)

    def measure(self, motion: Motion) -> PositionReading:
        """Return the measurement h(x) for the vehicle's motion, without quantisation."""
        return self._arm_end(self.encoder.measure(motion).angle)

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        state, sample = self.encoder.step(t, state, motion)
        return state, new_sample(t, self._arm_end(sample.value.angle))

    def _arm_end(self, angle: Any) -> PositionReading:
        return PositionReading(north=self.arm * jnp.cos(angle), east=self.arm * jnp.sin(angle))
