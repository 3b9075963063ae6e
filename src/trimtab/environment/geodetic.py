"""Model of the earth: WGS84 ellipsoid, tangent plane, normal gravity, and angular velocity.

Geodetic: latitude, longitude (rad), height above the ellipsoid (m). ECEF: earth-centred, earth-fixed, which rotates
with the earth and so is not inertial.

Planar navigation on a laboratory floor neglects the earth's rate (15 deg/h) and the Coriolis acceleration (0.15 mm/s²
at 1 m/s). A gyro's bias is hundreds of times larger than this rate. If these effects matter, pass
`earth_rate(latitude)` to the inertial unit and to the navigation.

Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., tables 3.1 and 3.4, chapter 3, eqs.
4-1 and 4-3; Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections
2.1.3, 2.4 and 5.4.
"""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record

SEMI_MAJOR = 6378137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
SEMI_MINOR = SEMI_MAJOR * (1 - FLATTENING)
ITERATIONS = 3
"""Number of Bowring's iterations. Two reach an error of 1 mm at heights below 1000 km."""
EQUATOR = 9.7803253359
"""Normal gravity at the equator (m/s²)."""
SOMIGLIANA = 0.00193185265241
"""Somigliana's constant, k = b gp/(a ge) - 1."""
GM = 3.986004418e14
RATE = 7.292115e-5
"""Angular velocity of the earth (rad/s)."""
M = RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM
STANDARD = 9.80665
"""Standard gravity (m/s²), the g of data sheets. Source: 3rd General Conference on Weights and Measures, 1901."""


def to_ecef(
    latitude: Any, longitude: Any, height: Any, *, semi_major: Any = SEMI_MAJOR, flattening: Any = FLATTENING
) -> Any:
    """Return earth-centred, earth-fixed coordinates (3,) (m) of a geodetic position. Source: TR8350.2, eq. 4-14."""
    s, c = jnp.sin(latitude), jnp.cos(latitude)
    eccentricity2 = flattening * (2 - flattening)
    N = semi_major / jnp.sqrt(1 - eccentricity2 * s * s)
    across = (N + height) * c
    up = (N * (1 - eccentricity2) + height) * s
    return jnp.stack([across * jnp.cos(longitude), across * jnp.sin(longitude), up])


def from_ecef(p: Any, *, semi_major: Any = SEMI_MAJOR, flattening: Any = FLATTENING) -> tuple[Any, Any, Any]:
    """Return latitude, longitude (rad) and height (m) of a position (3,) (m), not near the earth's centre.

    The function has a fixed number of steps and no branches, so it can be used in flight code.

    Source: Bowring, Survey Review 23 (1976), iterated.
    """
    across = jnp.sqrt(p[0] ** 2 + p[1] ** 2)
    eccentricity2 = flattening * (2 - flattening)
    second2 = eccentricity2 / (1 - eccentricity2)
    semi_minor = semi_major * (1 - flattening)
    sb, cb = p[2], across * (1 - flattening)  # proportional to sine and cosine of the reduced latitude
    s, c = sb, cb
    for _ in range(ITERATIONS):
        norm = jnp.sqrt(sb * sb + cb * cb)
        sb, cb = sb / norm, cb / norm
        s = p[2] + second2 * semi_minor * sb**3
        c = across - eccentricity2 * semi_major * cb**3
        sb, cb = (1 - flattening) * s, c
    norm = jnp.sqrt(s * s + c * c)
    s, c = s / norm, c / norm
    height = across * c + p[2] * s - semi_major * jnp.sqrt(1 - eccentricity2 * s * s)
    return jnp.arctan2(s, c), jnp.arctan2(p[1], p[0]), height


def ned_axes(latitude: Any, longitude: Any) -> Any:
    """Return the rotation R_EN (3, 3) from local north-east-down components to earth-fixed components."""
    s, c, sl, cl = jnp.sin(latitude), jnp.cos(latitude), jnp.sin(longitude), jnp.cos(longitude)
    o = jnp.zeros_like(s * sl)
    return jnp.stack([jnp.stack([-s * cl, -sl, -c * cl]), jnp.stack([-s * sl, cl, -c * sl]), jnp.stack([c, o, -s])])


@record
class TangentPlane:
    """North-east-down coordinates with their origin at a geodetic position: the world frame W on the earth.

        p_W = R_NE (p_E - origin_E)

    Frames:  W north-east-down at the origin; its axes don't depend on the vehicle's position.
    Valid:   anywhere. The down axis is along the plumb line only near the origin (1 arc second off at 31 m).
    Source:  Groves, 2nd ed., section 2.1.3.
    """

    latitude: Scalar = quantity("rad", "Geodetic latitude of the origin of the world frame W.", kind="angle")
    longitude: Scalar = quantity("rad", "Longitude of the origin of the world frame W.", kind="angle")
    height: Scalar = quantity("m", "Height of the origin of the world frame W above the ellipsoid.", default=0.0)

    def to_ned(self, latitude: Any, longitude: Any, height: Any) -> Any:
        """Return north, east, down (3,) (m) of a geodetic position."""
        origin = to_ecef(self.latitude, self.longitude, self.height)
        return ned_axes(self.latitude, self.longitude).T @ (to_ecef(latitude, longitude, height) - origin)

    def from_ned(self, p_W: Any) -> tuple[Any, Any, Any]:
        """Return latitude, longitude (rad) and height (m) of a position given as north, east, down (3,) (m)."""
        origin = to_ecef(self.latitude, self.longitude, self.height)
        return from_ecef(origin + ned_axes(self.latitude, self.longitude) @ p_W)


def normal_gravity(latitude: Any, height: Any = 0.0) -> Any:
    """Return gravity (m/s²), with centrifugal acceleration, at a geodetic latitude (rad) and height (m) below 20 km.

    This is the specific force on an accelerometer at rest, without the local anomaly (< 1 mm/s²). It is computed by
    Somigliana's formula on the ellipsoid, and an expansion to second order in height.
    """
    s2 = jnp.sin(latitude) ** 2
    surface = EQUATOR * (1 + SOMIGLIANA * s2) / jnp.sqrt(1 - ECCENTRICITY2 * s2)
    linear = 2 / SEMI_MAJOR * (1 + FLATTENING + M - 2 * FLATTENING * s2)
    return surface * (1 - linear * height + 3 / SEMI_MAJOR**2 * height**2)


def gravity(latitude: Any, height: Any = 0.0) -> Any:
    """Return the gravity vector (3,) (m/s²) in local north-east-down, assumed normal to the ellipsoid."""
    g = normal_gravity(latitude, height)
    return jnp.stack([jnp.zeros_like(g), jnp.zeros_like(g), g])


def earth_rate(latitude: Any) -> Any:
    """Return the angular velocity of the earth (3,) (rad/s) in local north-east-down, at a geodetic latitude (rad)."""
    c, s = jnp.cos(latitude), jnp.sin(latitude)
    return jnp.stack([RATE * c, jnp.zeros_like(c), -RATE * s])


def coriolis(earth_rate_W: Any, v_W: Any) -> Any:
    """Return the Coriolis acceleration -2 Omega × v (3,) (m/s²) of a free body in the rotating frame W."""
    return -2 * jnp.cross(earth_rate_W, v_W)
