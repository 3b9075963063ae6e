"""Stabilisability: no smooth feedback holds position and heading.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 2.3.1.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from studies.hovercraft2006._source import ARM
from trimtab.core.signals import PlanarForce
from trimtab.design.stabilisability import brockett, byrnes_isidori, is_reachable
from trimtab.study import Row, same
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

jnp = jax.numpy
SECTION = "2.3.1"
PLACE = "[1] section 2.3.1"
CRAFT = Hovercraft()
INPUTS = 2
"""Number of inputs: forces along and across the vehicle at the rudder pivot. A third would be a separate torque."""


def rows() -> Iterator[Row]:
    """Yield rows on the ranks and verdicts of the conditions by Byrnes and Isidori and by Brockett."""
    byrnes = byrnes_isidori(_f1, _f2, 3, 3, INPUTS)
    text: dict[str, Any] = {"basis": "text"}
    yield same("byrnes-isidori/rank-f2", "rank of ∂f2/∂x1 at the origin", 3, byrnes.rank_f2, PLACE, **text)
    what = "number of independent inputs for 3 momenta"
    yield same("byrnes-isidori/rank-inputs", what, 2, byrnes.rank_inputs, PLACE, **text)
    what = "position and heading: smooth stabiliser excluded"
    yield same("byrnes-isidori/excluded", what, True, bool(byrnes.is_excluded), PLACE, **text)
    turning = brockett(_turning_dynamics, 4, INPUTS)
    what = "momenta and heading: smooth stabiliser excluded"
    yield same("brockett/excluded", what, True, bool(turning.is_excluded), PLACE, **text)
    draws = np.random.default_rng(3).uniform(-1e-2, 1e-2, (5, 3))
    on = sum(is_reachable(_turning_dynamics, [b1, b2, -ARM * b2, 0.0], INPUTS) for b1, b2, _ in draws)
    off = sum(is_reachable(_turning_dynamics, [b1, b2, -ARM * b2 + b3, 0.0], INPUTS) for b1, b2, b3 in draws)
    yield same(
        "brockett/on-line", "right-hand sides on the line b3 = -d b2 that are reached, of 5", 5, int(on), PLACE, **text
    )
    yield same(
        "brockett/off-line",
        "right-hand sides off the line b3 = -d b2 that are reached, of 5",
        0,
        int(off),
        PLACE,
        **text,
    )


def _derivative(momenta: Any, pose: Any, force: Any) -> tuple[Any, Any]:
    """Return the derivatives of x1 = (PX, PY, Pi) and x2 = (heading, north, east).

    force: FX, FY, optionally a torque.
    """
    m, J = CRAFT.mass, CRAFT.inertia
    x = HovercraftState(momenta[0] / m, momenta[1] / m, momenta[2] / J, pose[1], pose[2], pose[0])
    d = CRAFT.dynamics(0.0, x, PlanarForce(force[0], force[1]))
    torque = jnp.sum(force[2:])
    x1 = jnp.stack([m * d.surge_velocity, m * d.sway_velocity, J * d.yaw_rate + torque])
    return x1, jnp.stack([d.heading, d.north, d.east])


def _f1(x1: Any, u: Any) -> Any:
    return _derivative(x1, jnp.zeros(3), u)[0]


def _f2(x1: Any, x2: Any) -> Any:
    return _derivative(x1, x2, jnp.zeros(2))[1]


def _turning_dynamics(x: Any, u: Any) -> Any:
    x1, x2 = _derivative(x[:3], jnp.array([x[3], 0.0, 0.0]), u)
    return jnp.concatenate([x1, x2[:1]])
