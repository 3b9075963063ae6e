"""Simulation, in virtual time, of a scenario whose vehicle is an FMU. All other parts of the loop are compiled.

The outputs of the FMU at each instant are the true state of the vehicle. Sensors, links, autopilot and actuators are
stepped with this state as in `simulate`. Then the FMU is stepped to the next instant, with the actuators' output as
its input.
"""

from collections.abc import Mapping
from time import monotonic_ns
from typing import Any

import jax
import numpy as np

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import CompiledBlock, compile_block
from trimtab.core.record import part, quantity, record, replace, to_arrays
from trimtab.core.signals import Command, Frame
from trimtab.core.time import Instant, Timetable, ms, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor
from trimtab.loop.structure import cast_like, step_if
from trimtab.loop.walk import logged_signals, signals
from trimtab.run.blocks import (
    WorldOutput,
    carried_structures,
    compile_world,
    has_stepped_vehicle,
    hold_vehicle,
    message_structures,
)
from trimtab.run.inputs import RunInputs, leaf_paths, run_inputs
from trimtab.run.program import RunResults, describe_scenario, logged_instants, make_log
from trimtab.run.runner import prepare_run
from trimtab.run.walk_structure import final_columns, row_columns, walk_structure
from trimtab.vehicles.fmu import FmuInstance

MEASURED_STEPS = 300


@record
class SteppedWorldInput:
    """Input of a compiled world whose vehicle is stepped by a host program.

    The record has the fields of `WorldInput`, and the fields `acts` and `truth`.

    Source: docs page, FMU.
    """

    t: Any = quantity("100 ns", "Time of the last instant, at which the command was issued.", kind="time")
    h: Any = quantity("100 ns", "Time from the last instant to this instant.", kind="time")
    first: Any = quantity("1", "True at the first instant, when no command has been issued yet.", kind="flag")
    is_held: Any = quantity(
        "1", "True if the vehicle is held in place, so that its true state doesn't change.", kind="flag"
    )
    fresh: Any = quantity("1", "True if the command is new at this instant.", kind="flag")
    command: Any = part("Latest command of the autopilot.")
    acts: Any = quantity(
        "1", "True if this step computes the actuators, False if it computes the sensors.", kind="flag"
    )
    truth: Any = part("True state of the vehicle at this instant.")


@record
class HostInput:
    """Input at one instant of a loop whose vehicle is stepped by a host program. Source: docs page, FMU."""

    t: Any = quantity("100 ns", "Present time.", kind="time")
    truth: Any = part("True state of the vehicle at this instant.")


def cosimulate(
    scenario: Scenario, *, seed: int = 0, run: int = 0, duration: int | None = None, log_period: int = ms(1)
) -> Log:
    """Run a scenario whose vehicle is an FMU, and return the log. Arguments and result are those of `simulate`.

    Raises:
        InputError: the FMU is not trusted, does not start or rejects a step, or no C compiler is found.

    If the FMU requests the end of the run before the scenario's duration, the log ends at this time, and the metadata
    contain the time as `ended_s`.
    """
    scenario, table, written = prepare_run(hold_vehicle(scenario), [seed], duration, log_period)
    inputs = run_inputs(scenario, seed, run)
    fmu = FmuInstance(scenario.world.vehicle)
    try:
        rows, count = _fly(compile_block(_host_block(inputs, table.always)), fmu, table, written)
        last = np.array(fmu.read())
    finally:
        fmu.close()
    table, written = table._replace(t=table.t[:count], h=table.h[:count]), written[:count]
    of = walk_structure(inputs, table.always, ())
    results = RunResults(log=rows[None], stats=None, final=last[None])
    about = describe_scenario(scenario)
    about |= {"seed": seed, "run": run, "log_period_s": to_seconds(log_period), "backend": "fmu"}
    if fmu.t < scenario.duration:
        about["ended_s"] = to_seconds(fmu.t)
    return make_log(row_columns(of), final_columns(of), results, 0, logged_instants(table, written), about)


def _fly(loop: CompiledBlock, fmu: FmuInstance, table: Timetable, written: Any) -> tuple[Any, int]:
    """Return the logged rows, and the number of instants that were run. The FMU may request an early end of the run."""
    truth = slot_indices(loop.reads, "truth.", len(loop.inputs))
    acting = slot_indices(loop.writes, "actuators.u.", len(loop.outputs))
    rows = list[Any]()
    for k, (t, h) in enumerate(zip(table.t.tolist(), table.h.tolist(), strict=True)):
        loop.inputs[loop.reads["t"]] = t
        loop.inputs[truth] = fmu.read()
        loop.step()
        if written[k]:
            rows.append(loop.outputs.copy())
        fmu.write(loop.outputs[acting])
        if fmu.step(h):
            return np.array(rows), k + 1
    return np.array(rows), len(table.t)


def slot_indices(where: Mapping[str, Any], prefix: str, size: int) -> Any:
    """Return the indices of all numbers whose path begins with `prefix`, in order.

    where: path of a leaf -> its index or slice in a vector.  size: length of this vector.
    """
    every = np.arange(size)
    found = [np.atleast_1d(every[at]) for path, at in where.items() if path.startswith(prefix)]
    return np.concatenate([np.zeros(0, np.intp), *found])


