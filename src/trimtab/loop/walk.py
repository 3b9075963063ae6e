"""Simulation of the closed loop over all instants of a run, as one pure function.

At each instant, the blocks are computed in the order of the loop: sensors, downlink, autopilot, uplink, actuators. Then
the true state is integrated to the next instant.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Quantity, leaves, part, record
from trimtab.core.rng import Key
from trimtab.core.signals import Frame
from trimtab.core.time import Instant
from trimtab.loop.autopilot import Autopilot, AutopilotState
from trimtab.loop.structure import cast_like, step_if, strengthen_types
from trimtab.loop.world import World, WorldState


@record
class Signals:
    """Signals that are logged at one instant. The path of a field in this record is the signal's path in the log.

    Source:  docs page, Log.
    """

    truth: Any = part("State of the vehicle.")
    sensors: Any = part("Last sample of each sensor.")
    downlink: Any = part("Newest sample of each sensor received by the autopilot, with its age.")
    estimate: Any = part("Output of the estimator.")
    law: Any = part("Output of the law.")
    command: Any = part("Command as issued by the autopilot.")
    uplink: Any = part("Newest command received by the actuators, with its age.")
    actuators: Any = part("Output of the actuators.")
    supervisor: Any = part("Output of the supervisor, or empty without a supervisor.", default=())
    world: Any = part(
        "Diagnostics of the integrator since the previous instant, or empty for the default integrator.", default=()
    )
    predictor: Any = part("Output of the predictor, or empty without a predictor.", default=())
    monitor: Any = part("Output of the monitor for each formula, or empty without a monitor.", default=())
    gust: Any = part("Gust velocity at the vehicle due to turbulence, or empty without turbulence.", default=())


class WalkResult(NamedTuple):
    """Result of a run.

    rows: logged signals, float64 (n, width), one row per logged instant. x: true state at the end of the run. sensors:
    states of the sensors at the end. integrated: report of the integration after the last instant.
    """

    rows: Any
    x: Any
    sensors: Any
    integrated: Any


def start(world: World, autopilot: Autopilot, x: Any, key: Key) -> tuple[WorldState, AutopilotState]:
    """Return the initial states of world and autopilot, before the first instant.

    x: initial state of the vehicle. Raise InputError if parts of world and autopilot don't fit each other.
    """
    key_world, key_autopilot = key.at("world"), key.at("autopilot")
    s = world.init(key_world, x)
    a = autopilot.init(key_autopilot, Frame(t=jnp.zeros((), np.int64), samples=s.received))
    return strengthen_types(world.connect(key_world, s, a.command)), strengthen_types(a)


def instant(
    world: World, autopilot: Autopilot, clock: Instant, h: Any, s: WorldState, a: AutopilotState
) -> tuple[WorldState, AutopilotState, Signals]:
    """Return the states of world and autopilot at the next instant, and the signals of this instant.

    h: time to the next instant.
    """
    s, frame = world.sense(clock, s)
    due = clock.due(autopilot.period)
    a = step_if(due, lambda: autopilot.step(clock.t, a, frame)[0], lambda: autopilot.hold(clock.t, a))
    s = world.act(clock, s, a.command, due)
    return world.advance(clock.t, s, h), a, signals(s, a)


def drop_derived_outputs(
    world: World, autopilot: Autopilot, s: WorldState, a: AutopilotState, always: frozenset[int]
) -> tuple[WorldState, AutopilotState]:
    """Return the states of world and autopilot without outputs that are recomputed at every instant.

    A run is faster without these outputs. always: periods of the blocks that are computed at every instant.
    """
    return world.drop_derived_outputs(s, always), autopilot.drop_derived_outputs(a, always)


def signals(s: WorldState, a: AutopilotState) -> Signals:
    """Return the signals to log, from the states of world and autopilot."""
    return Signals(
        truth=s.x,
        sensors=s.sampled,
        downlink=s.received,
        estimate=a.estimate,
        law=a.output,
        command=a.command,
        uplink=s.commanded,
        actuators=s.actuated,
        supervisor=a.supervised,
        world=s.integrated,
        predictor=a.last_prediction(),
        monitor=a.last_verdicts(),
        gust=s.gust,
    )


def walk(
    world: World,
    autopilot: Autopilot,
    x: Any,
    key: Key,
    instants: tuple[Any, Any, Any],
    rows: int,
    always: frozenset[int],
    wanted: tuple[str, ...] = (),
) -> WalkResult:
    """Run the loop over all instants. Return the logged signals and the final states.

    Args:
        world, autopilot: world and autopilot of the loop.
        x: the vehicle's initial state.
        key: random key, made from the seed and the run number.
        instants: three arrays (n,): integer time of each instant, time to the next instant, and index of the log row to
            which the instant is written. Instants that are not logged are written to an unused row with index `rows`.
        rows: number of rows in the log.
        always: periods of the blocks that are computed at every instant.
        wanted: paths of the signals to log, see `logged_signals`. Empty: all signals.
    """
    s, a = start(world, autopilot, x, key)
    width = pack_row(signals(s, a), wanted).shape[0]

    def body(carry: Any, at: Any) -> Any:
        s, a, log = carry
        t, h, row = at
        new_s, new_a, seen = instant(world, autopilot, Instant(t, always), h, s, a)
        log = jax.lax.dynamic_update_slice(log, pack_row(seen, wanted)[None], (row, jnp.zeros_like(row)))
        new_s, new_a = drop_derived_outputs(world, autopilot, new_s, new_a, always)
        return (cast_like(new_s, s), cast_like(new_a, a), log), None

    carry = (*drop_derived_outputs(world, autopilot, s, a, always), jnp.zeros((rows + 1, width)))
    (s, _, log), _ = jax.lax.scan(body, carry, instants)
    return WalkResult(log[:rows], s.x, s.sensors, s.integrated)


def logged_signals(seen: Signals, wanted: tuple[str, ...] = ()) -> list[tuple[str, Any, Quantity]]:
    """Return path, value and declaration of each signal to log, in the order of the columns of a log row.

    wanted: paths of signals, or of records that contain signals. Empty: all signals.
    """
    return [
        (path, value, declared)
        for path, value, declared in leaves(seen)
        if isinstance(declared, Quantity) and (not wanted or any(path == w or path.startswith(w + ".") for w in wanted))
    ]


def pack_row(seen: Signals, wanted: tuple[str, ...]) -> Any:
    """Return the signals of one instant as a log row, float64 (width,). Integers below 2**53 are exact.

    The row is built with jnp.where instead of a concatenation. XLA's CPU backend would need more time to concatenate
    the scalars than for all other computations of the loop.
    """
    parts = [jnp.ravel(value).astype(np.float64) for _, value, _ in logged_signals(seen, wanted)]
    scalars = [part[i] for part in parts for i in range(part.shape[0])]
    column = np.arange(len(scalars))
    row = jnp.zeros(len(scalars))
    for i, scalar in enumerate(scalars):
        row = jnp.where(column == i, scalar, row)
    return row
