"""Blocks of a scenario that are compiled separately. Each block is a step function that is called once per instant.

The blocks "autopilot" and "world" together are the loop of `simulate`. They exchange frames (samples) and commands,
compute in the same order as `simulate`, and produce the same numbers (docs page, Time). The blocks "uplink", "failsafe"
and "motion" are parts of the program of a vehicle. A virtual vehicle and a microcontroller use these blocks.
"""

import functools
from typing import Any

import jax
import numpy as np

from trimtab.actuators.failsafe import Failsafe, FailsafeInput
from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import part, quantity, record, replace, to_arrays, tree_where
from trimtab.core.rng import key as root_key
from trimtab.core.signals import Command, Frame, Sample
from trimtab.core.time import Instant, to_seconds
from trimtab.environment.geodetic import TangentPlane
from trimtab.links.wire import Wire
from trimtab.loop.faults import DELAYED, FaultyChannel, delay_slots
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor, empty_sticks
from trimtab.loop.structure import cast_like, zeros_like
from trimtab.loop.swarm import Swarm
from trimtab.loop.walk import Signals, instant, logged_signals
from trimtab.run.inputs import RunInputs, leaf_paths, run_inputs
from trimtab.run.kept_blocks import MOST_KEPT, Content, compile_kept

UNLIMITED = 3e38
"""Limit used for a command that declares no limits. Nearly every finite float32 is within this limit."""


@record
class StepInput:
    """Input of a block, with the time of the step. Source: docs page, Vehicle."""

    t: Any = quantity("100 ns", "Present time.", kind="time")
    input: Any = part("Input of the block at this step.")


@record
class AutopilotOutput:
    """Output of an exported autopilot at each step. Source: docs page, Export."""

    command: Any = part("Command for the actuators.")
    estimate: Any = part("Output of the estimator.")
    law: Any = part("Output of the law.")
    supervisor: Any = part("Output of the supervisor, or empty without a supervisor.", default=())
    predictor: Any = part("Output of the predictor, or empty without a predictor.", default=())
    monitor: Any = part("Output of the monitor for each formula, or empty without a monitor.", default=())


@record
class LoopInput:
    """Input of an exported closed loop at each step: time and step length. Source: docs page, Export."""

    t: Any = quantity("100 ns", "Present time.", kind="time")
    h: Any = quantity("100 ns", "Time from this instant to the next.", kind="time")


@record
class WorldInput:
    """Input of a compiled world at each instant. Source: docs page, World step."""

    t: Any = quantity("100 ns", "Time of the last instant, at which the command was issued.", kind="time")
    h: Any = quantity("100 ns", "Time from the last instant to this instant.", kind="time")
    first: Any = quantity("1", "True at the first instant, when no command has been issued yet.", kind="flag")
    is_held: Any = quantity(
        "1", "True if the vehicle is held in place, so that its true state doesn't change.", kind="flag"
    )
    fresh: Any = quantity("1", "True if the command is new at this instant.", kind="flag")
    command: Any = part("Command of the autopilot.")


@record
class WorldOutput:
    """Output of a compiled world at each instant. Source: docs page, World step."""

    truth: Any = part("True state of the vehicle at this instant.")
    sensors: Any = part("Last sample of each sensor at this instant.")
    downlink: Any = part("Newest sample of each sensor that the autopilot has received at this instant.")
    uplink: Any = part("Newest command that the actuators had received at the last instant.")
    actuators: Any = part("Output of the actuators since the previous instant.")
    gust: Any = part(
        "Gust velocity at the vehicle due to turbulence, at this instant, or empty without turbulence.", default=()
    )


@record
class UplinkParameters:
    """Parameters of the block "uplink". Source: docs page, Vehicle."""

    uplink: Any = part("Channel from the radio link to the failsafe.")
    key: Any = part("Seed and run number, from which the random numbers are generated.")


def has_stepped_vehicle(scenario: Scenario) -> bool:
    """Return True if the scenario's vehicle is simulated by another program, i.e. an FMU. It can't be compiled."""
    return optional_member(scenario.world.vehicle, "is_stepped") is not None


