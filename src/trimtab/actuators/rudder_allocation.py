"""Allocation of a planar force to a propeller that pushes forward only, and to the rudders in its stream."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarForce
from trimtab.vehicles.rudder_hovercraft import RudderHovercraft, RudderThrottle


@record
class RudderAllocation:
    """Allocation that converts a demanded force to a throttle and a rudder angle.

        FY' = FY limited to +-T_max sin psi_max
        FX' = max(FX, |FY'|/tan psi_max), limited to sqrt(T_max^2 - FY'^2)
        T = |F'|    psi = -atan2(FY', FX')    rudder = psi/deflection    throttle from T = a c + b c^2

    psi_max is the angle of the stream at the rudder limit, and T_max the thrust at `throttle_max`. The side force has
    priority, because it turns the craft: if it needs more stream than FX gives, the thrust increases, and the craft is
    pushed forward more than demanded. A demand to push backward cannot be met. A side force below `dead_zone` is not
    produced by thrust of its own, so that the propeller stops if the craft rests.

    Frames:  demand in B at the rudders.
    Source:  own derivation: the inverse of `RudderHovercraft.force`, with limits.
    """

    model: RudderHovercraft = part("Vehicle model, for its thrust curve and rudders.", default=RudderHovercraft())
    rudder_max: Scalar = quantity("rad", "Largest rudder angle to either side.", default=0.6, above=0, high=1.2)
    throttle_max: Scalar = quantity("1", "Largest throttle.", default=1.0, above=0, high=1)
    dead_zone: Scalar = quantity(
        "N", "Largest demanded side force that causes no thrust beyond the demanded push.", default=0.01, low=0
    )

    def init(self, key: Key) -> tuple[()]:
        """Return an empty record, because this part has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: PlanarForce) -> tuple[tuple[()], RudderThrottle]:
        """Return the throttle and the rudder angle for a demanded force (N, in B)."""
        psi_max = self.model.deflection * self.rudder_max
        T_max = self.model.thrust(self.throttle_max)
        side = T_max * jnp.sin(psi_max)
        FY = jnp.clip(demand.FY, -side, side)
        turning = jnp.where(jnp.abs(FY) > self.dead_zone, jnp.abs(FY) / jnp.tan(psi_max), 0.0)
        push = jnp.sqrt(jnp.maximum(T_max**2 - FY**2, 0.0))
        FX = jnp.minimum(jnp.maximum(jnp.maximum(demand.FX, 0.0), turning), push)
        pushes = FX > 0
        psi = jnp.where(pushes, -jnp.arctan2(FY, jnp.where(pushes, FX, 1.0)), 0.0)
        psi = jnp.clip(psi, -psi_max, psi_max)
        T = jnp.where(pushes, FX / jnp.cos(psi), 0.0)
        throttle = jnp.minimum(self._throttle(T), self.throttle_max)
        return state, RudderThrottle(throttle=throttle, rudder=psi / self.model.deflection)

    def _throttle(self, T: Any) -> Any:
        """Return the throttle for a thrust T (N), the positive root of b c^2 + a c - T = 0."""
        a, b = self.model.thrust_linear, self.model.thrust_quadratic
        root = a + jnp.sqrt(a**2 + 4 * b * T)
        return 2 * T / jnp.where(root > 0, root, 1.0)
