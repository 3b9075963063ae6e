"""Instruments of an aeroplane for its control laws: air data, attitude, rates and load factors, with errors."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms
from trimtab.environment.geodetic import STANDARD

CHANNELS = (
    "speed",
    "alpha",
    "beta",
    "altitude",
    "roll",
    "pitch",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
    "normal",
    "side",
)
"""Names of the measured values. Each value has its own bias and noise."""


@record
class FlightInstrumentsReading:
    """Sample of the flight instruments. Frames: W and B as in `Motion`. Source: docs page, Flight instruments."""

    speed: Scalar = quantity("m/s", "Airspeed. It equals the speed over the ground, because wind is not modelled.")
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    beta: Scalar = quantity("rad", "Sideslip angle.", kind="angle")
    altitude: Scalar = quantity("m", "Altitude above the origin of W.", frame="W")
    roll: Scalar = quantity("rad", "Bank angle.", frame="WB", kind="angle")
    pitch: Scalar = quantity("rad", "Pitch angle, nose up.", frame="WB", kind="angle")
    roll_rate: Scalar = quantity("rad/s", "Roll rate P.", frame="B")
    pitch_rate: Scalar = quantity("rad/s", "Pitch rate Q.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Yaw rate R.", frame="B")
    normal_load: Scalar = quantity("1", "Upward load factor in B: 1 in level flight.", frame="B")
    side_load: Scalar = quantity("1", "Load factor along the body's y axis, to starboard.", frame="B")


@record
class FlightInstrumentsState:
    """State of the flight instruments. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    bias: Any = quantity(
        "1", "Standard normal draws of the biases in this run, one for each measured value.", shape=(len(CHANNELS),)
    )


@record
class FlightInstruments:
    """Air data probe, vanes, attitude reference, gyros and accelerometers, each with a bias per run and white noise.

        V = |v|    alpha = atan2(w, u)    beta = asin(v/V)    (nx, ny, -nz) = (a + w' × l + w × (w × l) - g)/g

    (u, v, w) are the components of the velocity v. In the load factors, a is the acceleration, w the angular velocity,
    l the lever arm and g gravity.

    Frames:  as in `Motion`; the accelerometers are at `lever_arm` from the centre of mass.
    Not modelled: wind, lags of the probes, position error of the static port, drift of the gyros.
    Source:  docs page, Flight instruments. The sizes of the errors are our own choice.
    """

    lever_arm: Any = quantity(
        "m",
        "Position of the accelerometers relative to the centre of mass, in B.",
        frame="B",
        default=(0.0, 0.0, 0.0),
        shape=(3,),
    )
    gravity: Scalar = quantity(
        "m/s^2",
        "Acceleration of gravity by which accelerations are divided to give load factors.",
        default=STANDARD,
        above=0,
    )
    speed_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the airspeed noise of each sample.", "air-data-noise"
    )
    vane_noise: Scalar = imperfection(
        "rad", "Standard deviation of the noise of each angle of attack and sideslip sample.", "air-data-noise"
    )
    altitude_noise: Scalar = imperfection(
        "m", "Standard deviation of the altitude noise of each sample.", "air-data-noise"
    )
    attitude_noise: Scalar = imperfection(
        "rad", "Standard deviation of the noise of each roll and pitch sample.", "inertial-noise"
    )
    rate_noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the noise of each sample of roll, pitch and yaw rate.", "inertial-noise"
    )
    load_noise: Scalar = imperfection(
        "1", "Standard deviation of the noise of each load factor sample.", "inertial-noise"
    )
    speed_bias: Scalar = imperfection(
        "m/s", "Standard deviation of the airspeed bias, drawn for each run.", "air-data-bias"
    )
    vane_bias: Scalar = imperfection(
        "rad", "Standard deviation of the bias of angle of attack and sideslip, drawn for each run.", "air-data-bias"
    )
    altitude_bias: Scalar = imperfection(
        "m", "Standard deviation of the altitude bias, drawn for each run.", "air-data-bias"
    )
    attitude_bias: Scalar = imperfection(
        "rad", "Standard deviation of the bias of roll and pitch, drawn for each run.", "inertial-bias"
    )
    rate_bias: Scalar = imperfection(
        "rad/s", "Standard deviation of the bias of each rate, drawn for each run.", "inertial-bias"
    )
    load_bias: Scalar = imperfection(
        "1", "Standard deviation of the bias of each load factor, drawn for each run.", "inertial-bias"
    )
    period: int = period("Time between samples.", default=ms(10))

    def init(self, key: Key) -> FlightInstrumentsState:
        """Return the initial state, with the biases drawn for this run."""
        return FlightInstrumentsState(key.at("noise"), normals(key.at("bias"), 0, len(CHANNELS)))

    def measure(self, motion: Motion) -> FlightInstrumentsReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        v, w, arm = motion.v_WB_B, motion.w_WB_B, jnp.asarray(self.lever_arm)
        speed2 = v @ v
        speed = jnp.where(speed2 > 0, jnp.sqrt(jnp.where(speed2 > 0, speed2, 1.0)), 0.0)
        swing = jnp.cross(motion.alpha_WB_B, arm) + jnp.cross(w, jnp.cross(w, arm))
        down = from_euler(*motion.attitude)[2]
        load = (motion.a_WB_B + swing) / self.gravity - down
        return FlightInstrumentsReading(
            speed=speed,
            alpha=jnp.arctan2(v[2], v[0]),
            beta=jnp.arcsin(jnp.clip(v[1] / jnp.maximum(speed, 1e-9), -1, 1)),
            altitude=-motion.p_WB[2],
            roll=motion.attitude[0],
            pitch=motion.attitude[1],
            roll_rate=w[0],
            pitch_rate=w[1],
            yaw_rate=w[2],
            normal_load=-load[2],
            side_load=load[1],
        )

    def step(self, t: Any, state: FlightInstrumentsState, motion: Motion) -> tuple[FlightInstrumentsState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true = self.measure(motion)
        noise = self._sizes("noise") * normals(state.key, t // self.period, len(CHANNELS))
        e = noise + self._sizes("bias") * state.bias
        reading = FlightInstrumentsReading(
            speed=true.speed + e[0],
            alpha=true.alpha + e[1],
            beta=true.beta + e[2],
            altitude=true.altitude + e[3],
            roll=true.roll + e[4],
            pitch=true.pitch + e[5],
            roll_rate=true.roll_rate + e[6],
            pitch_rate=true.pitch_rate + e[7],
            yaw_rate=true.yaw_rate + e[8],
            normal_load=true.normal_load + e[9],
            side_load=true.side_load + e[10],
        )
        return state, new_sample(t, reading)

    def _sizes(self, kind: str) -> Any:
        """Return the standard deviations (11,) of the noise or the bias, in the order of CHANNELS."""
        groups = (("speed", 1), ("vane", 2), ("altitude", 1), ("attitude", 2), ("rate", 3), ("load", 2))
        sizes = [jnp.asarray(getattr(self, f"{group}_{kind}"), float) for group, _ in groups]
        return jnp.stack([size for size, (_, n) in zip(sizes, groups, strict=True) for _ in range(n)])
