"""Speed of sound in air, and error of an ultrasonic range away from the beacon's axis.

A receiver that triggers at a threshold of the envelope triggers later if the sound is weaker. Transducers are weaker
off their axis, so the measured range grows with the angle from the axis.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006; [2] O. Cramer,
"The variation of the specific heat ratio and the speed of sound in air with temperature, pressure, humidity, and CO2
concentration", J. Acoust. Soc. Am. 93 (5), 1993.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, quantity, record

ZERO_CELSIUS = 273.15
"""Temperature of 0 °C in kelvins."""
QUADRATIC, LINEAR = -0.038, 0.0032
"""Coefficients of the ratio of true to measured range: a quadratic polynomial in the angle from the beacon's axis. The
ratio is largest at 2.4°. Source: [1] section 5.5.4."""
CONE = math.pi / 4
"""Largest angle from the axis (rad) at which the fit is valid and replies arrive. [1] section 5.5."""


@record
class Air:
    """State of air at rest: temperature, humidity, pressure and carbon dioxide.

    Valid:   0 to 30 °C, 75 to 102 kPa, water vapour up to 6 %, carbon dioxide up to 1 % by volume.
    Source:  [2] table III.
    """

    temperature: Scalar = quantity("K", "Temperature of the air.", default=293.15, low=243.15, high=333.15)
    humidity: Scalar = quantity("1", "Relative humidity of the air, 0 to 1.", default=0.5, low=0, high=1)
    pressure: Scalar = quantity("Pa", "Pressure of the air.", default=101325.0, low=5e4, high=1.2e5)
    carbon_dioxide: Scalar = quantity("1", "Mole fraction of carbon dioxide.", default=4e-4, low=0, high=0.01)


def water_vapour(air: Air) -> Any:
    """Return the mole fraction of water vapour: humidity times enhancement factor times saturation pressure / pressure.

    Source: [2] appendix, from R. S. Davis, Metrologia 29, 1992 (the equation of the density of moist air).
    """
    T, p = air.temperature, air.pressure
    t = T - ZERO_CELSIUS
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t * t
    saturation = jnp.exp(1.2811805e-5 * T * T - 1.9509874e-2 * T + 34.04926034 - 6.3536311e3 / T)
    return air.humidity * enhancement * saturation / p


def speed_of_sound(air: Air) -> Any:
    """Return the speed of sound (m/s) at low frequencies; uncertainty 300 ppm within the stated ranges.

    Source: [2] eq. 15 with the coefficients of table III.
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


def range_ratio(beta: Any) -> Any:
    """Return the ratio of true to measured range at an angle beta (rad) from the axis, 0 to 45°. Source: [1] 5.5.4."""
    return QUADRATIC * beta * beta + LINEAR * beta + 1.0


def off_axis_angle(height: Any, distance: Any) -> Any:
    """Return the angle (rad) between the vertical and a line of length `distance` (m) that rises by `height` (m).

    The angle is 0 if `distance` is 0.
    """
    ratio = height / jnp.where(distance > 0, distance, 1.0)
    return jnp.where(distance > 0, jnp.arccos(jnp.clip(ratio, -1.0, 1.0)), 0.0)


def fit_range_ratio(beta: Any, ratio: Any) -> tuple[float, float]:
    """Return the quadratic and linear coefficients of the range ratio, by least squares with ratio 1 at beta = 0.

    Args:     beta: angles (rad), shape (n,).    ratio: ratio of true to measured range, shape (n,).
    """
    b = np.asarray(beta, np.float64)
    A = np.stack([b * b, b], axis=1)
    (quadratic, linear), *_ = np.linalg.lstsq(A, np.asarray(ratio, np.float64) - 1.0, rcond=None)
    return float(quadratic), float(linear)
