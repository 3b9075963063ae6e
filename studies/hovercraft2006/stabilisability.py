"""Stabilisability: no smooth feedback holds position and heading.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 2.3.2.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from trimtab.core.signals import PlanarForce
from trimtab.design.stabilisability import brockett, byrnes_isidori, is_reachable
from trimtab.study import Row, same
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

jnp = jax.numpy
SECTION = "2.3.2"
PLACE = "[1] section 2.3.2"
CRAFT = Hovercraft()
M, J, ARM = CRAFT.mass, CRAFT.inertia, CRAFT.arm


def rows() -> Iterator[Row]:
    """Ranks and verdicts of both conditions."""
    found = byrnes_isidori(_f1, _f2, 3, 3, 2)
    yield same("byrnes-isidori/rank-f2", "rank of ∂f2/∂x1 at the origin", 3, found.rank_f2, PLACE)
    yield same("byrnes-isidori/rank-inputs", "independent inputs, of 3 momenta", 2, found.rank_inputs, PLACE)
    yield same(
        "byrnes-isidori/excluded", "position and heading: smooth stabiliser excluded", True, found.is_excluded, PLACE
    )
    turning = brockett(_turning_dynamics, 4, 2)
    rank = turning.controllability_rank
    yield same("brockett/rank", "controllability rank of momenta and heading, of 4", 3, rank, PLACE, basis="reference")
    yield same("brockett/excluded", "momenta and heading: smooth stabiliser excluded", True, turning.is_excluded, PLACE)
    draws = np.random.default_rng(3).uniform(-1e-2, 1e-2, (5, 3))
    on = sum(is_reachable(_turning_dynamics, [b1, b2, -ARM * b2, 0.0], 2) for b1, b2, _ in draws)
    off = sum(is_reachable(_turning_dynamics, [b1, b2, -ARM * b2 + b3, 0.0], 2) for b1, b2, b3 in draws)
    yield same("brockett/on-line", "right-hand sides with b3 = -d b2 reached, of 5", 5, int(on), PLACE)
    yield same("brockett/off-line", "right-hand sides off that line reached, of 5", 0, int(off), PLACE)


def _derivative(momenta: Any, pose: Any, force: Any) -> tuple[Any, Any]:
    """The vehicle in momenta: x1 = (PX, PY, Pi), x2 = (heading, north, east)."""
    x = HovercraftState(momenta[0] / M, momenta[1] / M, momenta[2] / J, pose[1], pose[2], pose[0])
    d = CRAFT.dynamics(0.0, x, PlanarForce(force[0], force[1]))
    x1 = jnp.stack([M * d.surge_velocity, M * d.sway_velocity, J * d.yaw_rate])
    return x1, jnp.stack([d.heading, d.north, d.east])


def _f1(x1: Any, u: Any) -> Any:
    return _derivative(x1, jnp.zeros(3), u)[0]


def _f2(x1: Any, x2: Any) -> Any:
    return _derivative(x1, x2, jnp.zeros(2))[1]


def _turning_dynamics(x: Any, u: Any) -> Any:
    x1, x2 = _derivative(x[:3], jnp.array([x[3], 0.0, 0.0]), u)
    return jnp.concatenate([x1, x2[:1]])
