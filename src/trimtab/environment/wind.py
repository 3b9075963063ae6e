"""Steady wind over the ground that depends on the height only."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record


@record
class Wind:
    """Wind that is linear in the height. The components give the direction towards which the air moves.

        wind = (north, east, 0) + height (north_shear, east_shear, 0)

    Frames:  local north, east, down; height above sea level.
    Valid:   where the wind is linear in the height; no upper limit. Not modelled: gusts, turbulence, up-draughts.
    Source:  kinematics.
    """

    north: Scalar = quantity("m/s", "Northward wind at sea level.", frame="N", default=0.0)
    east: Scalar = quantity("m/s", "Eastward wind at sea level.", frame="N", default=0.0)
    north_shear: Scalar = quantity("1/s", "Increase of the northward wind per metre of height.", frame="N", default=0.0)
    east_shear: Scalar = quantity("1/s", "Increase of the eastward wind per metre of height.", frame="N", default=0.0)

    def velocity(self, height: Any) -> Any:
        """Return the velocity of the air (3,) (m/s) over the ground, in local north-east-down, at a height (m)."""
        north = self.north + self.north_shear * height
        east = self.east + self.east_shear * height
        return jnp.stack([north, east, jnp.zeros_like(north + east)])
