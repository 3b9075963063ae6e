"""Gravitation against its potential, and with the earth's turning against normal gravity."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.environment.earth import Earth, round_earth
from trimtab.environment.geodetic import RATE, gravity, ned_axes, to_ecef


def potential(earth, p):
    """GM/r (1 - J2 (a/r)² (3 s² - 1)/2): Stevens, Lewis, Johnson, eq. 1.6-13."""
    r = jnp.sqrt(p @ p)
    s = p[2] / r
    return earth.gm / r * (1 - earth.j2 * (earth.semi_major / r) ** 2 * (3 * s * s - 1) / 2)


@jax.jit
def gravitation_and_slope(p):
    return Earth().gravitation(p), jax.grad(lambda p: potential(Earth(), p))(p)


@pytest.mark.parametrize("latitude", [-90.0, -40.0, 0.0, 12.0, 45.0, 90.0])
def test_gravitation_is_the_gradient_of_the_potential(latitude):
    p = jnp.asarray(to_ecef(np.radians(latitude), 0.4, 120e3))
    found, slope = gravitation_and_slope(p)
    np.testing.assert_allclose(found, slope, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("latitude", [0.0, 20.0, 45.0, 70.0, 90.0])
def test_gravitation_with_centrifugal_term_is_normal_gravity(latitude):
    """Somigliana's formula has the whole ellipsoid's field: its J4, -2.37e-6, is 5 J4 of the field at the poles."""
    phi = np.radians(latitude)
    p = to_ecef(phi, 0.0, 0.0)
    out = RATE**2 * jnp.array([p[0], p[1], 0.0])
    felt = ned_axes(phi, 0.0).T @ (Earth().gravitation(p) + out)
    np.testing.assert_allclose(felt, gravity(phi), atol=5 * 2.37e-6 * 9.84 + 1e-6)


def test_round_earth_has_spherical_geometry_and_gravity():
    earth = round_earth()
    p = earth.place(0.3, 0.5, 1000.0)
    assert np.linalg.norm(p) == pytest.approx(earth.semi_major + 1000.0, rel=1e-15)
    np.testing.assert_allclose(earth.gravitation(p), -earth.gm * p / np.linalg.norm(p) ** 3, rtol=1e-14)
    np.testing.assert_allclose(earth.geodetic(p), (0.3, 0.5, 1000.0), rtol=1e-11)
    assert p[2] == pytest.approx(np.sin(0.3) * np.linalg.norm(p))


def test_geodetic_round_trip_on_the_ellipsoid():
    earth = Earth()
    for place in ((1.2, -2.0, 10e3), (-0.7, 3.0, -50.0), (0.0, 0.0, 400e3)):
        np.testing.assert_allclose(earth.geodetic(earth.place(*place)), place, rtol=1e-9, atol=1e-9)


def test_earth_rotates_once_per_sidereal_day():
    day = 2 * np.pi / RATE
    assert day == pytest.approx(86_164.1, abs=0.1)
    np.testing.assert_allclose(Earth().to_inertial(day), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(Earth().to_inertial(day / 4) @ jnp.array([1.0, 0, 0]), [0, 1, 0], atol=1e-12)
