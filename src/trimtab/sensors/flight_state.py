"""Sensors of a flight in the vertical plane, of the input that acts on the vehicle, and of the vehicle's true state.

[1] is "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, period, quantity, record
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms
from trimtab.vehicles.hypersonic import HypersonicState


@record
class FlightReading:
    """Measured flight state in the vertical plane. Frames: W, pitch rate in B. Source: docs page, Flight state."""

    altitude: Scalar = quantity("m", "Altitude above the origin of W.", frame="W")
    climb: Scalar = quantity("m/s", "Climb rate.", frame="W")
    speed: Scalar = quantity("m/s", "Speed along the path. It equals the airspeed, because wind is not modelled.")
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate, nose up.", frame="B")


@record
class FlightStateSensor:
    """Sensor of the flight state in the vertical plane. Each value has white noise, zero by default.

        z = (h, h', V, alpha, Q) + w

    The values are altitude, climb rate, speed, angle of attack and pitch rate. [1] assumes that these five values are
    measured without error. Only the bending modes have no sensor.

    Frames:  W north-east-down, altitude is -down; alpha from the body's x axis to the velocity.
    Not modelled: wind, lags, position errors of the probes.
    Source:  [1], the measured part of the state.
    """

    altitude_noise: Scalar = imperfection(
        "m", "Standard deviation of the altitude noise of each sample.", "flight-altitude-noise"
    )
    climb_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the climb rate noise of each sample.", "flight-climb-noise"
    )
    speed_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the speed noise of each sample.", "flight-speed-noise"
    )
    alpha_noise: Scalar = imperfection(
        "rad", "Standard deviation of the angle-of-attack noise of each sample.", "flight-alpha-noise"
    )
    pitch_rate_noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the pitch rate noise of each sample.", "flight-pitch-rate-noise"
    )
    period: int = period("Time between samples.", default=ms(5))

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> FlightReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        u, v, w = motion.v_WB_B[0], motion.v_WB_B[1], motion.v_WB_B[2]
        roll, pitch = motion.attitude[0], motion.attitude[1]
        return FlightReading(
            altitude=-motion.p_WB[2],
            climb=jnp.sin(pitch) * u - jnp.cos(pitch) * (jnp.sin(roll) * v + jnp.cos(roll) * w),
            speed=jnp.sqrt(u * u + v * v + w * w),
            alpha=jnp.arctan2(w, u),
            pitch_rate=motion.w_WB_B[1],
        )

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, k = self.measure(motion), t // self.period
        w0, w1 = normal2(state, k, 0)
        w2, w3 = normal2(state, k, 1)
        w4, _ = normal2(state, k, 2)
        reading = FlightReading(
            altitude=true.altitude + self.altitude_noise * w0,
            climb=true.climb + self.climb_noise * w1,
            speed=true.speed + self.speed_noise * w2,
            alpha=true.alpha + self.alpha_noise * w3,
            pitch_rate=true.pitch_rate + self.pitch_rate_noise * w4,
        )
        return state, new_sample(t, reading)


@record
class ActingInput:
    """Ideal sensor of the input that acts on the vehicle, after limits and holds.

    It is sampled before a new command acts, so the sensor returns the input that has acted **since** the last command.
    A model-based estimator needs this input, which differs from the requested command when an actuator saturates.

    Frames:  those of the input.    Not modelled: noise, lag of the transducers.
    Source:  docs page, Acting input.
    """

    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "input"

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, u: Any) -> Any:
        """Return the vehicle's input record unchanged."""
        return u

    def step(self, t: Any, state: tuple[()], u: Any) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        return state, new_sample(t, self.measure(u))


@record
class TrueState:
    """Sensor of the vehicle's true state, for any state record. No such sensor exists in reality. Use this one only in
    ideal twins (scenarios without imperfections).

    Frames:  those of the state.    Not modelled: any error.
    Source:  docs page, True state.
    """

    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "state"

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, x: Any) -> Any:
        """Return the vehicle's state record unchanged."""
        return x

    def step(self, t: Any, state: tuple[()], x: Any) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        return state, new_sample(t, self.measure(x))


@record
class FlexibleTruthReading:
    """True flight state and bending modes of the hypersonic vehicle. Source: [1] eq. 4, elements of the vector e in
    this order."""

    h: Scalar = quantity("ft", "Altitude.", frame="W")
    h_rate: Scalar = quantity("ft/s", "Climb rate.", frame="W")
    V: Scalar = quantity("ft/s", "Speed along the path.")
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    q: Scalar = quantity("rad/s", "Pitch rate, nose up.", frame="B")
    eta1: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the modal displacement of bending mode 1.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Modal displacement of bending mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Rate of the modal displacement of bending mode 2.")


@record
class FlexibleTruth:
    """Sensor of the full state of `vehicles.hypersonic`. No real sensor measures the bending modes. Use this one only
    in ideal twins (scenarios without imperfections).

    Frames:  those of the state.
    Source:  [1], the full-state feedback used for comparison.
    """

    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "state"

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this sensor has no state."""
        return ()

    def measure(self, x: HypersonicState) -> FlexibleTruthReading:
        """Return the state, with the climb rate instead of the pitch angle."""
        climb = x.V * jnp.sin(x.theta - x.alpha)
        return FlexibleTruthReading(x.h, climb, x.V, x.alpha, x.q, x.eta1, x.eta1_rate, x.eta2, x.eta2_rate)

    def step(self, t: Any, state: tuple[()], x: HypersonicState) -> tuple[tuple[()], Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        return state, new_sample(t, self.measure(x))
