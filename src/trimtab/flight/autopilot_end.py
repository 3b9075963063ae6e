"""The autopilot's end of a link: samples in, one compiled step at a time, commands out.

Source: docs page, Fly.
"""

import functools
from collections import deque
from collections.abc import Callable
from typing import Any

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.interfaces import optional_member
from trimtab.core.time import SECONDS_PER_UNIT, ms, seconds
from trimtab.flight.exchange import GroupSample, MessageGroup, command_group, sample_groups
from trimtab.flight.flight_log import FlightRows, LogSource
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.monitored import CompiledMonitor
from trimtab.logs.frames import roll_pitch_yaw
from trimtab.logs.spatial import find_spatial
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import carried_structures

LONGEST_QUEUE = 64
"""Maximum number of waiting samples of one sensor. They come in bursts after a silence, and are fused one per step."""
LONGEST_BACKLOG, FEWEST_STEPS = ms(320), 8
"""Time and number of steps after which waiting samples are dropped. Otherwise the queue of a sensor that is as fast as
the steps would never empty."""
LONGEST_OVERTAKING = ms(500)
"""Largest lag behind the newest sample of a sensor that counts as overtaken. No estimator fuses an older sample."""
OTHER_CLOCK = 8
"""Number of consecutive samples beyond LONGEST_OVERTAKING after which the vehicle is assumed to have restarted."""
MOST_FALLS = 8
"""Number of consecutive samples of one sensor with decreasing time stamps after which its samples are rejected."""
LONGEST_SAMPLE_AGE, MOST_SAMPLE_LEAD = seconds(2), ms(200)
"""Largest age and lead of a sample. Beyond these the sample is rejected: its clock is not the known one.

A sample was measured before it arrived. An apparent lead is an error of the offset: at most half of a round trip.
"""


ESTIMATE = "estimate.state."
ESTIMATED_POSE = {"north": 0, "east": 1, "heading": 5}
"""Name in an estimated state -> index in a pose."""


