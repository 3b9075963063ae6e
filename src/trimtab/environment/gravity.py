"""Normal gravity of WGS84 at a place: what an accelerometer at rest feels, without the local anomaly (< 1 mm/s²).

Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., table 3.4, eqs. 4-1 and 4-3.
"""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.environment.geodetic import ECCENTRICITY2, FLATTENING, SEMI_MAJOR, SEMI_MINOR

EQUATOR = 9.7803253359
"""Normal gravity at the equator (m/s²)."""
SOMIGLIANA = 0.00193185265241
"""k = b gp/(a ge) - 1."""
GM = 3.986004418e14
RATE = 7.292115e-5
"""Angular velocity of the earth (rad/s)."""
M = RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM
STANDARD = 9.80665
"""Standard gravity (m/s²), the g of data sheets. Source: 3rd General Conference on Weights and Measures, 1901."""


def normal_gravity(latitude: Any, height: Any = 0.0) -> Any:
    """Magnitude (m/s²), centrifugal acceleration included, at a geodetic latitude (rad) and height (m) below 20 km.

    Somigliana's formula on the ellipsoid, and its expansion to second order in height.
    """
    s2 = jnp.sin(latitude) ** 2
    surface = EQUATOR * (1 + SOMIGLIANA * s2) / jnp.sqrt(1 - ECCENTRICITY2 * s2)
    linear = 2 / SEMI_MAJOR * (1 + FLATTENING + M - 2 * FLATTENING * s2)
    return surface * (1 - linear * height + 3 / SEMI_MAJOR**2 * height**2)


def gravity(latitude: Any, height: Any = 0.0) -> Any:
    """Gravity vector (3,) (m/s²) in local north-east-down; the plumb line taken normal to the ellipsoid."""
    g = normal_gravity(latitude, height)
    return jnp.stack([jnp.zeros_like(g), jnp.zeros_like(g), g])
