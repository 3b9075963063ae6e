"""Against the printed numbers of WGS84, and the gradient of its potential in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.environment import geodetic
from trimtab.environment.geodetic import GM, RATE, gravity, normal_gravity

A, B = geodetic.SEMI_MAJOR, geodetic.SEMI_MINOR
E = np.sqrt(A**2 - B**2)


def potential(p):
    """Normal potential at a place p (3,), in ellipsoidal coordinates. Heiskanen and Moritz 1967, eq. 2-62."""
    r2 = p @ p - E**2
    u = np.sqrt((r2 + np.sqrt(r2**2 + 4 * E**2 * p[2] ** 2)) / 2)
    beta = np.arctan2(p[2] * np.sqrt(u**2 + E**2), u * np.hypot(p[0], p[1]))

    def q(u):
        return ((1 + 3 * u**2 / E**2) * np.arctan2(E, u) - 3 * u / E) / 2

    body = GM / E * np.arctan2(E, u) + RATE**2 * A**2 / 2 * q(u) / q(B) * (np.sin(beta) ** 2 - 1 / 3)
    return body + RATE**2 / 2 * (u**2 + E**2) * np.cos(beta) ** 2


def test_equator_and_pole_match_wgs84():
    """TR8350.2 table 3.4: equator 9.7803253359, pole 9.8321849378 m/s²."""
    assert float(normal_gravity(0.0)) == pytest.approx(9.7803253359, abs=1e-10)
    assert float(normal_gravity(np.pi / 2)) == pytest.approx(9.8321849378, abs=2e-10)


@pytest.mark.parametrize("latitude", [0.0, 0.4, 0.6805, 1.2, -0.9])
@pytest.mark.parametrize("height", [0.0, 50.0, 5000.0])
def test_normal_gravity_is_the_gradient_of_the_potential(latitude, height):
    """Step 100 m: differencing error below 1e-8 m/s², rounding of the potential (6e7) below 1e-9."""
    p = np.asarray(geodetic.to_ecef(latitude, 0.7, height))
    h = 100.0
    g = np.array([(potential(p + h * e) - potential(p - h * e)) / (2 * h) for e in np.eye(3)])
    assert float(normal_gravity(latitude, height)) == pytest.approx(
        np.linalg.norm(g), abs=2e-6 if height > 100 else 1e-7
    )


def test_gravity_vector_points_down():
    g = np.asarray(gravity(0.6805, 50.0))
    assert g[0] == g[1] == 0
    assert g[2] == pytest.approx(9.80065, abs=1e-5)
    lower_function(lambda phi, h: gravity(phi, h), (jnp.asarray(0.3), jnp.asarray(2.0)))
