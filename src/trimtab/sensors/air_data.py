"""Air data: airspeed from the pressure in a pitot tube, angles of attack and sideslip from vanes."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.signals import Motion, Sample, new_sample, surrounding_air
from trimtab.core.time import ms
from trimtab.environment.atmosphere import HEAT_RATIO, standard_atmosphere

ZERO = (0.0, 0.0, 0.0)
SEA_DENSITY = 1.225
"""Air density at sea level (kg/m³), U.S. Standard Atmosphere 1976; used for the equivalent airspeed."""


@record
class AirDataReading:
    """Sample of the air data probes. Source: docs page, Sensors for three dimensions."""

    impact_pressure: Scalar = quantity("Pa", "Impact pressure: pitot pressure minus static pressure.")
    equivalent_airspeed: Scalar = quantity(
        "m/s", "Equivalent airspeed: airspeed with the same dynamic pressure at sea-level density."
    )
    airspeed: Scalar = quantity(
        "m/s", "True airspeed, for the density of the standard atmosphere at the vehicle's height."
    )
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    beta: Scalar = quantity("rad", "Angle of sideslip.", kind="angle")


@record
class AirDataState:
    """State of the air data probes: their zero errors in this run. Source: docs page, Sensors for three dimensions."""

    key: Key = part("Key of the random number generator for the noise.")
    pressure_offset: Scalar = quantity("Pa", "Zero error of the pressure transducer.")
    vane_offset: Any = quantity(
        "rad", "Zero errors of the angle-of-attack vane and the sideslip vane.", kind="angle", shape=(2,)
    )


@record
class AirData:
    """Pitot tube and two vanes on a boom.

        v = v_WB - v_air + (w - w_air) × l          q_c = p ((1 + 0.2 M²)^3.5 - 1)
        alpha = (1 + k) atan2(v_z, v_x) + b + n,   beta = (1 + k) asin(v_y / |v|) + b + n

    k is a relative error, b a zero error and n white noise. Above Mach 1, q_c follows Rayleigh's formula, behind a
    normal shock. The airspeeds are computed from q_c by the same law, solved for M. Unlike an inertial velocity, the
    airspeeds include wind and turbulence.

    Frames:  velocities and position l of the boom in B; alpha from the velocity through the air to the x axis, in the
             x-z plane, positive nose up.
    Not modelled: pressure loss of an inclined tube, icing, lag of tubes and vanes.
    Source:  Gracey, "Measurement of aircraft speed and altitude", NASA RP-1046, 1980; NACA report 1135, eqs. 44 and
             100. The sizes of the errors are our own choice.
    """

    pressure_noise: Scalar = imperfection(
        "Pa", "Standard deviation of the pressure noise of each sample.", "air-data-pressure-noise", default=5.0
    )
    pressure_bias: Scalar = imperfection(
        "Pa",
        "Standard deviation of the transducer's zero error, drawn for each run.",
        "air-data-pressure-bias",
        default=10.0,
    )
    vane_noise: Scalar = imperfection(
        "rad", "Standard deviation of the vane noise of each sample.", "air-data-vane-noise", default=2e-3
    )
    vane_bias: Scalar = imperfection(
        "rad", "Standard deviation of a vane's zero error, drawn for each run.", "air-data-vane-bias", default=3e-3
    )
    upwash: Scalar = imperfection(
        "1",
        "Relative error k of the vane angles, caused by the deflection of the flow at the body.",
        "air-data-upwash",
        default=0.05,
        low=None,
    )
    position: Any = quantity(
        "m", "Position l of the probes in B.", frame="B", default=ZERO, shape=(3,), off={"air-data-position": ZERO}
    )
    period: int = period("Time between samples.", default=ms(20))

    def init(self, key: Key) -> AirDataState:
        """Return the initial state, with the zero errors drawn for this run."""
        draws = normals(key.at("unit"), 0, 3)
        return AirDataState(key.at("noise"), self.pressure_bias * draws[0], self.vane_bias * draws[1:])

    def measure(self, motion: Motion) -> AirDataReading:
        """Return the measurement h(x) for the vehicle's motion, without noise and zero errors."""
        air = surrounding_air(motion)
        around = standard_atmosphere(air.height)
        v = motion.v_WB_B - air.velocity + jnp.cross(motion.w_WB_B - air.rate, jnp.asarray(self.position))
        speed = jnp.sqrt(jnp.maximum(v @ v, 1e-12))
        q_c = impact_pressure(speed / around.sound_speed, around.pressure)
        beta = jnp.arcsin(jnp.clip(v[1] / speed, -1.0, 1.0))
        return _reading(q_c, around, jnp.arctan2(v[2], v[0]), beta)

    def step(self, t: Any, state: AirDataState, motion: Motion) -> tuple[AirDataState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, z = self.measure(motion), normals(state.key, t // self.period, 3)
        around = standard_atmosphere(surrounding_air(motion).height)
        q_c = true.impact_pressure + state.pressure_offset + self.pressure_noise * z[0]
        scale = 1 + self.upwash
        alpha = scale * true.alpha + state.vane_offset[0] + self.vane_noise * z[1]
        beta = scale * true.beta + state.vane_offset[1] + self.vane_noise * z[2]
        return state, new_sample(t, _reading(q_c, around, alpha, beta))


def impact_pressure(mach: Any, pressure: Any) -> Any:
    """Return pitot minus static pressure (Pa) at a Mach number and a static pressure (Pa).

    Source:  NACA report 1135, eqs. 44 and 100.
    """
    return pressure * (_pitot_ratio(mach) - 1)


def _pitot_ratio(mach: Any) -> Any:
    """Return the ratio of pitot to static pressure: isentropic below Mach 1, behind a normal shock above."""
    g, square = HEAT_RATIO, mach * mach
    fast = jnp.maximum(square, 1.0)
    slow = (1 + (g - 1) / 2 * jnp.minimum(square, 1.0)) ** (g / (g - 1))
    shock = ((g + 1) / 2 * fast) ** (g / (g - 1)) * ((g + 1) / (2 * g * fast - (g - 1))) ** (1 / (g - 1))
    return jnp.where(square > 1, shock, slow)


def mach_of_impact(ratio: Any) -> Any:
    """Return the Mach number for a ratio of impact to static pressure (Newton steps above Mach 1)."""
    g = HEAT_RATIO
    slow = jnp.sqrt(2 / (g - 1) * jnp.maximum((jnp.maximum(ratio, 0.0) + 1) ** ((g - 1) / g) - 1, 0.0))
    wanted = jnp.maximum(ratio + 1, _pitot_ratio(1.0))
    mach = jnp.maximum(1.0, jnp.sqrt(wanted / 1.288))
    for _ in range(6):
        here = _pitot_ratio(mach)
        slope = here * (2 * g / (g - 1) / mach - 4 * g * mach / (g - 1) / (2 * g * mach * mach - (g - 1)))
        mach = jnp.maximum(mach - (here - wanted) / slope, 1.0)
    return jnp.where(ratio + 1 > _pitot_ratio(1.0), mach, slow)


def _reading(q_c: Any, around: Any, alpha: Any, beta: Any) -> AirDataReading:
    airspeed = mach_of_impact(q_c / around.pressure) * around.sound_speed
    return AirDataReading(
        impact_pressure=q_c,
        equivalent_airspeed=airspeed * jnp.sqrt(around.density / SEA_DENSITY),
        airspeed=airspeed,
        alpha=alpha,
        beta=beta,
    )
