"""Least squares between bounds for flight code: an active-set method with a fixed number of steps and no exceptions.

    minimise  x.H x/2 + g.x    subject to  low <= x <= high

Source: [1] O. Härkegård, "Efficient active set algorithms for solving constrained least squares problems in aircraft
control allocation", CDC 2002, section III.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from trimtab.core.linalg import solve_spd

ROUNDING = 1e-9
"""Relative tolerance when a number is compared with its bound, or a multiplier with zero."""


class BoxSolution(NamedTuple):
    """Solution x (n,). side (n,): -1 for an unknown at its lower bound, 1 at its upper bound, else 0. solved: True if x
    is the minimum."""

    x: Any
    side: Any
    solved: Any


def solve_box_least_squares(H: Any, g: Any, low: Any, high: Any, start: Any, *, steps: int) -> BoxSolution:
    """Return the x between bounds that minimises x.H x/2 + g.x. `solved` is False if `steps` steps were not enough.

    Each step minimises over the unknowns that are not held at a bound. An unknown that reaches a bound is held there. A
    held unknown whose multiplier points inward is released, the largest multiplier first [1, algorithm 1]. Twice as
    many steps as unknowns are nearly always enough. An unknown with low = high is always held.

    Args:
        H: symmetric positive definite (n, n).
        g: (n,).
        low, high: bounds (n,), low <= high.
        start: initial x (n,), which is clipped to the bounds.
        steps: maximum number of steps.
    """
    x = jnp.clip(start, low, high)
    fixed = high <= low
    side = jnp.where(x <= low, -1.0, jnp.where(x >= high, 1.0, 0.0))

    def step(_: Any, now: BoxSolution) -> BoxSolution:
        x, side, _ = now
        free = side == 0
        both = free[:, None] & free[None, :]
        gradient = H @ x + g
        move = -solve_spd(jnp.where(both, H, 0.0) + jnp.diag(jnp.where(free, 0.0, 1.0)), jnp.where(free, gradient, 0.0))
        move = jnp.where(free, move, 0.0)
        room = jnp.where(move > 0, high - x, low - x)
        moves = jnp.abs(move) > 0
        share = jnp.where(free & moves, room / jnp.where(moves, move, 1.0), 2.0)
        first = jnp.argmin(share)
        blocked = share[first] < 1
        x = jnp.clip(x + jnp.where(blocked, jnp.maximum(share[first], 0.0), 1.0) * move, low, high)
        gradient = H @ x + g
        pull = jnp.where(fixed, 0.0, side * gradient)
        worst = jnp.argmax(pull)
        done = ~blocked & (pull[worst] <= ROUNDING * jnp.max(jnp.abs(g)))
        here = jnp.arange(len(x))
        held = jnp.where((here == first) & blocked, jnp.sign(move), side)
        let_go = jnp.where((here == worst) & ~blocked & ~done, 0.0, held)
        return BoxSolution(x, let_go, done)

    return jax.lax.fori_loop(0, steps, step, BoxSolution(x, side, jnp.asarray(False)))
