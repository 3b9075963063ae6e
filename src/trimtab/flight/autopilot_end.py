"""Autopilot's end of a link: it receives sensor samples, runs the compiled autopilot once per control period, and packs
commands.

Source: docs page, Fly.
"""

import functools
from typing import Any

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.interfaces import optional_member
from trimtab.flight.exchange import MessageGroup, command_group, sample_groups
from trimtab.flight.flight_log import FlightRows, LogSource
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.monitored import CompiledMonitor
from trimtab.flight.sample_clock import SampleClock
from trimtab.flight.sample_queue import SampleCounts, SampleQueue
from trimtab.logs.frames import roll_pitch_yaw
from trimtab.logs.spatial import find_spatial
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import carried_structures

ESTIMATE = "estimate.state."
ESTIMATED_POSE = {"north": 0, "east": 1, "heading": 5}
"""Index of north, east and heading (rad) of the estimate in a pose, whose layout is that of `logs.frames`."""


class EstimatedPose:
    """Reader of the estimated position and attitude in the outputs of a compiled autopilot."""

    def __init__(self, step: CompiledBlock) -> None:
        """step: compiled autopilot, whose outputs contain the estimate."""
        self._step = step
        paths = [f"{ESTIMATE}{name}" for name in ESTIMATED_POSE]
        self._slots: list[Any] = [step.writes[path] for path in paths if path in step.writes]

    def fill(self, pose: Any) -> None:
        """Write the estimated position and attitude, if any, into `pose`, with the layout of `logs.frames`."""
        if self._spatial_slots is not None:
            place, attitude = self._spatial_slots
            pose[:3] = self._step.outputs[place]
            pose[3:6] = roll_pitch_yaw(self._step.outputs[attitude].tolist())
        elif len(self._slots) == len(ESTIMATED_POSE):
            pose[:6] = 0.0
            pose[list(ESTIMATED_POSE.values())] = self._step.outputs[self._slots]

    @functools.cached_property
    def _spatial_slots(self) -> tuple[Any, Any] | None:
        """Indices of position and attitude in the autopilot's output vector, or None if the estimate is not a 3-D
        position in the world frame W."""
        signals = [s for s in FlightRows(step_sources(self._step), {}).signals if s[0].startswith(ESTIMATE)]
        declared = {path: d for path, _, _, d in signals if d is not None}
        found = find_spatial({path: shape for path, shape, _, _ in signals}, declared)
        if found is None or found.frame != "W" or not found.position:
            return None
        return self._step.writes[found.position], self._step.writes[found.attitude]


class AutopilotEnd:
    """Autopilot's end of a link: it connects an endpoint to the compiled autopilot, over any transport.

    A received sample waits for the next control period. Each period uses at most one sample of each sensor, in order of
    arrival. A sample that arrives after a newer sample of its sensor is dropped, because most estimators assume that
    samples arrive in order. An estimator that fuses each sample at the time of its measurement declares `ANY_ORDER`,
    and also gets the late samples.
    """

    def __init__(
        self, scenario: Scenario, dialect: Dialect, step: CompiledBlock, clock: SampleClock | None = None
    ) -> None:
        """Start without samples.

        Args:
            scenario: scenario of the autopilot.
            dialect: MAVLink dialect of the scenario, from `scenario_dialect`.
            step: the compiled autopilot of this scenario.
            clock: converter and check of the samples' times, or None if samples and autopilot use the same clock. Then
                any time stamp is accepted.
        """
        self.step, self._clock = step, clock
        self.sensors: dict[str, MessageGroup] = sample_groups(dialect, lambda p: step.reads[p])
        self._command = command_group(dialect, lambda p: step.writes[p])
        self._sensor_of = {name: sensor for sensor, g in self.sensors.items() for name in g.names}
        self._time_slot: Any = step.reads["t"]
        estimator, period = scenario.autopilot.estimator, scenario.autopilot.period
        any_order = estimator.listens if optional_member(estimator, "ANY_ORDER") else ()
        self.counts = SampleCounts()
        self._queues = {s: SampleQueue(s, step.reads, self.counts, period, s in any_order) for s in self.sensors}
        self.monitored = CompiledMonitor(scenario, step)
        self.pose = EstimatedPose(step)

    def handle_message(self, message: Message) -> bool:
        """Return True if the message is part of a sample. Such a message is stored for the next control period."""
        sensor = self._sensor_of.get(message.name)
        if sensor is None:
            return False
        sample = self.sensors[sensor].assemble(message)
        if sample is not None and self._clock is not None and not self._clock.accepts(sample.t):
            self.counts.implausible += 1
        elif sample is not None:
            self._queues[sensor].add(sample)
        return True

    @property
    def backward_sensors(self) -> list[str]:
        """Names of the sensors whose time stamps currently decrease."""
        return [sensor for sensor, queue in self._queues.items() if queue.runs_backwards]

    @property
    def queue_length(self) -> int:
        """Number of samples that wait for a control period."""
        return sum(map(len, self._queues.values()))

    def drop_samples(self) -> None:
        """Drop the samples that arrived before the flight and have not been used yet."""
        for queue in self._queues.values():
            queue.clear()

    def fly_period(self, t: int) -> None:
        """Run one control period of the autopilot at integer time t."""
        self.set_inputs(t)
        self.step.step()

    def set_inputs(self, t: int) -> None:
        """Write the waiting samples into the inputs of the compiled autopilot for the period at integer time t, without
        running it."""
        self.step.inputs[self._time_slot] = t
        to_local = None if self._clock is None else self._clock.to_local
        for queue in self._queues.values():
            queue.set_inputs(self.step.inputs, t, to_local)

    def log_sources(self) -> list[LogSource]:
        """Return the input and output vectors of the compiled autopilot, as sources of the log's rows."""
        return step_sources(self.step)

    @property
    def has_command(self) -> bool:
        """True if the last command of the autopilot is valid."""
        return bool(self.step.outputs[self.step.writes["command.valid"]])

    def command_packets(self, endpoint: Endpoint, shift: int = 0) -> list[bytes]:
        """Return the packets of the last command. shift: time (100 ns) that is added to the command's time stamp."""
        return self._command.pack(endpoint, self.step.outputs, shift)


def scenario_dialect(scenario: Scenario) -> Dialect:
    """Return the MAVLink dialect of a scenario's link."""
    frame, command = carried_structures(scenario)
    return derive_dialect(frame, command)


def step_sources(step: CompiledBlock) -> list[LogSource]:
    """Return the input and output vectors of a compiled autopilot, as sources of the log's rows."""
    inputs = LogSource(step.inputs, step.text.inputs, frame_log_path)
    return [inputs, LogSource(step.outputs, step.text.outputs, lambda p: p)]


def frame_log_path(path: str) -> str | None:
    """Return the log path of an input of the compiled autopilot, or None for the input `t`, since each log row already
    has a time."""
    return None if path == "t" else f"downlink{path.removeprefix('samples')}"
