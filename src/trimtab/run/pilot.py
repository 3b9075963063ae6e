"""The autopilot's end of a line: samples in, one compiled step at a time, commands out.

Source: docs page, Fly.
"""

from collections import deque
from typing import Any

from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.loop.scenario import Scenario
from trimtab.run.exchange import Group, Taken, command_group, sample_groups
from trimtab.run.fast_step import FastStep
from trimtab.run.world_step import messages
from trimtab.wire.dialect import Dialect, dialect_of
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.message import Message

LONGEST_QUEUE = 64
"""Samples of one sensor that may wait: they come in bursts after a silence, and are fused one a step."""


class Pilot:
    """An autopilot between an endpoint and its compiled step; it knows nothing of clocks and transports.

    A sample waits for the next step; of several from one sensor each gets a step of its own, in the order of coming.
    """

    def __init__(self, scenario: Scenario, dialect: Dialect, step: FastStep) -> None:
        """step: the compiled autopilot of this scenario; dialect: as `dialect_for` gives it."""
        self.step = step
        self.sensors: dict[str, Group] = sample_groups(dialect, lambda p: step.reads[p])
        self._command = command_group(dialect, lambda p: step.writes[p])
        self._sensor_of = {name: sensor for sensor, g in self.sensors.items() for name in g.names}
        self._waiting: dict[str, deque[Taken]] = {s: deque(maxlen=LONGEST_QUEUE) for s in self.sensors}
        self._at: dict[str, tuple[Any, ...]] = {
            s: tuple(step.reads[f"samples.{s}.{n}"] for n in ("t", "age", "fresh")) for s in self.sensors
        }
        self._last: dict[str, int] = {}
        self._now: Any = step.reads["t"]
        self.overflowed = self.heard = 0
        """Samples dropped because too many waited, and samples heard."""

    def take(self, message: Message) -> bool:
        """Keep a message for the next step if it is a part of a sample; tells whether it was."""
        sensor = self._sensor_of.get(message.name)
        if sensor is None:
            return False
        taken = self.sensors[sensor].take(message)
        if taken is not None and taken.t != self._last.get(sensor):  # else it was sent twice
            self._last[sensor] = taken.t
            waiting = self._waiting[sensor]
            self.overflowed += len(waiting) == LONGEST_QUEUE
            self.heard += 1
            waiting.append(taken)
        return True

    @property
    def waiting(self) -> int:
        """Samples that wait for a step."""
        return sum(map(len, self._waiting.values()))

    def fly(self, t: int, shift: int = 0) -> None:
        """One control period at integer time t; `shift` is added to the times of samples."""
        inputs = self.step.inputs
        inputs[self._now] = t
        for sensor, waiting in self._waiting.items():
            time, age, fresh = self._at[sensor]
            inputs[fresh] = bool(waiting)
            if waiting:
                waiting.popleft().write(inputs, shift)
            inputs[age] = (t - inputs[time]) * SECONDS_PER_UNIT
        self.step.step()

    @property
    def ready(self) -> bool:
        """Whether the last command is one to be obeyed."""
        return bool(self.step.outputs[self.step.writes["command.valid"]])

    def commands(self, endpoint: Endpoint, shift: int = 0) -> list[bytes]:
        """The packets of the last command; `shift` is added to its time."""
        return self._command.pack(endpoint, self.step.outputs, shift)


def dialect_for(scenario: Scenario) -> Dialect:
    """The messages in which a scenario's two sides speak."""
    frame, command = messages(scenario)
    return dialect_of(frame, command)


def frame_name(path: str) -> str | None:
    """The path in a log of an input of an autopilot's step; None for the time, which every row has."""
    return None if path == "t" else f"downlink{path.removeprefix('samples')}"