def _host_block(inputs: RunInputs, always: frozenset[int]) -> BlockDefinition:
    """Return the closed loop without the vehicle as a block with input `HostInput` and the loop's signals as output."""

    def init(p: RunInputs) -> Any:
        return p.drop_derived_outputs(*p.initial_states(), always)

    def step(p: RunInputs, state: Any, now: HostInput) -> Any:
        s, a = state
        clock = Instant(now.t, always)
        s, frame = p.world.sense(clock, replace(s, x=now.truth))
        due = clock.due(p.autopilot.period)
        a = step_if(due, lambda: p.autopilot.step(now.t, a, frame)[0], lambda: p.autopilot.hold(now.t, a))
        s = p.world.act(clock, s, a.command, due)
        seen = signals(s, a)
        logged = {path for path, _, _ in logged_signals(seen)}
        values, structure = jax.tree.flatten(seen)
        kept = structure.unflatten([v if p in logged else None for p, v in zip(leaf_paths(seen), values, strict=True)])
        return cast_like(p.drop_derived_outputs(s, a, always), state), kept

    first = HostInput(t=np.int64(0), truth=to_arrays(inputs.initial))
    return BlockDefinition("loop", "Closed loop around a vehicle that a host steps.", step, init, inputs, first)


def prepare_world(scenario: Scenario, *, seed: int = 0) -> tuple[Any, Frame, Command]:
    """Return a scenario's compiled world, and the structures of the frame and command that a real link transmits.

    If the vehicle is an FMU, only the other parts of the world are compiled. Raise InputError if no C compiler is
    found, or if the FMU is not trusted.
    """
    if not has_stepped_vehicle(scenario):
        return compile_world(scenario, seed=seed)
    return SteppedWorld(scenario, seed=seed), *carried_structures(scenario)


class SteppedWorld:
    """World whose vehicle is an FMU, with the interface of a compiled world: input `WorldInput`, output `WorldOutput`.

    After the FMU has requested the end of the run, the vehicle's state does not change any more.
    """

    def __init__(self, scenario: Scenario, *, seed: int = 0) -> None:
        """Compile the world without its vehicle, and start the FMU."""
        scenario = add_stick_sensor(scenario)
        scenario.check()
        self._block = compile_block(_stepped_block(hold_vehicle(scenario), seed))
        self._fmu, self._is_over = FmuInstance(scenario.world.vehicle), False
        self.inputs, self.outputs = self._block.inputs, self._block.outputs
        self.reads, self.writes = self._block.reads, self._block.writes
        self.parameters, self.text = self._block.parameters, self._block.text
        self._truth = slot_indices(self.reads, "truth.", len(self.inputs))
        self._acting = slot_indices(self.writes, "actuators.u.", len(self.outputs))

    def reset(self) -> None:
        """Reset the world to its initial state, and restart the FMU."""
        self._fmu.close()
        self._block.reset()
        self._fmu, self._is_over = FmuInstance(self._fmu.vehicle), False

    def measure_steps(self, h: int) -> float:
        """Return the 99th percentile of a step's computing time (s), then reset the world. h: step length (100 ns)."""
        took = list[int]()
        for k in range(MEASURED_STEPS):
            self.inputs[self.reads["t"]], self.inputs[self.reads["h"]] = max(k - 1, 0) * h, h if k else 0
            self.inputs[self.reads["first"]] = k == 0
            begin = monotonic_ns()
            self.step()
            took.append(monotonic_ns() - begin)
        self.reset()
        return sorted(took)[-len(took) // 100 - 1] * 1e-9

    def step(self) -> None:
        """Advance the world by one instant: step the actuators, then the FMU, then the sensors."""
        inputs, reads = self.inputs, self.reads
        if not inputs[reads["first"]]:
            inputs[reads["acts"]] = True
            self._block.step()
            if not inputs[reads["is_held"]] and not self._is_over:
                self._fmu.write(self.outputs[self._acting])
                self._is_over = self._fmu.step(int(inputs[reads["h"]]))
        inputs[self._truth] = self._fmu.read()
        inputs[reads["acts"]] = False
        self._block.step()


def _stepped_block(scenario: Scenario, seed: int) -> BlockDefinition:
    """Return a world without its vehicle as a block.

    The block is stepped twice per instant: first for the actuators, then for the sensors.
    """
    inputs = run_inputs(scenario, seed)

    def init(p: RunInputs) -> Any:
        return p.initial_states()[0]

    def step(p: RunInputs, s: Any, now: SteppedWorldInput) -> Any:
        def act() -> Any:
            return cast_like(p.world.act(Instant(now.t), s, now.command, now.fresh), s)

        def sense() -> Any:
            return cast_like(p.world.sense(Instant(now.t + now.h), replace(s, x=now.truth))[0], s)

        after = jax.lax.cond(now.acts, act, sense)
        seen = WorldOutput(after.x, after.sampled, after.received, after.commanded, after.actuated)
        return after, seen

    no, zero = np.bool_(False), np.int64(0)
    first = SteppedWorldInput(
        t=zero,
        h=zero,
        first=no,
        is_held=no,
        fresh=no,
        command=message_structures(scenario)[1],
        acts=no,
        truth=to_arrays(inputs.initial),
    )
    return BlockDefinition(
        "world", f"World of {scenario.name}, around a vehicle that a host steps.", step, init, inputs, first
    )
