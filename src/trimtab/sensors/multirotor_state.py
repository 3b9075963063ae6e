"""State of a multirotor as measured, with noise, by a motion capture system, a gyro and the rotor controllers."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.record import imperfection, period, record
from trimtab.core.rng import Key, normals
from trimtab.core.signals import Sample, new_sample
from trimtab.core.time import ms
from trimtab.vehicles.quadrotor import MultirotorState


@record
class MultirotorStateSensor:
    """Sensor of position, velocity, attitude, angular rate and rotor speeds, each with white noise.

        z = (p + n, v + n, q exp(n), w + n, w_i + n)

    p, v, q, w and w_i are position, velocity, attitude, angular rate and rotor speeds. n is white noise, drawn
    separately for each value. The attitude noise is a small rotation about a random axis, so the measured quaternion
    has unit length.

    Frames:  those of the state.    Not modelled: biases, filter lags, cameras that lose sight of the vehicle.
    Source:  docs page, Multirotor state. The sizes of the errors are our own choice, typical of a motion capture
             system.
    """

    position_noise: Any = imperfection(
        "m", "Standard deviation of the noise of each position coordinate.", "position-noise", default=0.002
    )
    velocity_noise: Any = imperfection(
        "m/s", "Standard deviation of the noise of each velocity component.", "velocity-noise", default=0.02
    )
    attitude_noise: Any = imperfection(
        "rad", "Standard deviation of the attitude noise about each axis.", "attitude-noise", default=0.004
    )
    rate_noise: Any = imperfection(
        "rad/s", "Standard deviation of the noise of each angular rate.", "rate-noise", default=0.02
    )
    speed_noise: Any = imperfection(
        "rad/s", "Standard deviation of the noise of each rotor's speed.", "rotor-speed-noise", default=2.0
    )
    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "state"

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, x: MultirotorState) -> MultirotorState:
        """Return the measurement h(x): the state, with its quaternion normalised."""
        return MultirotorState(x.position, x.velocity, quaternion.normalise(x.attitude), x.rate, x.rotor_speed)

    def step(self, t: Any, state: Key, x: MultirotorState) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true = self.measure(x)
        n = jnp.shape(x.rotor_speed)[0]
        noise = normals(state, t // self.period, 12 + n)
        reading = MultirotorState(
            position=true.position + self.position_noise * noise[0:3],
            velocity=true.velocity + self.velocity_noise * noise[3:6],
            attitude=quaternion.retract(true.attitude, self.attitude_noise * noise[6:9]),
            rate=true.rate + self.rate_noise * noise[9:12],
            rotor_speed=true.rotor_speed + self.speed_noise * noise[12:],
        )
        return state, new_sample(t, reading)
