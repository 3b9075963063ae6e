"""Sensors of a planar vehicle's velocity, heading and position: one without errors, and one with noise."""

from typing import Any

from trimtab.core.record import Scalar, imperfection, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms


@record
class PlanarPoseState:
    """Velocity, yaw rate, heading and position of a vehicle in the plane. Source: docs page, Conventions."""

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B")
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B")
    heading: Scalar = quantity(
        "rad", "Angle from north to the body's x axis, clockwise, not wrapped to one turn.", kind="angle"
    )
    north: Scalar = quantity("m", "Position along the world's x axis.", frame="W")
    east: Scalar = quantity("m", "Position along the world's y axis.", frame="W")


@record
class PlanarPose:
    """Ideal sensor of body velocity, yaw rate, heading and position, sampled every `period`.

        z = (surge velocity, sway velocity, yaw rate, heading, north, east)

    Frames:  velocity and yaw rate in B; heading of B in W, unwrapped; position in W.    Not modelled: any error.
    Source:  own derivation: the kinematics of a level floor, docs page, Conventions.
    """

    period: int = period("Time between samples.", default=ms(1))

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, motion: Motion) -> PlanarPoseState:
        """Return the measurement h(x) for the vehicle's motion."""
        return PlanarPoseState(
            surge_velocity=motion.v_WB_B[0],
            sway_velocity=motion.v_WB_B[1],
            yaw_rate=motion.w_WB_B[2],
            heading=motion.attitude[2],
            north=motion.p_WB[0],
            east=motion.p_WB[1],
        )

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        return state, new_sample(t, self.measure(motion))


@record
class NoisyPlanarPose:
    """Sensor of the planar pose with white noise, as from a navigation system that is corrected continuously.

        z = (surge velocity, sway velocity, yaw rate, heading, north, east) + w

    Frames:  velocity and yaw rate in B; heading of B in W, unwrapped; position in W.
    Not modelled: errors correlated in time, such as those of a system that is corrected at intervals.
    Source:  own derivation. The sizes of the errors are our own choice.
    """

    position_noise: Scalar = imperfection(
        "m", "Standard deviation of the noise of each position coordinate.", "navigation-error", default=0.01
    )
    velocity_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the velocity noise along each axis.", "navigation-error", default=0.003
    )
    heading_noise: Scalar = imperfection(
        "rad", "Standard deviation of the heading noise.", "navigation-error", default=0.005
    )
    rate_noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the yaw rate noise.", "navigation-error", default=0.005
    )
    period: int = period("Time between samples.", default=ms(5))

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> PlanarPoseState:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return PlanarPose().measure(motion)

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        x, k = self.measure(motion), t // self.period
        (u, v), (r, psi), (n, e) = (normal2(state, k, stream) for stream in range(3))
        noisy = PlanarPoseState(
            surge_velocity=x.surge_velocity + self.velocity_noise * u,
            sway_velocity=x.sway_velocity + self.velocity_noise * v,
            yaw_rate=x.yaw_rate + self.rate_noise * r,
            heading=x.heading + self.heading_noise * psi,
            north=x.north + self.position_noise * n,
            east=x.east + self.position_noise * e,
        )
        return state, new_sample(t, noisy)
