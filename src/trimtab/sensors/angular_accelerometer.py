"""An angular accelerometer: the pitch acceleration, in which the bending of a vehicle shows."""

import math
from typing import Any

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms, to_seconds


@record
class AngularAccelerationReading:
    """What an angular accelerometer gives. Frames: about the body's y axis. Source: docs page of the sensor."""

    pitch_acceleration: Scalar = quantity("rad/s^2", "Acceleration of the pitch, nose up.", frame="B")


@record
class AngularAccelerometer:
    """Angular accelerometer about the pitch axis, white noise on each sample.

        z = (1 + s) Q' + b + w

    with scale error s, offset b and white noise w. The default is 5e-7 (rad/s^2)^2/Hz at 200 samples a second, against
    a signal of 0.2 to 0.3 rad/s^2.

    Frames:  positive nose up.    Not modelled: bandwidth, bending at the place where it sits, saturation.
    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206. Its noise is not printed: chosen here, see docs page.
    """

    noise: Scalar = quantity(
        "rad/s^2",
        "Standard deviation of each sample.",
        default=0.01,
        low=0,
        source="chosen",
        off={"angular-accelerometer-noise": 0.0},
    )
    scale_factor: Scalar = quantity(
        "1", "Error of the scale.", default=0.0, off={"angular-accelerometer-scale-factor": 0.0}
    )
    offset: Scalar = quantity("rad/s^2", "Error of the zero.", default=0.0, off={"angular-accelerometer-offset": 0.0})
    period: int = period("Time between samples.", default=ms(5))

    @classmethod
    def of_density(cls, density: float, sampling: int = ms(5)) -> "AngularAccelerometer":
        """One whose white noise has this power spectral density ((rad/s^2)^2/Hz, two-sided) at this period."""
        return cls(noise=math.sqrt(density / to_seconds(sampling)), period=sampling)

    def init(self, key: Key) -> Key:
        """The noise's key is all that it keeps."""
        return key

    def measure(self, motion: Motion) -> AngularAccelerationReading:
        """The measurement h(x) of a motion, without error."""
        return AngularAccelerationReading(pitch_acceleration=motion.alpha_WB_B[1])

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """The sample at integer time t."""
        w, _ = normal2(state, t // self.period)
        seen = (1 + self.scale_factor) * self.measure(motion).pitch_acceleration + self.offset + self.noise * w
        return state, new_sample(t, AngularAccelerationReading(pitch_acceleration=seen))
