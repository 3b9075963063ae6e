import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.environment import geodetic as g

RNG = np.random.default_rng(5)
PLACES = np.stack(
    [RNG.uniform(-np.pi / 2, np.pi / 2, 200), RNG.uniform(-np.pi, np.pi, 200), RNG.uniform(-1e4, 1e6, 200)], 1
)
EDGES = np.array([[0, 0, 0], [np.pi / 2, 0, 100], [-np.pi / 2, 0, -50], [0.3, np.pi, 1e5], [1e-9, -np.pi / 2, 1.0]])


def test_ecef_matches_published_ellipsoid_axes():
    """On the axes of the ellipsoid, whose lengths are printed: TR8350.2 table 3.1 and 3.3 (b = 6356752.3142 m)."""
    np.testing.assert_allclose(g.to_ecef(0.0, 0.0, 0.0), [6378137, 0, 0], atol=1e-9)
    np.testing.assert_allclose(g.to_ecef(np.pi / 2, 0.0, 0.0), [0, 0, 6356752.3142], atol=5e-5)
    np.testing.assert_allclose(g.to_ecef(0.0, np.pi / 2, 7.0), [0, 6378144, 0], atol=1e-8)


there_and_back = jax.jit(jax.vmap(lambda p: g.from_ecef(g.to_ecef(*p))))


@pytest.mark.parametrize("places", [PLACES, EDGES], ids=["random", "edges"])
def test_geodetic_to_ecef_round_trip(places):
    latitude, longitude, height = there_and_back(jnp.asarray(places))
    np.testing.assert_allclose(height, places[:, 2], atol=1e-8)
    np.testing.assert_allclose(latitude, places[:, 0], atol=1e-14)
    upright = np.abs(places[:, 0]) < np.pi / 2
    np.testing.assert_allclose(np.cos(longitude - places[:, 1])[upright], 1, atol=1e-14)


def test_ned_axes_are_derivatives_of_the_position():
    """North and east are where latitude and longitude lead, scaled by the radii of curvature; down is -height."""
    latitude, longitude, height = 0.68, -1.34, 50.0
    J = jax.jit(jax.jacfwd(lambda p: g.to_ecef(*p)))(jnp.array([latitude, longitude, height]))
    w2 = 1 - g.ECCENTRICITY2 * np.sin(latitude) ** 2  # radii of curvature: TR8350.2, eqs. 4-15
    normal = g.SEMI_MAJOR / np.sqrt(w2)
    meridian = normal * (1 - g.ECCENTRICITY2) / w2
    scaled = J / jnp.array([meridian + height, (normal + height) * np.cos(latitude), -1.0])
    np.testing.assert_allclose(g.ned_axes(latitude, longitude), scaled, atol=1e-12)


def test_tangent_plane_round_trip_and_curvature():
    plane = g.TangentPlane(latitude=0.68, longitude=-1.34, height=50.0)
    np.testing.assert_allclose(plane.to_ned(0.68, -1.34, 40.0), [0, 0, 10], atol=1e-8)
    p = jnp.array([120.0, -80.0, -3.0])
    np.testing.assert_allclose(plane.to_ned(*plane.from_ned(p)), p, atol=1e-8)
    far = plane.to_ned(*plane.from_ned(jnp.array([1000.0, 0.0, 0.0])))
    assert float(plane.from_ned(far)[2]) - 50 == pytest.approx(1000**2 / 2 / 6.36e6, rel=0.01), (
        "the plane leaves the earth"
    )


def test_tangent_plane_lowers_to_generated_c():
    plane = g.TangentPlane(latitude=0.68, longitude=-1.34, height=50.0)
    lower_function(lambda plane, p: plane.to_ned(*plane.from_ned(p)), (plane, jnp.zeros(3)))