def hold_vehicle(scenario: Scenario) -> Scenario:
    """Return the scenario with its FMU vehicle marked as stepped by a host program.

    A scenario without an FMU is returned unchanged.
    """
    if not has_stepped_vehicle(scenario):
        return scenario
    world = scenario.world
    return replace(scenario, world=replace(world, vehicle=replace(world.vehicle, is_stepped=True)))


def refuse_stepped_vehicle(scenario: Scenario) -> None:
    """Raise InputError if the scenario's vehicle is an FMU, which can't be compiled. Call this before all other
    checks."""
    if has_stepped_vehicle(scenario):
        scenario.world.vehicle.dynamics(0.0, scenario.initial, None)


def refuse_swarm(scenario: Scenario, end: str) -> None:
    """Raise InputError if the scenario's vehicle is a swarm.

    end: name of the program that needs a single vehicle, e.g. "firmware", for the message.
    """
    swarm = scenario.world.vehicle
    if isinstance(swarm, Swarm):
        problem = f"{end} is for one vehicle, but this is a swarm of {swarm.count} craft, which no link supports"
        fix = "use a scenario of one craft, e.g. hovercraft/forward. To export one craft of the swarm as C code:"
        raise InputError(
            f"scenario {scenario.name!r}", problem, fix=f"{fix}  trimtab export FILE.py:function  (docs, Swarms)"
        )


def message_structures(scenario: Scenario) -> tuple[Frame, Command]:
    """Return the structures of a scenario's frame and command, with every number zero.

    Raise InputError if parts of the scenario don't fit each other.
    """
    return _keep_structures(Content(hold_vehicle(scenario)))


@functools.lru_cache(MOST_KEPT)
def _keep_structures(content: Content) -> tuple[Frame, Command]:
    (scenario,) = content.records
    s, a = jax.eval_shape(lambda: run_inputs(scenario).initial_states())
    return zeros_like((Frame(t=np.int64(0), samples=s.received), a.command))


def carried_structures(scenario: Scenario) -> tuple[Frame, Command]:
    """Return the structures of the frame and command that a real link transmits, with every number zero.

    The frame contains no samples of a stick that a pilot moves at the ground station, because the autopilot reads this
    stick there.
    """
    scenario = add_stick_sensor(scenario)
    frame, command = message_structures(scenario)
    away = empty_sticks(scenario)
    return replace(frame, samples={n: s for n, s in frame.samples.items() if n not in away}), command


def autopilot_block(scenario: Scenario, *, seed: int = 0, run: int = 0) -> BlockDefinition:
    """Return the autopilot of a checked scenario as a block with input `Frame` and output `AutopilotOutput`.

    seed, run: seed and run number of the random numbers in the autopilot's initial state.
    """
    inputs = run_inputs(scenario, seed, run)
    frame, key = message_structures(scenario)[0], inputs.key
    always = frozenset([inputs.autopilot.period])

    def init(p: Any) -> Any:
        return p.drop_derived_outputs(p.init(key.at("autopilot"), frame), always)

    def step(p: Any, s: Any, now: Frame) -> Any:
        after, command = p.step(now.t, s, now)
        said = after.supervised, after.last_prediction(), after.last_verdicts()
        output = AutopilotOutput(command, after.estimate, after.output, *said)
        return p.drop_derived_outputs(after, always), output

    doc = f"Autopilot of {scenario.name}: one step every {to_seconds(inputs.autopilot.period) * 1e3:g} ms."
    return BlockDefinition("autopilot", doc, step, init, inputs.autopilot, frame)


def compile_autopilot(scenario: Scenario, *, seed: int = 0) -> CompiledBlock:
    """Return a scenario's autopilot as a compiled block.

    Raise InputError if the autopilot cannot be exported (see `export_c`), or if no C compiler is found.
    """
    scenario.check()
    return compile_kept(autopilot_block, scenario, seed=seed)


