"""How a vehicle moves, compiled: its `motion`, for whoever wants to see it and not its state's own numbers.

Source: docs page, Vehicle.
"""

from typing import Any

import numpy as np

from trimtab.compiler.block import Exported, export_step
from trimtab.core.float64 import jax
from trimtab.core.record import numeric, part, quantity, record
from trimtab.core.rng import Key
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import start


@record
class Posture:
    """What the motion is told of. Source: docs page, Vehicle."""

    t: Any = quantity("100 ns", "Now.", kind="time")
    truth: Any = part("State of the vehicle.")
    u: Any = part("What acts on it.")


def motion_step(scenario: Scenario, *, name: str = "motion") -> Exported:
    """The text of a vehicle's motion; its inputs are named as in a world's outputs, but for "actuators."."""
    world, autopilot, x = numeric(scenario.world), numeric(scenario.autopilot), numeric(scenario.initial)
    key = Key(np.uint32(0), np.uint32(0))
    s, _ = jax.eval_shape(lambda: start(world, autopilot, x, key))
    state, u = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), (s.x, s.actuated.u))
    return export_step(
        name,
        "How a vehicle moves.",
        world.vehicle,
        lambda p: (),
        lambda p, s, now: (s, p.motion(now.t, now.truth, now.u)),
        Posture(t=np.int64(0), truth=state, u=u),
        "f64",
    )
