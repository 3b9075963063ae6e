"""Air at rest over the earth: the U.S. Standard Atmosphere 1976 to 86 km.

The temperature is piecewise linear in the geopotential height, and the pressure follows from the weight of the air
above. The lowest segment continues below sea level. Above 86 km, where the standard changes to separating mixtures, the
temperature stays constant. The density keeps falling, but is no longer that of the standard.

Source: NOAA, NASA, USAF, "U.S. Standard Atmosphere, 1976", NOAA-S/T 76-1562, part 1, tables 2 and 4, equations 18, 23,
33a, 33b, 42, 50 and 51. Deviation: the ratio of molecular weights near 86 km (table 8, 0.04 %) is assumed to be 1.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar

GRAVITY = 9.80665
"""Gravity in the definition of geopotential height, m/s²."""
GAS_CONSTANT = 8.31432e3 / 28.9644
"""Gas constant of air (J/(kg K)), with the standard's own constants."""
HEAT_RATIO = 1.4
EARTH_RADIUS = 6_356_766.0
"""Earth radius in the conversion from height to geopotential height (m)."""
SEA_PRESSURE = 101_325.0
SEA_TEMPERATURE = 288.15
BASES = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84_852.0])
"""Geopotential heights (m) at which the linear segments of the temperature begin."""
LAPSES = np.array([-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3, 0.0])
"""Slope of the temperature in each segment (K/m)."""
TEMPERATURES = SEA_TEMPERATURE + np.concatenate([[0.0], np.cumsum(np.diff(BASES) * LAPSES[:-1])])


def _base_pressures() -> Any:
    """Return the pressure at each of BASES (Pa): eqs. 33a and 33b, segment by segment."""
    p = [SEA_PRESSURE]
    for i, step in enumerate(np.diff(BASES)):
        T, lapse = TEMPERATURES[i], LAPSES[i]
        over = GRAVITY / GAS_CONSTANT
        ratio = np.exp(-over * step / T) if lapse == 0 else (T / TEMPERATURES[i + 1]) ** (over / lapse)
        p.append(p[-1] * ratio)
    return np.array(p)


PRESSURES = _base_pressures()


class AirProperties(NamedTuple):
    """Properties of air: temperature (K), pressure (Pa), density (kg/m³), speed of sound (m/s), viscosity (Pa s)."""

    temperature: Any
    pressure: Any
    density: Any
    sound_speed: Any
    viscosity: Any


def geopotential_height(height: Scalar) -> Any:
    """Return the geopotential height (m) of a height above sea level (m). Source: eq. 18."""
    return EARTH_RADIUS * height / (EARTH_RADIUS + height)


def standard_atmosphere(height: Scalar) -> AirProperties:
    """Return the properties of standard air at a height above sea level (m), without branches, for flight code."""
    H = geopotential_height(height)
    i = jnp.sum(jnp.asarray(BASES[1:]) <= H)
    base, lapse, T0, p0 = (jnp.asarray(table)[i] for table in (BASES, LAPSES, TEMPERATURES, PRESSURES))
    T = T0 + lapse * (H - base)
    level = lapse == 0
    over = GRAVITY / GAS_CONSTANT
    straight = -over * (H - base) / T0
    sloped = -over / jnp.where(level, 1.0, lapse) * jnp.log(T / T0)
    p = p0 * jnp.exp(jnp.where(level, straight, sloped))
    density = p / (GAS_CONSTANT * T)
    viscosity = 1.458e-6 * T * jnp.sqrt(T) / (T + 110.4)
    return AirProperties(T, p, density, jnp.sqrt(HEAT_RATIO * GAS_CONSTANT * T), viscosity)


def pressure_altitude(pressure: Scalar) -> Any:
    """Return the height above sea level (m) at which standard air has this pressure (Pa), for flight code.

    Source: eqs. 33a and 33b, and 18, solved for the height.
    """
    p = jnp.maximum(pressure, 1e-9)
    i = jnp.sum(jnp.asarray(PRESSURES[1:]) >= p)
    base, lapse, T0, p0 = (jnp.asarray(table)[i] for table in (BASES, LAPSES, TEMPERATURES, PRESSURES))
    level, over, fall = lapse == 0, GRAVITY / GAS_CONSTANT, jnp.log(p / p0)
    slope = jnp.where(level, 1.0, lapse)
    H = base + jnp.where(level, -fall * T0 / over, T0 * jnp.expm1(-fall * slope / over) / slope)
    return EARTH_RADIUS * H / (EARTH_RADIUS - H)
