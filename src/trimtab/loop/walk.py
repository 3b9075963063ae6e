"""The walk over the instants of a run: the whole closed loop as one pure function of records.

At one instant the order is that of the loop: truth, sensors, downlink, autopilot, uplink, actuators; then the truth is
integrated to the next instant.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import record, part
from trimtab.core.rng import Key
from trimtab.core.time import Clock
from trimtab.loop.autopilot import Autopilot, AutopilotState
from trimtab.loop.structure import like, step_if, strong
from trimtab.loop.world import World, WorldState


@record
class Signals:
    """All that is logged at one instant; a field's path is the signal's name in the log. Source: docs page, Log."""

    truth: Any = part("State of the vehicle.")
    sensors: Any = part("Last sample of each sensor.")
    downlink: Any = part("Sample of each sensor as the autopilot holds it, with its age.")
    estimate: Any = part("The estimate.")
    law: Any = part("Output of the law.")
    command: Any = part("The command as issued.")
    uplink: Any = part("The command as the actuators hold it, with its age.")
    actuators: Any = part("What the actuators do.")


class Walked(NamedTuple):
    """rows: float64 (n, width), the logged signals flattened; last: signals at the end, for their structure; x: truth."""

    rows: Any
    last: Signals
    x: Any


def start(world: World, autopilot: Autopilot, x: Any, key: Key) -> tuple[WorldState, AutopilotState]:
    """States at rest before the first instant; refuses parts that don't fit each other."""
    key_world, key_autopilot = key.at("world"), key.at("autopilot")
    s = world.init(key_world, x)
    _, frame = jax.eval_shape(lambda s: world.sense(Clock(np.int64(0)), s), s)
    a = autopilot.init(key_autopilot, frame)
    return strong(world.connect(key_world, s, a.command)), strong(a)


def instant(
    world: World, autopilot: Autopilot, clock: Clock, h: Any, s: WorldState, a: AutopilotState
) -> tuple[WorldState, AutopilotState, Signals]:
    """Everything that happens at one instant, then the truth up to the next, h later."""
    s, frame = world.sense(clock, s)
    due = clock.due(autopilot.period)
    a = step_if(due, lambda: autopilot.step(clock.t, a, frame)[0], lambda: autopilot.hold(clock.t, a))
    acted = world.act(clock, s, a.command, due)
    return world.advance(clock.t, acted, h), a, signals(acted, a)


def signals(s: WorldState, a: AutopilotState) -> Signals:
    """What is logged of the two states."""
    return Signals(
        truth=s.x,
        sensors=s.sampled,
        downlink=s.received,
        estimate=a.estimate,
        law=a.output,
        command=a.command,
        uplink=s.commanded,
        actuators=s.actuated,
    )


def walk(
    world: World, autopilot: Autopilot, x: Any, key: Key, instants: tuple[Any, Any, Any], rows: int, always: frozenset[int]
) -> Walked:
    """Run the loop over all instants.

    Args:
        world, autopilot: the two sides.
        x: the vehicle's first state.
        key: seed and run.
        instants: integer time (n,), time to the next (n,), and the row of the log that each instant writes, (n,);
            row `rows` is scratch for instants that are not logged.
        rows: length of the log.
        always: periods that are due at every instant.
    """
    s, a = start(world, autopilot, x, key)
    pack = _packer()
    width = pack(signals(s, a)).shape[0]

    def body(carry: Any, at: Any) -> Any:
        s, a, log = carry
        t, h, row = at
        new_s, new_a, seen = instant(world, autopilot, Clock(t, always), h, s, a)
        log = jax.lax.dynamic_update_slice(log, pack(seen)[None], (row, 0))
        return (like(new_s, s), like(new_a, a), log), None

    carry = (s, a, jnp.zeros((rows + 1, width)))
    (s, a, log), _ = jax.lax.scan(body, carry, instants)
    return Walked(log[:rows], signals(s, a), s.x)


def _packer() -> Any:
    def pack(seen: Signals) -> Any:
        return jnp.concatenate([jnp.ravel(leaf).astype(np.float64) for leaf in jax.tree.leaves(seen)])

    return pack
