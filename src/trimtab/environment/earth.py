"""Gravitation and rotation of the earth: an ellipsoid with J2, or a sphere.

Frames: I is inertial, with z along the earth's axis (ECI). E rotates with the earth and coincides with I at time zero
(ECEF).

Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., table 3.1 and chapter 4; Stevens,
Lewis, Johnson, "Aircraft control and simulation", 3rd ed., section 1.6 (J2).
"""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record
from trimtab.environment.geodetic import FLATTENING, GM, RATE, SEMI_MAJOR, from_ecef, ned_axes, to_ecef

J2 = 1.082626684e-3
"""Second zonal harmonic J2 = -sqrt(5) C20, with C20 = -484.166774985e-6 from TR8350.2."""
ROUND_RADIUS = 6_371_007.1809
"""Radius of a sphere with the surface area of the ellipsoid (m)."""


@record
class Earth:
    """Gravitation, shape and rotation rate of the earth.

        g = -GM/r² [ (1 + 3/2 J2 (a/r)² (1 - 5 s²)) p/r + 3 J2 (a/r)² s e_z ],    s = p_z / r

    Frames:  positions p (3,) from the earth's centre, in I or E, because the field is symmetric about the axis.
    Valid:   outside the earth. Not modelled: higher harmonics (some 1e-5 of g), moon and sun, polar motion.
    Source:  TR8350.2; [1] Stevens, Lewis, Johnson, eq. 1.6-15.
    """

    gm: Scalar = quantity("m^3/s^2", "Gravitational constant times the earth's mass.", default=GM, above=0)
    j2: Scalar = quantity("1", "Second zonal harmonic J2 of the earth's gravitation; 0 for a sphere.", default=J2)
    semi_major: Scalar = quantity("m", "Radius of the earth at the equator.", default=SEMI_MAJOR, above=0)
    flattening: Scalar = quantity(
        "1", "Flattening of the earth: 1 - polar radius / radius at the equator.", default=FLATTENING, low=0, high=0.1
    )
    rate: Scalar = quantity("rad/s", "Angular velocity of the earth about its axis, eastward.", default=RATE)

    def gravitation(self, p: Any) -> Any:
        """Return the acceleration (3,) (m/s²) of a body in free fall at p (3,), without centrifugal acceleration."""
        r2 = p @ p
        r = jnp.sqrt(r2)
        s = p[2] / r
        ratio = 1.5 * self.j2 * self.semi_major**2 / r2
        along = 1 + ratio * (1 - 5 * s * s)
        pull = self.gm / (r2 * r)
        return -pull * jnp.stack([along * p[0], along * p[1], (along + 2 * ratio) * p[2]])

    def to_inertial(self, t: Any) -> Any:
        """Return the rotation R_IE (3, 3) from earth-fixed to inertial components at time t (s)."""
        c, s = jnp.cos(self.rate * t), jnp.sin(self.rate * t)
        o = jnp.zeros_like(c)
        return jnp.stack([jnp.stack([c, -s, o]), jnp.stack([s, c, o]), jnp.stack([o, o, o + 1])])

    def place(self, latitude: Any, longitude: Any, height: Any) -> Any:
        """Return the earth-fixed position p_E (3,) (m) of a geodetic latitude, longitude (rad) and height (m)."""
        return to_ecef(latitude, longitude, height, semi_major=self.semi_major, flattening=self.flattening)

    def geodetic(self, p_E: Any) -> tuple[Any, Any, Any]:
        """Return geodetic latitude, longitude (rad) and height (m) of an earth-fixed position p_E (3,) (m)."""
        return from_ecef(p_E, semi_major=self.semi_major, flattening=self.flattening)

    def ned_axes(self, p_E: Any) -> Any:
        """Return the rotation R_EN (3, 3) from north-east-down components at a position to earth-fixed components."""
        latitude, longitude, _ = self.geodetic(p_E)
        return ned_axes(latitude, longitude)


def round_earth(rate: float = RATE) -> Earth:
    """Return a sphere with the ellipsoid's surface area and mass, rotating at `rate` (rad/s)."""
    return Earth(j2=0.0, semi_major=ROUND_RADIUS, flattening=0.0, rate=rate)
