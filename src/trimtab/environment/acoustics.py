"""The speed of sound in air, from its temperature, humidity, pressure and carbon dioxide."""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, quantity, record

ZERO_CELSIUS = 273.15
"""0 °C in K."""


@record
class Air:
    """Air at rest.

    Valid:   0 to 30 °C, 75 to 102 kPa, water vapour up to 6 %, carbon dioxide up to 1 % by volume.
    Source:  [1] O. Cramer, "The variation of the specific heat ratio and the speed of sound in air with temperature,
             pressure, humidity, and CO2 concentration", J. Acoust. Soc. Am. 93 (5), 1993, table III.
    """

    temperature: Scalar = quantity("K", "Temperature.", default=293.15, low=243.15, high=333.15)
    humidity: Scalar = quantity("1", "Relative humidity, 0 to 1.", default=0.5, low=0, high=1)
    pressure: Scalar = quantity("Pa", "Pressure.", default=101325.0, low=5e4, high=1.2e5)
    carbon_dioxide: Scalar = quantity("1", "Mole fraction of carbon dioxide.", default=4e-4, low=0, high=0.01)


def water_vapour(air: Air) -> Any:
    """Mole fraction of water vapour: humidity times enhancement factor times saturation pressure over pressure.

    Source: [1] appendix, from R. S. Davis, Metrologia 29, 1992 (the equation of the density of moist air).
    """
    T, p = air.temperature, air.pressure
    t = T - ZERO_CELSIUS
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t * t
    saturation = jnp.exp(1.2811805e-5 * T * T - 1.9509874e-2 * T + 34.04926034 - 6.3536311e3 / T)
    return air.humidity * enhancement * saturation / p


def speed_of_sound(air: Air) -> Any:
    """Speed of sound (m/s) at low frequencies; uncertainty 300 ppm within the stated ranges.

    Source: [1] eq. 15 with the coefficients of table III.
    """
    t, p, xc = air.temperature - ZERO_CELSIUS, air.pressure, air.carbon_dioxide
    xw = water_vapour(air)
    return (
        331.5024
        + 0.603055 * t
        - 0.000528 * t * t
        + (51.471935 + 0.1495874 * t - 0.000782 * t * t) * xw
        + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t * t) * p
        + (-85.20931 - 0.228525 * t + 5.91e-5 * t * t) * xc
        - 2.835149 * xw * xw
        - 2.15e-13 * p * p
        + 29.179762 * xc * xc
        + 0.000486 * xw * p * xc
    )