class AutopilotEnd:
    """Autopilot between an endpoint and its compiled step, independent of clocks and transports.

    A sample waits for the next step. Several samples of one sensor get one step each, in the order of arrival. A sample
    that arrives after a later one is dropped, since most estimators take the last one for the newest. An estimator that
    fuses each sample at its own time declares ANY_ORDER = True.
    """

    def __init__(self, scenario: Scenario, dialect: Dialect, step: CompiledBlock) -> None:
        """step: the compiled autopilot of this scenario; dialect: as `scenario_dialect` gives it."""
        self.step = step
        self.sensors: dict[str, MessageGroup] = sample_groups(dialect, lambda p: step.reads[p])
        self._command = command_group(dialect, lambda p: step.writes[p])
        self._sensor_of = {name: sensor for sensor, g in self.sensors.items() for name in g.names}
        self._queues: dict[str, deque[GroupSample]] = {s: deque(maxlen=LONGEST_QUEUE) for s in self.sensors}
        self._slots: dict[str, tuple[Any, ...]] = {
            s: tuple(step.reads[f"samples.{s}.{n}"] for n in ("t", "age", "fresh")) for s in self.sensors
        }
        self.monitored = CompiledMonitor(scenario, step)
        self._last_times: dict[str, int] = {}
        self._received_times: dict[str, int] = {}
        self._falls = dict.fromkeys(self.sensors, 0)
        self._too_old = dict.fromkeys(self.sensors, 0)
        self._time_slot: Any = step.reads["t"]
        self._backlogs = dict.fromkeys(self.sensors, 0)
        self._most_backlog = max(LONGEST_BACKLOG // scenario.autopilot.period, FEWEST_STEPS)
        paths = [f"estimate.state.{name}" for name in ESTIMATED_POSE]
        self._pose_slots: list[Any] = [step.writes[path] for path in paths if path in step.writes]
        estimator = scenario.autopilot.estimator
        self._any_order = estimator.listens if optional_member(estimator, "ANY_ORDER") else ()
        self.is_believable: Callable[[int], bool] = lambda t: True
        """Returns whether a sample with this time may be used. Rejected samples leave no trace."""
        self.dropped_samples = self.received_samples = self.implausible_samples = self.overtaken_samples = 0
        """Samples dropped from a full or old queue; received; rejected because of their times; and overtaken."""
        self.backward_samples = 0
        """Samples of sensors with decreasing time stamps. All of them are rejected."""

    def handle_message(self, message: Message) -> bool:
        """Keep a message for the next step. Return whether it is part of a sample."""
        sensor = self._sensor_of.get(message.name)
        if sensor is None:
            return False
        sample = self.sensors[sensor].assemble(message)
        if sample is not None and not self.is_believable(sample.t):
            self.implausible_samples += 1
        elif sample is not None and self._is_new_sample(sensor, sample.t):
            queue = self._queues[sensor]
            self.dropped_samples += len(queue) == LONGEST_QUEUE
            self.received_samples += 1
            queue.append(sample)
        return True

    def _is_new_sample(self, sensor: str, t: int) -> bool:
        """Return whether a sample of time t is neither a duplicate nor overtaken."""
        if self._falls_back(sensor, t):
            return False
        before = self._last_times.get(sensor, t - 1)
        too_old = before - t > LONGEST_OVERTAKING
        self._too_old[sensor] = self._too_old[sensor] + 1 if too_old else 0
        if t < before and self._too_old[sensor] < OTHER_CLOCK:
            self.overtaken_samples += 1
            return sensor in self._any_order and not too_old
        self._last_times[sensor] = t
        return t != before

    def _falls_back(self, sensor: str, t: int) -> bool:
        """Return whether a sensor's time stamps decrease. Its earlier samples then no longer count as overtaken."""
        falls = self._falls[sensor] + 1 if t < self._received_times.get(sensor, t) else 0
        self._received_times[sensor], self._falls[sensor] = t, falls
        if falls == MOST_FALLS:
            self.overtaken_samples -= MOST_FALLS - 1
            self.backward_samples += MOST_FALLS - 1
        self.backward_samples += falls >= MOST_FALLS
        return falls >= MOST_FALLS

    @property
    def backward_sensors(self) -> list[str]:
        """Sensors whose time stamps decrease now."""
        return [sensor for sensor, falls in self._falls.items() if falls >= MOST_FALLS]

    @property
    def queue_length(self) -> int:
        """Number of samples that wait for a step."""
        return sum(map(len, self._queues.values()))

    def drop_samples(self) -> None:
        """Drop the waiting samples: they are from before the flight."""
        for queue in self._queues.values():
            queue.clear()

    def fly_period(self, t: int, to_local: Callable[[int], int] | None = None) -> None:
        """Run one control period at integer time t. to_local: from the samples' clock to that of t; None: the same."""
        self.set_inputs(t, to_local)
        self.step.step()

    def set_inputs(self, t: int, to_local: Callable[[int], int] | None = None) -> None:
        """Set the inputs of a period's step. `fly_period` also makes the step."""
        inputs = self.step.inputs
        inputs[self._time_slot] = t
        for sensor, queue in self._queues.items():
            time, age, fresh = self._slots[sensor]
            inputs[fresh] = bool(queue)
            if queue:
                self._set_sample(sensor, queue, to_local)
            inputs[age] = (t - inputs[time]) * SECONDS_PER_UNIT

    def _set_sample(self, sensor: str, queue: deque[GroupSample], to_local: Callable[[int], int] | None) -> None:
        """Give the step the sample that has waited longest."""
        sample = queue.popleft()
        self._backlogs[sensor] = self._backlogs[sensor] + 1 if queue else 0
        if self._backlogs[sensor] > self._most_backlog:
            self.dropped_samples += len(queue)
            sample = queue.pop()
            queue.clear()
        local = sample.t if to_local is None else to_local(sample.t)
        sample.write(self.step.inputs, local - sample.t)

    def fill_pose(self, pose: Any) -> None:
        """Write the estimated position, if there is one, into a pose as in `logs.frames`."""
        if self._spatial_slots is not None:
            place, attitude = self._spatial_slots
            pose[:3] = self.step.outputs[place]
            pose[3:6] = roll_pitch_yaw(self.step.outputs[attitude].tolist())
        elif len(self._pose_slots) == len(ESTIMATED_POSE):
            pose[:6] = 0.0
            pose[list(ESTIMATED_POSE.values())] = self.step.outputs[self._pose_slots]

    @functools.cached_property
    def _spatial_slots(self) -> tuple[Any, Any] | None:
        """Slots of position and attitude in the estimate of a vehicle in space, over a fixed world."""
        signals = [s for s in FlightRows(self.log_sources(), {}).signals if s[0].startswith(ESTIMATE)]
        declared = {path: d for path, _, _, d in signals if d is not None}
        found = find_spatial({path: shape for path, shape, _, _ in signals}, declared)
        if found is None or found.frame != "W" or not found.position:
            return None
        return self.step.writes[found.position], self.step.writes[found.attitude]

    def log_sources(self) -> list[LogSource]:
        """Return what the autopilot's log contains of its step."""
        step = self.step
        inputs = LogSource(step.inputs, step.text.inputs, frame_log_path)
        return [inputs, LogSource(step.outputs, step.text.outputs, lambda p: p)]

    @property
    def has_command(self) -> bool:
        """True if the last command is valid."""
        return bool(self.step.outputs[self.step.writes["command.valid"]])

    def command_packets(self, endpoint: Endpoint, shift: int = 0) -> list[bytes]:
        """Return the packets of the last command. `shift` is added to its time."""
        return self._command.pack(endpoint, self.step.outputs, shift)


def scenario_dialect(scenario: Scenario) -> Dialect:
    """Return the dialect in which the two sides of a scenario communicate."""
    frame, command = carried_structures(scenario)
    return derive_dialect(frame, command)


def frame_log_path(path: str) -> str | None:
    """Return the log path of an input of the autopilot's step; None for the time, which every row has."""
    return None if path == "t" else f"downlink{path.removeprefix('samples')}"