def loop_block(scenario: Scenario, always: frozenset[int], *, seed: int = 0) -> BlockDefinition:
    """Return the closed loop of a checked scenario as a block with input `LoopInput` and the loop's signals as output.

    The diagnostics of the integration are left out: they depend on rounding, as differences of nearly equal numbers.

    always: periods of the parts of the loop that run at every instant.
    """

    def init(p: RunInputs) -> Any:
        return p.drop_derived_outputs(*p.initial_states(), always)

    def step(p: RunInputs, state: Any, now: LoopInput) -> Any:
        s, a, seen = instant(p.world, p.autopilot, Instant(now.t, always), now.h, *state)
        return cast_like(p.drop_derived_outputs(s, a, always), state), _keep_logged(replace(seen, world=()))

    doc = f"Closed loop of {scenario.name}: world and autopilot, one step an instant."
    inputs = run_inputs(scenario, seed)
    return BlockDefinition("loop", doc, step, init, inputs, LoopInput(t=np.int64(0), h=np.int64(0)))


def _keep_logged(seen: Signals) -> Signals:
    """Return the signals with None in place of signals that a log cannot contain, e.g. messages between craft."""
    logged = {path for path, _, _ in logged_signals(seen)}
    values, structure = jax.tree.flatten(seen)
    return structure.unflatten([v if p in logged else None for p, v in zip(leaf_paths(seen), values, strict=True)])


def world_block(scenario: Scenario, *, seed: int = 0) -> BlockDefinition:
    """Check a scenario, and return its world as a block with input `WorldInput` and output `WorldOutput`.

    A step advances the world from the last instant to this instant. The input contains the command of the last instant.
    The output contains the frame of this instant.
    """
    scenario = add_stick_sensor(scenario)
    scenario.check()

    def init(p: RunInputs) -> Any:
        return p.initial_states()[0]

    def advance(p: RunInputs, s: Any, now: WorldInput) -> Any:
        s = p.world.act(Instant(now.t), s, now.command, now.fresh)
        after = p.world.advance(now.t, s, now.h)
        return replace(after, x=tree_where(now.is_held, s.x, after.x))

    def step(p: RunInputs, s: Any, now: WorldInput) -> Any:
        after = jax.lax.cond(now.first, lambda: s, lambda: cast_like(advance(p, s, now), s))
        after, _ = p.world.sense(Instant(now.t + now.h), after)
        output = WorldOutput(
            truth=after.x,
            sensors=after.sampled,
            downlink=after.received,
            uplink=after.commanded,
            actuators=after.actuated,
            gust=after.gust,
        )
        return cast_like(after, s), output

    no, zero = np.bool_(False), np.int64(0)
    command = message_structures(scenario)[1]
    first = WorldInput(t=zero, h=zero, first=no, is_held=no, fresh=no, command=command)
    doc = f"World of {scenario.name}: one step an instant, at most {to_seconds(scenario.world.max_step) * 1e3:g} ms."
    return BlockDefinition("world", doc, step, init, run_inputs(scenario, seed), first)


def compile_world(scenario: Scenario, *, seed: int = 0) -> tuple[CompiledBlock, Frame, Command]:
    """Return a scenario's compiled world, and the structures of the frame and command that a real link transmits.

    Raise InputError if no C compiler is found.
    """
    return compile_kept(world_block, scenario, seed=seed), *carried_structures(scenario)


def timed_block(name: str, doc: str, block: Any, input: Any) -> BlockDefinition:
    """Return a part with a function step(t, state, input) -> (state, output) as a block with input `StepInput`."""

    def step(p: Any, s: Any, now: StepInput) -> Any:
        return p.step(now.t, s, now.input)

    return BlockDefinition(name, doc, step, lambda p: p.init(), to_arrays(block), StepInput(t=np.int64(0), input=input))


def failsafe_block(failsafe: Failsafe, command: Command) -> BlockDefinition:
    """Return a failsafe as a block. command: example of a command."""
    no, value = np.bool_(False), zeros_like(command.value)
    first = FailsafeInput(
        command=_no_sample(value), manual=value, takeover=no, radio=no, arm=no, disarm=no, breach=np.int32(0)
    )
    return timed_block(
        "failsafe",
        "Failsafe: the vehicle's behaviour without commands, and the authority to command it.",
        failsafe,
        first,
    )


