"""Magnetic field of the earth, from a model evaluated before a run or from given values, and heading from the field.

Source: Chulliat et al., "The US/UK World Magnetic Model for 2020-2025", NOAA, 2020; coefficients and evaluation by the
package pygeomag.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from datetime import date
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, install_command
from trimtab.core.rotation import from_euler

MODELS = {2010: "wmm/WMM_2010.COF", 2015: "wmm/WMM_2015v2.COF", 2020: "wmm/WMM_2020.COF", 2025: "wmm/WMM_2025.COF"}
"""Coefficient file of each World Magnetic Model, keyed by the model's first year. A model is valid for five years."""
LAST = 2030
COLLEGE_PARK = (2.047e-05, -3.93e-06, 4.783e-05)
"""Field (T) at the University of Maryland, 38.99 N 76.94 W, by the model at the date 2010.0."""


def earth_field(latitude: float, longitude: float, height: float, when: date | float) -> Any:
    """Return the World Magnetic Model's field (3,) (T) in local north-east-down.

    Args:     latitude, longitude: geodetic (rad).    height: above the ellipsoid (m).
              when: a date, or a year with decimals from 2010 up to 2030.
    """
    year = _decimal_year(when)
    if not min(MODELS) <= year < LAST:
        problem = f"no installed World Magnetic Model covers the year {year:g}"
        fix = "give another date, or the field itself: field_from_angles(intensity, declination, inclination)"
        raise InputError("earth_field", problem, choices=[f"{y} to {y + 5}" for y in MODELS], fix=fix)
    if not abs(latitude) <= math.pi / 2 or not math.isfinite(longitude) or not -1000 <= height <= 850e3:
        place = f"latitude {latitude} rad, longitude {longitude} rad, height {height} m"
        problem = f"the model does not cover {place}"
        raise InputError("earth_field", problem, fix="give angles in radians, |latitude| <= pi/2, height -1 to 850 km")
    try:
        from pygeomag import GeoMag
    except ImportError:
        fix = install_command("nav")
        raise InputError("earth_field", "the package pygeomag is not installed", fix=fix) from None
    model = GeoMag(coefficients_file=MODELS[max(y for y in MODELS if y <= year)])
    field = model.calculate(math.degrees(latitude), math.degrees(longitude), height / 1000, year)
    return np.array([field.x, field.y, field.z]) * 1e-9


def field_from_angles(intensity: float, declination: float, inclination: float) -> Any:
    """Return a field (3,) (T) in local north-east-down from intensity (T), declination (rad, east), dip (rad, down)."""
    level = intensity * math.cos(inclination)
    down = intensity * math.sin(inclination)
    return np.array([level * math.cos(declination), level * math.sin(declination), down])


def declination(field_W: Any) -> Any:
    """Return the angle from true to magnetic north (rad), positive east, of a field (3,) in north-east-down."""
    return np.arctan2(field_W[1], field_W[0])


def inclination(field_W: Any) -> Any:
    """Return the dip below the horizon (rad) of a field (3,) in north-east-down."""
    return np.arctan2(field_W[2], np.hypot(field_W[0], field_W[1]))


def magnetic_heading(field_B: Any, field_W: Any, roll: Any = 0.0, pitch: Any = 0.0) -> Any:
    """Return the true heading (rad, in [-pi, pi]) from the measured field (3,) in B and the known field (3,) in NED.

    Both fields are projected on the horizontal plane. The heading is the angle from the measured to the known field,

        psi = atan2((b × w)_z, b · w).

    This formula is exact at every angle, while an arc cosine of b · w loses half of its digits near 0 and pi. If a
    projection vanishes (at a magnetic pole, or for a dead sensor), the heading is 0. To detect this, check
    `strength_ratio`. The function can be used in flight code.

    Source: [1] eqs. 3.43-3.44, with the arc cosine replaced (docs page, Errata).
    """
    roll, pitch = jnp.asarray(roll), jnp.asarray(pitch)
    b, w = from_euler(roll, pitch, jnp.zeros_like(pitch)) @ field_B, field_W
    return jnp.arctan2(b[0] * w[1] - b[1] * w[0], b[0] * w[0] + b[1] * w[1])


def strength_ratio(field_B: Any, field_W: Any) -> Any:
    """Return the ratio of measured to known field strength. The ratio differs from 1 near a motor or steel, and is 0
    for a dead sensor."""
    return jnp.sqrt((field_B @ field_B) / (field_W @ field_W))


def _decimal_year(when: date | float) -> float:
    if not isinstance(when, date):
        return float(when)
    start, end = date(when.year, 1, 1), date(when.year + 1, 1, 1)
    day = date(when.year, when.month, when.day)
    return when.year + (day - start).days / (end - start).days
