"""Sensors of an underwater vehicle without position fixes: depth, attitude, rates, speed over the bottom."""

from typing import Any

from trimtab.core.record import Scalar, imperfection, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms


@record
class DiveReading:
    """Sample of the dive sensors: depth, attitude, rates and speed.

    Frames:  depth and attitude in W, the rest in B.
    Source:  docs page, Dive.
    """

    depth: Scalar = quantity("m", "Depth below the origin of W.", frame="W")
    roll: Scalar = quantity("rad", "Roll angle, starboard down.", kind="angle")
    pitch: Scalar = quantity("rad", "Pitch angle, nose up.", kind="angle")
    heading: Scalar = quantity("rad", "Heading of the nose from north, clockwise.", kind="angle")
    surge_velocity: Scalar = quantity("m/s", "Speed over the bottom along the body's x axis.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate, about the body's y axis.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate, about the body's z axis.", frame="B")


@record
class DiveSensor:
    """Pressure gauge, attitude unit and Doppler log in one sensor. Each value has white noise, zero by default.

        z = (depth, roll, pitch, heading, u, q, r) + w

    u is the speed over the bottom, q the pitch rate, r the yaw rate and w white noise.

    Frames:  W north-east-down; B at the centre of mass, where the gauge and the log are assumed to be.
    Not modelled: errors correlated in time, loss of bottom lock of the log, effect of tides on the gauge.
    Source:  own derivation: the kinematics of a rigid body, docs page, Conventions.
    """

    depth_noise: Scalar = imperfection("m", "Standard deviation of the noise of each depth sample.", "navigation-error")
    attitude_noise: Scalar = imperfection(
        "rad", "Standard deviation of the noise of each roll and pitch sample.", "navigation-error"
    )
    heading_noise: Scalar = imperfection(
        "rad", "Standard deviation of the noise of each heading sample.", "navigation-error"
    )
    velocity_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the noise of each speed sample of the Doppler log.", "navigation-error"
    )
    rate_noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the noise of each pitch and yaw rate sample.", "navigation-error"
    )
    period: int = period("Time between samples.", default=ms(50))

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> DiveReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        roll, pitch, heading = motion.attitude[0], motion.attitude[1], motion.attitude[2]
        rates = motion.w_WB_B
        return DiveReading(motion.p_WB[2], roll, pitch, heading, motion.v_WB_B[0], rates[1], rates[2])

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        x, k = self.measure(motion), t // self.period
        (w0, w1), (w2, w3), (w4, w5), (w6, _) = (normal2(state, k, stream) for stream in range(4))
        reading = DiveReading(
            depth=x.depth + self.depth_noise * w0,
            roll=x.roll + self.attitude_noise * w1,
            pitch=x.pitch + self.attitude_noise * w2,
            heading=x.heading + self.heading_noise * w3,
            surge_velocity=x.surge_velocity + self.velocity_noise * w4,
            pitch_rate=x.pitch_rate + self.rate_noise * w5,
            yaw_rate=x.yaw_rate + self.rate_noise * w6,
        )
        return state, new_sample(t, reading)