def choose_failsafe(scenario: Scenario, command: Command) -> Failsafe:
    """Return the failsafe of the scenario or, if missing, that of the command's record, or else the default failsafe.

    The default failsafe accepts all finite numbers, and sets all commands to zero when no commands arrive.
    """
    if isinstance(scenario.failsafe, Failsafe):
        return scenario.failsafe
    if (failsafe := optional_member(command.value, "failsafe")()) is not None:
        return failsafe

    def fill(number: float) -> Any:
        return jax.tree.map(lambda v: np.full(np.shape(v), number), command.value)

    return Failsafe(safe=fill(0.0), low=fill(-UNLIMITED), high=fill(UNLIMITED))


def uplink_block(uplink: Any, command: Command, *, seed: int = 0) -> BlockDefinition:
    """Return the channel between a real link and the failsafe as a block.

    The block's input is a sample with a received command, its output a sample with the command for the failsafe.
    command: example of a command.
    """
    newest = _no_sample(zeros_like(command.value))

    def init(p: UplinkParameters) -> Any:
        return p.uplink.init(p.key.at("uplink"), newest)

    def step(p: UplinkParameters, s: Any, now: StepInput) -> Any:
        after, received = p.uplink.step(now.t, s, now.input["command"])
        return cast_like(after, s), {"command": received}

    parameters = UplinkParameters(uplink=to_arrays(uplink), key=root_key(seed))
    first = StepInput(t=np.int64(0), input={"command": newest})
    doc = "Receiving end of the uplink: gives the failsafe's input."
    return BlockDefinition("uplink", doc, step, init, parameters, first)


def _no_sample(value: Any) -> Sample:
    no = np.bool_(False)
    return Sample(value=value, t=np.int64(0), age=np.float64(0), fresh=no, valid=no)


def motion_block(scenario: Scenario) -> BlockDefinition:
    """Return the block that computes a vehicle's motion from its state, e.g. for displays.

    The block has the inputs `input.truth` (state of the vehicle) and `input.u` (input of the vehicle).
    """
    inputs = run_inputs(hold_vehicle(scenario))
    s, _ = jax.eval_shape(inputs.initial_states)
    state, u = zeros_like((s.x, s.actuated.u))

    def step(p: Any, s: Any, now: StepInput) -> Any:
        return s, p.motion(now.t, now.input["truth"], now.input["u"])

    first = StepInput(t=np.int64(0), input={"truth": state, "u": u})
    return BlockDefinition("motion", "Motion of a vehicle.", step, lambda p: (), inputs.world.vehicle, first)


def place_block() -> BlockDefinition:
    """Return the block that converts a position `p_WB` in the world frame W to latitude, longitude and height.

    The block's parameters are the latitude and longitude of the origin of W. Source: docs page, Earth.
    """

    def step(p: Any, s: Any, now: Any) -> Any:
        return s, dict(zip(("latitude", "longitude", "height"), p.from_ned(now["p_WB"]), strict=True))

    plane, zero = TangentPlane(latitude=0.0, longitude=0.0), {"p_WB": np.zeros(3)}
    return BlockDefinition("place", "Position of a vehicle on the globe.", step, lambda p: (), to_arrays(plane), zero)


def replace_links(scenario: Scenario) -> Scenario:
    """Return the scenario with ideal channels in place of its simulated links, for a flight over a real link.

    The real link has its own delays and losses. Faults of the simulated links are kept.
    """
    world = scenario.world
    downlink, uplink = _replace_with_wire(world.downlink), _replace_with_wire(world.uplink)
    return replace(scenario, world=replace(world, downlink=downlink, uplink=uplink))


def _replace_with_wire(channel: Any) -> Any:
    if not isinstance(channel, FaultyChannel):
        return Wire()
    inner = _replace_with_wire(channel.inner)
    slots = delay_slots(float(channel.fault.severity), inner.period) if int(channel.fault.kind) == DELAYED else 0
    return replace(channel, inner=inner, capacity=max(channel.capacity, slots))
