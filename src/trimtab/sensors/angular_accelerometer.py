"""Angular accelerometer: measures the pitch acceleration, in which the bending of a vehicle is visible."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, tree_where
from trimtab.core.rng import Key, normal2
from trimtab.core.second_order import SectionState, filter_sample, low_pass, steady_state
from trimtab.core.signals import Bending, Motion, Sample, new_sample
from trimtab.core.time import format_time, ms, to_seconds

DELAYS = 16
"""Number of samples in the delay line. The longest possible delay is this number minus one, times the period."""


@record
class AngularAccelerationReading:
    """Sample of an angular accelerometer. Frames: about the body's y axis. Source: docs page, Angular accelerometer."""

    pitch_acceleration: Scalar = quantity("rad/s^2", "Pitch acceleration, nose up.", frame="B")


@record
class AngularAccelerometer:
    """Angular accelerometer about the pitch axis, with white noise on each sample.

        z = (1 + s) Q' + b + w

    with pitch acceleration Q', scale error s, offset b and white noise w. The default noise has a density of 5e-7
    (rad/s^2)^2/Hz at 200 samples a second. The signal is 0.2 to 0.3 rad/s^2.

    Frames:  positive nose up.    Not modelled: bandwidth, bending at the sensor's position, saturation.
    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206. [1] prints no noise, so the noise is our own choice (docs
             page).
    """

    noise: Scalar = imperfection(
        "rad/s^2",
        "Standard deviation of the noise of each sample.",
        "angular-accelerometer-noise",
        default=0.01,
        source="chosen",
    )
    scale_factor: Scalar = imperfection(
        "1", "Relative scale error of the sensor.", "angular-accelerometer-scale-factor", low=None
    )
    offset: Scalar = imperfection("rad/s^2", "Zero error of the sensor.", "angular-accelerometer-offset", low=None)
    period: int = period("Time between samples.", default=ms(5))

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> AngularAccelerationReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return AngularAccelerationReading(pitch_acceleration=motion.alpha_WB_B[1])

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        w, _ = normal2(state, t // self.period)
        output = (1 + self.scale_factor) * self.measure(motion).pitch_acceleration + self.offset + self.noise * w
        return state, new_sample(t, AngularAccelerationReading(pitch_acceleration=output))


@record
class AngularAccelerometerState:
    """State of an angular accelerometer. Source: docs page, Angular accelerometer."""

    key: Key = part("Key of the random number generator for the noise.")
    bias: Scalar = quantity("rad/s^2", "Zero error of the sensor in this run.")
    scale: Scalar = quantity("1", "Relative scale error of the sensor in this run.")
    band: SectionState = part("State of the low-pass filter.")
    line: Any = quantity(
        "rad/s^2", "Accelerations after the low-pass at the last samples, newest first.", shape=(DELAYS,)
    )
    started: Scalar = quantity("1", "True once the first sample has been taken.", kind="flag")


@record
class AngularAccelerometerUnit:
    """Angular accelerometer with errors, bandwidth and delay, mounted on a body that bends.

        z = (1 + s) D( L( Q' + phi1' eta1'' + phi2' eta2'' ) ) + b + w

    with pitch acceleration Q', scale error s and bias b drawn for each run, a low-pass L (second order, Butterworth), a
    delay D that is not part of the sample's time stamp, and slopes phi' of the bending modes at the sensor. The slopes
    are 0 at the place where the modes are assumed to be clamped.

    Frames:  positive nose up.    Not modelled: saturation, effects of linear acceleration and temperature.
    Source:  IEEE Std 671-1985 (inertial sensors) for the names of the errors. Their sizes are our own
             choice (docs, What it needs).
    """

    noise: Scalar = imperfection(
        "rad/s^2",
        "Standard deviation of the noise of each sample.",
        "angular-accelerometer-noise",
        default=0.01,
        source="chosen",
    )
    bias: Scalar = imperfection(
        "rad/s^2", "Standard deviation of the zero error, drawn for each run.", "angular-accelerometer-offset"
    )
    scale_factor: Scalar = imperfection(
        "1", "Standard deviation of the relative scale error, drawn for each run.", "angular-accelerometer-scale-factor"
    )
    bandwidth: Scalar = imperfection(
        "Hz", "Bandwidth (-3 dB) of the low-pass; 0: no low-pass.", "angular-accelerometer-bandwidth"
    )
    delay: Scalar = imperfection("s", "Delay from the motion to the sensor's output.", "angular-accelerometer-delay")
    slope1: Scalar = imperfection(
        "1/(slug ft)^1/2",
        "Slope of the mode shape of bending mode 1 at the sensor.",
        "angular-accelerometer-place",
        low=None,
    )
    slope2: Scalar = imperfection(
        "1/(slug ft)^1/2",
        "Slope of the mode shape of bending mode 2 at the sensor.",
        "angular-accelerometer-place",
        low=None,
    )
    period: int = period("Time between samples.", default=ms(5))

    def check(self) -> None:
        """Raise InputError if the bandwidth is too high for the period or the delay is too long."""
        tick = to_seconds(self.period)
        if not self.bandwidth < 0.5 / tick:
            problem = (
                f"a bandwidth of {self.bandwidth:g} Hz is too high for a sampling period of {format_time(self.period)}"
            )
            raise InputError("bandwidth", problem, fix=f"set bandwidth below {0.5 / tick:g} Hz, or to 0 for no limit")
        if not self.delay <= (DELAYS - 1) * tick:
            problem = f"the delay of {self.delay:g} s is longer than {DELAYS - 1} periods, the length of the delay line"
            raise InputError("delay", problem, fix=f"give a delay of at most {(DELAYS - 1) * tick:g} s")

    def init(self, key: Key) -> AngularAccelerometerState:
        """Return the initial state, with zero and scale errors drawn for this run."""
        zero = jnp.zeros(())
        b, s = normal2(key.at("unit"), 0)
        band = SectionState(zero, zero)
        off = jnp.zeros((), np.bool_)
        return AngularAccelerometerState(
            key.at("noise"), self.bias * b, self.scale_factor * s, band, jnp.zeros(DELAYS), off
        )

    def measure(self, motion: Motion) -> AngularAccelerationReading:
        """Return the measurement h(x) for the vehicle's motion at the sensor, without error."""
        felt = motion.alpha_WB_B[1]
        if isinstance(motion.bending, Bending):
            first, second = motion.bending.acceleration[0], motion.bending.acceleration[1]
            felt = felt + self.slope1 * first + self.slope2 * second
        return AngularAccelerationReading(pitch_acceleration=felt)

    def step(
        self, t: Any, state: AngularAccelerometerState, motion: Motion
    ) -> tuple[AngularAccelerometerState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        felt, tick = self.measure(motion).pitch_acceleration, to_seconds(self.period)
        section = low_pass(jnp.where(self.bandwidth > 0, self.bandwidth, 0.1 / tick), math.sqrt(0.5), tick)
        before = tree_where(state.started, state.band, steady_state(section, felt))
        band, passed = filter_sample(section, before, felt)
        passed = jnp.where(self.bandwidth > 0, passed, felt)
        line = jnp.concatenate([passed[None], jnp.where(state.started, state.line[:-1], passed)])
        back = jnp.clip(self.delay / tick, 0.0, DELAYS - 1.0)
        whole = jnp.minimum(jnp.floor(back), DELAYS - 2).astype(np.int32)
        share = back - whole
        late = (1 - share) * line[whole] + share * line[whole + 1]
        w, _ = normal2(state.key, t // self.period)
        output = (1 + state.scale) * late + state.bias + self.noise * w
        new = AngularAccelerometerState(state.key, state.bias, state.scale, band, line, jnp.ones((), np.bool_))
        return new, new_sample(t, AngularAccelerationReading(pitch_acceleration=output))
