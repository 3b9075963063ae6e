"""An angular accelerometer: the pitch acceleration, in which the bending of a vehicle shows."""

from typing import Any

from trimtab.core.record import Scalar, imperfection, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms


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

    noise: Scalar = imperfection(
        "rad/s^2", "Standard deviation of each sample.", "angular-accelerometer-noise", default=0.01, source="chosen"
    )
    scale_factor: Scalar = imperfection("1", "Error of the scale.", "angular-accelerometer-scale-factor", low=None)
    offset: Scalar = imperfection("rad/s^2", "Error of the zero.", "angular-accelerometer-offset", low=None)
    period: int = period("Time between samples.", default=ms(5))

    def init(self, key: Key) -> Key:
        """The noise's key is all that it keeps."""
        return key

    def measure(self, motion: Motion) -> AngularAccelerationReading:
        """The measurement h(x) of a motion, without error."""
        return AngularAccelerationReading(pitch_acceleration=motion.alpha_WB_B[1])

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """The sample at integer time t."""
        w, _ = normal2(state, t // self.period)
        output = (1 + self.scale_factor) * self.measure(motion).pitch_acceleration + self.offset + self.noise * w
        return state, new_sample(t, AngularAccelerationReading(pitch_acceleration=output))
