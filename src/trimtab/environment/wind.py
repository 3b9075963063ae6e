"""Steady wind over the ground, the same everywhere at one height."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record


@record
class Wind:
    """Wind that changes in a straight line with the height: where the air goes, not where it comes from.

        wind = (north, east, 0) + height (north_shear, east_shear, 0)

    Frames:  local north, east, down; height above the sea.
    Valid:   as long as the straight line is; it has no upper end. Not modelled: gusts, turbulence, up-draughts.
    Source:  kinematics.
    """

    north: Scalar = quantity("m/s", "Northward at sea level.", frame="N", default=0.0)
    east: Scalar = quantity("m/s", "Eastward at sea level.", frame="N", default=0.0)
    north_shear: Scalar = quantity("1/s", "Northward, more for each metre up.", frame="N", default=0.0)
    east_shear: Scalar = quantity("1/s", "Eastward, more for each metre up.", frame="N", default=0.0)

    def velocity(self, height: Any) -> Any:
        """Velocity of the air (3,) (m/s) over the ground, in local north-east-down, at a height (m)."""
        north = self.north + self.north_shear * height
        east = self.east + self.east_shear * height
        return jnp.stack([north, east, jnp.zeros_like(north + east)])
