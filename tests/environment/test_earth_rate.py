import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.environment.geodetic import RATE, coriolis, earth_rate, ned_axes


def test_earth_rate_matches_earth_axis_in_ned():
    for latitude in (0.0, 0.68, -1.2, np.pi / 2):
        axis = np.asarray(ned_axes(latitude, 0.4)).T @ [0, 0, RATE]
        np.testing.assert_allclose(earth_rate(latitude), axis, atol=1e-19)


@pytest.mark.thorough
def test_coriolis_matches_inertial_straight_line_motion():
    """A free body in inertial space, seen from axes that turn: x'' = -2 W × x' - W × (W × x)."""
    W, p0, v0 = np.array([0.2, -0.1, 0.3]), np.array([1.0, 2.0, -1.0]), np.array([0.5, -0.4, 0.2])
    from trimtab.core.rotation import from_rotation_vector

    def seen(t):
        return from_rotation_vector(jnp.asarray(W) * t).T @ (p0 + v0 * t)

    t = 1.3
    x, v = seen(t), jax.jacfwd(seen)(t)
    a = jax.jacfwd(jax.jacfwd(seen))(t)
    np.testing.assert_allclose(a, coriolis(W, v) - np.cross(W, np.cross(W, x)), atol=1e-9)


def test_coriolis_deflects_northward_motion_to_the_east():
    """Northern hemisphere: what moves north is pushed east (to the right)."""
    assert float(coriolis(earth_rate(0.7), jnp.array([1.0, 0.0, 0.0]))[1]) > 0


def test_coriolis_lowers_to_generated_c():
    lower_function(lambda phi, v: coriolis(earth_rate(phi), v), (0.3, jnp.ones(3)))
