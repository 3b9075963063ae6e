"""A current in body axes and in the plane, against rotation matrices."""

import jax.numpy as jnp
import numpy as np

from trimtab.core.imperfections import imperfections, without
from trimtab.core.rotation import from_euler
from trimtab.environment.current import Current


def test_current_is_rotated_into_body_axes():
    current, R = Current(north=0.3, east=-0.7), from_euler(0.2, -0.4, 1.1)
    np.testing.assert_allclose(R @ current.in_body(R.T), [0.3, -0.7, 0.0], atol=1e-15)


def test_planar_current_matches_upright_body_axes():
    current, heading = Current(north=0.3, east=-0.7), jnp.asarray(2.1)
    upright = current.in_body(from_euler(0.0, 0.0, heading).T)
    np.testing.assert_allclose(current.in_plane(heading), upright[:2], atol=1e-15)
    np.testing.assert_allclose(Current(north=1.0).in_plane(jnp.pi / 2), [0, -1], atol=1e-15)


def test_current_can_be_switched_off():
    assert "current" in imperfections(Current())
    still = without(Current(north=0.3, east=-0.7), "current")
    assert (still.north, still.east) == (0.0, 0.0)
