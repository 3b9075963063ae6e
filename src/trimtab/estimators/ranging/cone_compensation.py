"""The true range out of an ultrasonic range that is too long off the beacon's axis.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

from jax import lax

from trimtab.core.float64 import jnp
from trimtab.environment.ultrasonic_cone import LINEAR, QUADRATIC, off_axis, range_ratio

ITERATIONS = 8
TOLERANCE = 1e-6
TOP = LINEAR / (1 - 2 * QUADRATIC)
"""The angle (rad), about 0.003, at which e(beta) cos(beta) is greatest; its slope vanishes there."""
START, FARTHEST = 2.2 * TOP, 1.4
"""Angles (rad) between which Newton's method begins. Below 2 TOP there is no root for a range above the height."""


def compensate(measured: Any, height: Any) -> tuple[Any, Any, Any]:
    """True range, angle off the axis, and the iterations that it took.

        e(beta) cos(beta) = h / rho,   r = e(beta) rho

    solved by Newton's method from acos(h/rho), to 1e-6. The left side rises from 1 at 0 to its greatest value at 0.003
    rad and only then falls, so that the iteration starts beyond. A range not above the height, which only noise makes,
    has no solution and is returned as it is, at angle 0.

    Args:
        measured: range rho (m), any shape.
        height: of the beacon above the unit (m), same shape.

    Source: [1] section 5.5.4; the guards are added, see docs Errata.
    """
    climbs = (measured > height) & (height > 0)
    goal = jnp.where(climbs, height / jnp.where(climbs, measured, 1.0), 0.9)
    beta = jnp.clip(off_axis(goal, jnp.ones_like(goal)), START, FARTHEST)

    def closer(_: Any, carry: Any) -> Any:
        beta, iterations = carry
        ratio, slope = range_ratio(beta), 2 * QUADRATIC * beta + LINEAR
        excess = ratio * jnp.cos(beta) - goal
        step = excess / (slope * jnp.cos(beta) - ratio * jnp.sin(beta))
        going = jnp.abs(excess) > TOLERANCE
        beta = jnp.where(going, jnp.clip(beta - step, 1.5 * TOP, FARTHEST), beta)
        return beta, iterations + going

    beta, iterations = lax.fori_loop(0, ITERATIONS, closer, (beta, jnp.zeros_like(beta)))
    true_range = jnp.where(climbs, range_ratio(beta) * measured, measured)
    return true_range, jnp.where(climbs, beta, 0.0), jnp.where(climbs, iterations, 0.0)
