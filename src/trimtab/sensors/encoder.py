"""An optical encoder on a vertical shaft: the heading of what turns, in counts."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms


@record
class AngleReading:
    """What an encoder gives. Frames: clockwise from above, from where it reads zero. Source: docs page, Encoder."""

    angle: Scalar = quantity("rad", "Angle; unwrapped.", kind="angle")
    count: Scalar = quantity("1", "Counts since zero, the whole ones passed.", kind="count")


@record
class Encoder:
    """Incremental optical encoder of a shaft that turns with the vehicle, decoded and counted without loss.

        h = psi - psi_0,    count = floor( (h + e sin(h)) N/(2 pi) ),    z = (count + 1/2) 2 pi/N

    The angle is the middle of the count, so that its error has no mean; e is the disc's eccentricity.

    Frames:  angle positive as the heading, clockwise from above.    Not modelled: lost counts, play.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.2.1: 4096 counts in a turn.
    """

    counts: Scalar = quantity(
        "1",
        "Counts in a turn; 0: no steps.",
        default=4096.0,
        low=0,
        source="[1] section 6.2.1",
        off={"encoder-quantisation": 0.0},
    )
    zero: Scalar = quantity("rad", "Heading at which it reads zero.", kind="angle", default=0.0)
    eccentricity: Scalar = quantity(
        "rad", "Greatest error of a disc off its centre.", default=0.0, low=0, off={"encoder-eccentricity": 0.0}
    )
    period: int = period("Time between samples.", default=ms(1))

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, motion: Motion) -> AngleReading:
        """The measurement h(x) of a motion, without steps; the count is left at zero."""
        return AngleReading(angle=motion.attitude[2] - self.zero, count=jnp.asarray(0, np.int32))

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """The sample at integer time t."""
        true = self.measure(motion).angle
        shifted = true + self.eccentricity * jnp.sin(true)
        coarse = self.counts > 0
        grain = 2 * math.pi / jnp.where(coarse, self.counts, 1.0)
        count = jnp.floor(shifted / grain)
        angle = jnp.where(coarse, (count + 0.5) * grain, shifted)
        reading = AngleReading(angle=angle, count=jnp.where(coarse, count, 0.0).astype(np.int32))
        return state, new_sample(t, reading)
