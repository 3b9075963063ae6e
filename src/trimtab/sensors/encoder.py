"""Encoder and tachometer on a vertical shaft: quantised shaft angle, and low-pass-filtered shaft rate.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.rotation import DEG
from trimtab.core.second_order import Section, SectionState, filter_sample, low_pass, steady_state
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import format_time, ms, to_seconds


@record
class AngleReading:
    """Sample of an encoder. Frames: angle clockwise from above, from the encoder's zero. Source: docs page, Encoder."""

    angle: Scalar = quantity("rad", "Shaft angle, unwrapped.", kind="angle")
    count: Scalar = quantity("1", "Number of whole encoder counts from zero.", kind="count")


@record
class Encoder:
    """Incremental optical encoder of a shaft that turns with the vehicle, decoded and counted without loss.

        h = psi - psi_0,    count = floor( (h + e sin(h)) N/(2 pi) ),    z = (count + 1/2) 2 pi/N

    psi is the heading, N the number of counts per turn. The reported angle z is the middle of the count, so that its
    mean error is zero; e is the disc's eccentricity.

    Frames:  angle positive as the heading, clockwise from above.    Not modelled: lost counts, play.
    Source:  [1] section 6.2.1: 4096 counts in a turn.
    """

    counts: Scalar = imperfection(
        "1",
        "Number of counts per turn of the shaft; 0: no quantisation.",
        "encoder-quantisation",
        default=4096.0,
        source="[1] section 6.2.1",
    )
    zero: Scalar = quantity("rad", "Heading at which the encoder reads zero.", kind="angle", default=0.0)
    eccentricity: Scalar = imperfection(
        "rad", "Largest angle error due to the disc's eccentricity.", "encoder-eccentricity"
    )
    period: int = period("Time between samples.", default=ms(1))

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, motion: Motion) -> AngleReading:
        """Return the measurement h(x) for the vehicle's motion, without quantisation. The count is zero."""
        return AngleReading(angle=motion.attitude[2] - self.zero, count=jnp.asarray(0, np.int32))

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true = self.measure(motion).angle
        shifted = true + self.eccentricity * jnp.sin(true)
        coarse = self.counts > 0
        grain = 2 * math.pi / jnp.where(coarse, self.counts, 1.0)
        count = jnp.floor(shifted / grain)
        angle = jnp.where(coarse, (count + 0.5) * grain, shifted)
        reading = AngleReading(angle=angle, count=jnp.where(coarse, count, 0.0).astype(np.int32))
        return state, new_sample(t, reading)


BESSEL4 = ((1.4301715599939, 0.5219345817), (1.6033574829, 0.8055382818))
"""Ratio of natural to -3 dB frequency, and quality factor, of each section of a fourth-order Bessel low-pass."""


@record
class RateReading:
    """Sample of a tachometer. Frames: positive clockwise from above. Source: docs page, Tachometer."""

    yaw_rate: Scalar = quantity("rad/s", "Yaw rate, positive clockwise from above.", frame="B")


@record
class TachometerState:
    """State of the tachometer: random key, and the two sections of its low-pass. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    started: Scalar = quantity("1", "True once the low-pass has received a sample.", kind="flag")
    first: SectionState = part("State of the low-pass filter's first section.")
    second: SectionState = part("State of the low-pass filter's second section.")


def bessel4(bandwidth: Any, sampling_period: Any) -> tuple[Section, Section]:
    """Return the two sections of a fourth-order Bessel low-pass with the -3 dB frequency `bandwidth` (Hz).

    Source: Zverev, "Handbook of filter synthesis", Bessel filters; sections by the bilinear transform, each exact at
    its natural frequency.
    """
    sections = [low_pass(over * bandwidth, 0.5 / quality, sampling_period) for over, quality in BESSEL4]
    return sections[0], sections[1]


@record
class Tachometer:
    """Tachometer of a shaft that turns with the vehicle, followed by a fourth-order Bessel low-pass.

        z = (1 + s) L(r) + b + w

    where r is the yaw rate, s and b are the scale and zero errors that remain after calibration, L is the low-pass and
    w white noise.

    Frames:  positive as the yaw rate, clockwise from above.    Not modelled: commutator ripple.
    Source:  [1] section 6.2.1. Noise: reconstructed to reproduce the rate comparison of [1], see docs Errata.
    """

    noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the noise of each sample.", "tachometer-noise", default=3.5 * DEG
    )
    scale_factor: Scalar = imperfection(
        "1", "Relative scale error that remains after calibration.", "tachometer-scale-factor", low=None
    )
    offset: Scalar = imperfection("rad/s", "Zero error that remains after calibration.", "tachometer-offset", low=None)
    bandwidth: Scalar = imperfection(
        "Hz",
        "Bandwidth (-3 dB) of the low-pass; 0: no low-pass.",
        "tachometer-bandwidth",
        default=5.0,
        source="[1] sec. 6.2.1",
    )
    period: int = period("Time between samples.", default=ms(1))

    def check(self) -> None:
        """Raise InputError unless the low-pass sections' frequencies are below half of the sampling rate."""
        most = 0.5 / to_seconds(self.period) / BESSEL4[1][0]
        if not self.bandwidth < most:
            problem = (
                f"a bandwidth of {self.bandwidth:g} Hz is too wide for a sampling period of {format_time(self.period)}"
            )
            raise InputError(
                "bandwidth",
                problem,
                fix=f"{argument('settings', 'VALUE', 'bandwidth')} with VALUE below {most:g} Hz, or 0",
            )

    def init(self, key: Key) -> TachometerState:
        """Return the initial state, before the low-pass has received a sample."""
        rest = SectionState(jnp.asarray(0.0), jnp.asarray(0.0))
        return TachometerState(key=key, started=jnp.asarray(False), first=rest, second=rest)

    def measure(self, motion: Motion) -> RateReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return RateReading(yaw_rate=motion.w_WB_B[2])

    def step(self, t: Any, state: TachometerState, motion: Motion) -> tuple[TachometerState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, dt = self.measure(motion).yaw_rate, to_seconds(self.period)
        narrow = self.bandwidth > 0
        sections = bessel4(jnp.where(narrow, self.bandwidth, 0.1 / dt), dt)
        memories, passed = [], true
        for section, memory in zip(sections, (state.first, state.second), strict=True):
            rest = steady_state(section, true)
            settled = jax.tree.map(lambda a, b: jnp.where(state.started, a, b), memory, rest)
            memory, passed = filter_sample(section, settled, passed)
            memories.append(memory)
        rate = jnp.where(narrow, passed, true)
        w, _ = normal2(state.key, t // self.period)
        output = (1 + self.scale_factor) * rate + self.offset + self.noise * w
        new = TachometerState(state.key, jnp.asarray(True), memories[0], memories[1])
        return new, new_sample(t, RateReading(yaw_rate=output))
