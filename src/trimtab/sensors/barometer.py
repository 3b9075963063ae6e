"""Barometer: pressure at a vehicle's static port, and the height in the standard atmosphere computed from it."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.signals import Motion, Sample, new_sample, surrounding_air
from trimtab.core.time import ms, to_seconds
from trimtab.environment.atmosphere import pressure_altitude, standard_atmosphere


@record
class PressureReading:
    """Sample of a barometer. Source: docs page, Sensors for three dimensions."""

    pressure: Scalar = quantity("Pa", "Pressure at the static port.")
    altitude: Scalar = quantity("m", "Height above sea level, computed from the pressure by the standard atmosphere.")


@record
class BarometerState:
    """State of a barometer. Source: docs page, Sensors for three dimensions."""

    key: Key = part("Key of the random number generator for the noise.")
    offset: Scalar = quantity("Pa", "Zero error of the sensor, including its drift.")
    lagged: Scalar = quantity("Pa", "Pressure at the sensor, after the lag of port and tube.")
    started: Scalar = quantity("1", "True once the first sample has been taken.", kind="flag")


@record
class Barometer:
    """Barometer behind a static port. It measures the pressure of the standard atmosphere at the vehicle.

        z = Q( L(p(h) + e q) + b + w ),   b = b_turn_on + walk

    with q the dynamic pressure, e the static port's error, L a lag of first order, w white noise, Q the quantisation.

    Frames:  height above sea level from `motion.air`, or -down if the vehicle has no air model.
    Not modelled: weather (an offset of some hundred Pa can represent it), temperature deviation, position of the port.
    Source:  U.S. Standard Atmosphere 1976; Gracey, "Measurement of aircraft speed and altitude", NASA RP-1046, 1980,
             for the form of the errors. The default sizes are our own choice, typical of data sheets of micromachined
             barometers.
    """

    noise: Scalar = imperfection(
        "Pa", "Standard deviation of the noise of each sample.", "barometer-noise", default=2.0
    )
    turn_on_bias: Scalar = imperfection(
        "Pa", "Standard deviation of the zero error, drawn for each run.", "barometer-bias", default=50.0
    )
    drift: Scalar = imperfection("Pa/s^0.5", "Random walk density of the zero error.", "barometer-drift", default=0.2)
    lag: Scalar = imperfection(
        "s", "Time constant of the pressure lag in the static port and its tube.", "barometer-lag", default=0.05
    )
    static_error: Scalar = imperfection(
        "1",
        "Error of the static port: fraction of the dynamic pressure that is added to the static pressure.",
        "static-port-error",
        default=0.02,
        low=None,
    )
    resolution: Scalar = imperfection(
        "Pa", "Quantisation step of the analogue-to-digital converter.", "barometer-quantisation", default=1.0
    )
    period: int = period("Time between samples.", default=ms(20))

    def init(self, key: Key) -> BarometerState:
        """Return the initial state, with the zero error drawn for this run."""
        bias = self.turn_on_bias * normals(key.at("unit"), 0, 1)[0]
        return BarometerState(key.at("noise"), bias, jnp.zeros(()), jnp.zeros((), np.bool_))

    def measure(self, motion: Motion) -> PressureReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        return _reading(standard_atmosphere(surrounding_air(motion).height).pressure)

    def step(self, t: Any, state: BarometerState, motion: Motion) -> tuple[BarometerState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        air, dt = surrounding_air(motion), to_seconds(self.period)
        around = standard_atmosphere(air.height)
        through = motion.v_WB_B - air.velocity
        port = around.pressure + self.static_error * around.density * (through @ through) / 2
        share = jnp.where(state.started, 1 - jnp.exp(-dt / jnp.maximum(self.lag, 1e-9)), 1.0)
        lagged = state.lagged + share * (port - state.lagged)
        z = normals(state.key, t // self.period, 2)
        offset = state.offset + self.drift * math.sqrt(dt) * z[0] * state.started
        step = jnp.where(self.resolution > 0, self.resolution, 1.0)
        raw = lagged + offset + self.noise * z[1]
        pressure = jnp.where(self.resolution > 0, jnp.floor(raw / step + 0.5) * step, raw)
        new = BarometerState(state.key, offset, lagged, jnp.ones((), np.bool_))
        return new, new_sample(t, _reading(pressure))


def _reading(pressure: Any) -> PressureReading:
    return PressureReading(pressure=pressure, altitude=pressure_altitude(pressure))
