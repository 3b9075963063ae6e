"""Simulated world at the vehicle's end of a link. It receives commands, advances from instant to instant, and packs
sensor samples.

Source: docs page, Vehicle.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.errors import InputError, argument
from trimtab.core.time import format_time, to_seconds
from trimtab.flight.exchange import MessageGroup, command_group, sample_groups, slot_indices
from trimtab.flight.flight_log import LogSource
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.loop.scenario import Scenario
from trimtab.run.cosimulation import SteppedWorld

ACTUATION_PREFIXES = ("uplink.", "actuators.")
"""Prefixes of the world's outputs that are valid at the start of a time step. All other outputs are valid at the end of
the step."""
NO_TIME = np.iinfo(np.int64).min
PACE, PACED_INSTANTS = 0.5, 200
"""Largest computing time of an FMU's step, as a fraction of the shortest interval between instants, and number of
instants from which this interval is found.
"""


class VirtualVehicle:
    """Compiled simulation of a vehicle, independent of clocks and transports. The first call of `advance` must be to
    time 0."""

    def __init__(self, scenario: Scenario, dialect: Dialect, world: CompiledBlock) -> None:
        """world: the compiled world of this scenario."""
        self.world, self.scenario = world, scenario
        self.command: MessageGroup = command_group(dialect, lambda p: world.reads[p])
        self.samples: dict[str, MessageGroup] = sample_groups(dialect, lambda p: world.writes[f"downlink{p[7:]}"])
        reads, writes = world.reads, world.writes
        self._input_slots: tuple[Any, ...] = tuple(reads[n] for n in ("t", "h", "first", "is_held", "fresh"))
        self._sample_slots: dict[str, tuple[Any, Any]] = {
            s: (writes[f"downlink.{s}.t"], writes[f"downlink.{s}.valid"]) for s in self.samples
        }
        self._sent_times: dict[str, Any] = dict.fromkeys(self.samples, NO_TIME)
        self.t = self.row_t = 0
        self.row: Any = np.zeros(len(world.outputs))
        """Values of all outputs at `row_t`, the last instant before `t`, as in a log row of `simulate`. They include
        the actuation from `row_t` on.
        """
        paths = [p for p in writes if p.startswith(ACTUATION_PREFIXES)]
        self._actuation_slots = slot_indices(writes, paths, len(world.outputs))
        self._last_outputs: Any = np.zeros(len(world.outputs))
        self._has_begun = False

    def instants(self) -> Iterator[int]:
        """Return an endless iterator over the times of the instants for `advance`, from 0 on."""
        world = self.scenario.world
        return instants([*world.periods(), self.scenario.autopilot.period], world.max_step)

    def advance(self, t: int, *, fresh: bool, is_held: bool = False) -> None:
        """Advance the simulation to integer time t, with the command that was written into the world's inputs at the
        last instant.

        fresh: True if the command is new.  is_held: True to hold the vehicle in place. Its true state then does not
        change.
        """
        inputs = self.world.inputs
        at_t, at_h, at_first, at_held, at_fresh = self._input_slots
        inputs[at_t], inputs[at_h] = self.t, t - self.t
        inputs[at_first], inputs[at_held], inputs[at_fresh] = not self._has_begun, is_held, fresh
        self.world.step()
        outputs, row = self.world.outputs, self.row
        row[:] = self._last_outputs
        row[self._actuation_slots] = outputs[self._actuation_slots]
        self._last_outputs[:] = outputs
        self.row_t, self.t, self._has_begun = self.t, t, True

    def log_sources(self) -> list[LogSource]:
        """Return the output vector of the vehicle's world as the source of its log rows."""
        return [LogSource(self.row, self.world.text.outputs, lambda p: p)]

    def final_truth(self) -> dict[str, Any]:
        """Return the current true state, by path, which a log stores as final values."""
        return {p: np.array(self.world.outputs[at]) for p, at in self.world.writes.items() if p.startswith("truth.")}

    def changed_sensors(self) -> list[str]:
        """Return the names of the sensors with a new sample since the last call."""
        outputs, sensors = self.world.outputs, list[str]()
        for sensor, (time, valid) in self._sample_slots.items():
            if outputs[valid] and outputs[time] != self._sent_times[sensor]:
                self._sent_times[sensor] = outputs[time]
                sensors.append(sensor)
        return sensors

    def sample_packets(self, endpoint: Endpoint, sensors: list[str]) -> list[bytes]:
        """Return the packets of the newest samples of these sensors."""
        return [packet for s in sensors for packet in self.samples[s].pack(endpoint, self.world.outputs)]


def instants(periods: list[int], max_step: int) -> Iterator[int]:
    """Yield all multiples of the periods from 0 on, in increasing order. A gap longer than max_step is split evenly."""
    t, distinct = 0, sorted(set(periods))
    yield 0
    while True:
        due = min((t // p + 1) * p for p in distinct)
        parts = -(-(due - t) // max_step)
        for k in range(1, parts + 1):
            yield t + k * (due - t) // parts
        t = due


def check_pace(world: Any, scenario: Scenario) -> None:
    """Measure the computing time of an FMU's steps. Raise InputError if a step takes over half of the shortest interval
    between instants."""
    if not isinstance(world, SteppedWorld):
        return
    periods = [*scenario.world.periods(), scenario.autopilot.period]
    times = list(itertools.islice(instants(periods, scenario.world.max_step), PACED_INSTANTS))
    shortest = min(b - a for a, b in itertools.pairwise(times))
    took = world.measure_steps(shortest)
    if took > PACE * to_seconds(shortest):
        problem = (
            f"computing a step of the FMU takes {took * 1e3:.3g} ms here, too long for a step every "
            f"{format_time(shortest)}"
        )
        fix = f"{argument('lockstep', True)} on both sides, or {argument('settings', '50 ms', 'world.max_step')}"
        raise InputError(f"{scenario.name} in real time", problem, fix=fix)
