"""The compiled step of a world, from one instant to the next: what a virtual vehicle runs.

A run is `simulate` taken apart at the two messages: a step is given the command of the last instant, and gives the
frame of this one. Same order of things, same numbers (docs page, Time).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.block import ExportedBlock, export_step
from trimtab.core.record import part, quantity, record, replace, to_arrays, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Command, Frame
from trimtab.core.time import Clock, to_seconds
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import start
from trimtab.run.fast_step import FastStep


@record
class WorldInput:
    """What a world is given at each instant. Source: docs page, World step."""

    t: Any = quantity("100 ns", "The last instant, at which the command was issued.", kind="time")
    h: Any = quantity("100 ns", "Time from then to now.", kind="time")
    first: Any = quantity("1", "Now is the first instant: there was no command yet.", kind="flag")
    held: Any = quantity("1", "The vehicle is held: its true state stays as it is.", kind="flag")
    fresh: Any = quantity("1", "Whether the command is a new one.", kind="flag")
    command: Any = part("The command.")


@record
class WorldOutput:
    """What a world gives. Source: docs page, World step."""

    truth: Any = part("State of the vehicle, now.")
    sensors: Any = part("Last sample of each sensor, now.")
    downlink: Any = part("Sample of each sensor at the far end of its channel, now: the frame.")
    uplink: Any = part("The command as the actuators held it, at the last instant.")
    actuators: Any = part("What the actuators did from the last instant on.")


class WorldBlock(NamedTuple):
    """An exported world. text: its C.  frame, command: structures of the two messages, every number zero."""

    text: ExportedBlock
    frame: Frame
    command: Command


@record
class WorldParameters:
    """Parameters of an exported world. Source: docs page, World step."""

    world: Any = part("Vehicle, sensors, links and actuators.")
    autopilot: Any = part("What will fly it, for the structure of its commands.")
    initial: Any = part("First state of the vehicle.")
    key: Any = part("Seed and run of the random numbers.")


def message_structures(scenario: Scenario) -> tuple[Frame, Command]:
    """The structures of a scenario's frame and command, every number zero; refuses parts that don't fit each other."""
    world, autopilot, x = to_arrays(scenario.world), to_arrays(scenario.autopilot), to_arrays(scenario.initial)
    s, a = jax.eval_shape(lambda: start(world, autopilot, x, Key(np.uint32(0), np.uint32(0))))
    seen = Frame(t=jax.ShapeDtypeStruct((), np.int64), samples=s.received)
    frame, command = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), (seen, a.command))
    return frame, command


def world_step(
    scenario: Scenario, *, name: str = "world", real: str = "f64", seed: int = 0, run: int = 0
) -> WorldBlock:
    """The text of a checked scenario's world. real: "f64" or "f32"."""
    scenario.check()
    frame, command = message_structures(scenario)
    whole = WorldParameters(
        world=to_arrays(scenario.world),
        autopilot=to_arrays(scenario.autopilot),
        initial=to_arrays(scenario.initial),
        key=Key(np.uint32(seed), np.uint32(run)),
    )
    none = np.bool_(False)
    given = WorldInput(t=np.int64(0), h=np.int64(0), first=none, held=none, fresh=none, command=command)

    def init(p: WorldParameters) -> Any:
        return start(p.world, p.autopilot, p.initial, p.key)[0]

    def passed(p: WorldParameters, s: Any, turn: WorldInput) -> Any:
        s = p.world.act(Clock(turn.t), s, turn.command, turn.fresh)
        return replace(s, x=tree_where(turn.held, s.x, p.world.advance(turn.t, s, turn.h).x))

    def step(p: WorldParameters, s: Any, turn: WorldInput) -> Any:
        after = jax.lax.cond(turn.first, lambda: s, lambda: _cast_like(passed(p, s, turn), s))
        after, _ = p.world.sense(Clock(turn.t + turn.h), after)
        sight = WorldOutput(
            truth=after.x,
            sensors=after.sampled,
            downlink=after.received,
            uplink=after.commanded,
            actuators=after.actuated,
        )
        return _cast_like(after, s), sight

    doc = f"World of {scenario.name}: one step an instant, at most {to_seconds(scenario.world.max_step) * 1e3:g} ms."
    return WorldBlock(export_step(name, doc, whole, init, step, given, real), frame, command)


def _cast_like(tree: Any, pattern: Any) -> Any:
    return jax.tree.map(lambda new, old: jax.numpy.asarray(new, old.dtype), tree, pattern)


def compile_world(scenario: Scenario, *, seed: int = 0, run: int = 0) -> tuple[FastStep, Frame, Command]:
    """The compiled world of a scenario, and the structures of its two messages; refused without a C compiler."""
    built = world_step(scenario, seed=seed, run=run)
    return FastStep(built.text), built.frame, built.command


def instants(periods: list[int], max_step: int) -> Iterator[int]:
    """All instants from 0 on at which a period is due, gaps longer than max_step split evenly: `timetable` unending."""
    t, distinct = 0, sorted(set(periods))
    yield 0
    while True:
        due = min((t // p + 1) * p for p in distinct)
        parts = -(-(due - t) // max_step)
        for k in range(1, parts + 1):
            yield t + k * (due - t) // parts
        t = due
