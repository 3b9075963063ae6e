"""Steady ocean current, the same everywhere."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, record


@record
class Current:
    """Current of constant velocity over the ground. The components give the direction towards which the water moves.

    A vehicle's velocity through the water is v - v_c. The current's components in the body change as the vehicle turns,
    v_c,B' = -w x v_c,B. With these two relations, the equations of motion for the velocity through the water are those
    of still water.

    Frames:  W north-east-down; level.
    Valid:   a current that is steady and uniform. Not modelled: shear with depth, up-welling, waves.
    Source:  T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control", 2nd ed., 2021, section 10.3.
    """

    north: Scalar = imperfection("m/s", "Northward velocity of the current.", "current", low=None)
    east: Scalar = imperfection("m/s", "Eastward velocity of the current.", "current", low=None)

    def in_body(self, R_BW: Any) -> Any:
        """Return the velocity of the water over the ground (3,) in the axes of B."""
        return R_BW @ jnp.stack([self.north, self.east, jnp.zeros_like(self.north + self.east)])

    def in_plane(self, heading: Any) -> tuple[Any, Any]:
        """Return the velocity of the water, forward and to starboard, for an upright vehicle with a heading (rad)."""
        c, s = jnp.cos(heading), jnp.sin(heading)
        return c * self.north + s * self.east, c * self.east - s * self.north
