"""Queue of a sensor's samples that wait for the autopilot's control periods, in order and without duplicates.

Source: docs page, Fly.
"""

import dataclasses
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from trimtab.core.time import SECONDS_PER_UNIT, ms
from trimtab.flight.exchange import GroupSample

LONGEST_QUEUE = 64
"""Maximum number of waiting samples of one sensor.

After a gap in the data, samples arrive in bursts, but each control period uses only one sample.
"""
LONGEST_BACKLOG, FEWEST_STEPS = ms(320), 8
"""Time (100 ns) and number of control periods after which waiting samples are dropped. Otherwise the queue of a sensor
that has the rate of the autopilot would never become empty."""
LONGEST_OVERTAKING = ms(500)
"""Largest lag (100 ns) behind the newest sample at which a sample counts as overtaken. An older sample is not used,
even by estimators that accept any order."""
OTHER_CLOCK = 8
"""Number of consecutive samples that lag by more than LONGEST_OVERTAKING after which the vehicle is assumed to have
restarted."""
MOST_FALLS = 8
"""Number of consecutive samples of one sensor with decreasing time stamps after which its samples are rejected."""


@dataclasses.dataclass
class SampleCounts:
    """Counts of received samples of all sensors since the start of the autopilot."""

    received: int = 0
    dropped: int = 0
    """Number of samples dropped because the queue was full, or because samples had waited too long."""
    implausible: int = 0
    """Number of samples rejected because their time is too far from the current time."""
    overtaken: int = 0
    backward: int = 0
    """Number of samples rejected because the sensor's time stamps decrease."""


class SampleQueue:
    """Queue of the waiting samples of one sensor, with a record of the times of earlier samples."""

    def __init__(
        self, sensor: str, reads: Mapping[str, Any], counts: SampleCounts, period: int, any_order: bool
    ) -> None:
        """Start without waiting samples.

        Args:
            sensor: name of the sensor.
            reads: index of each input of the compiled autopilot, by path.
            counts: counters of samples, updated by this queue.
            period: control period of the autopilot (100 ns).
            any_order: True if the estimator also accepts samples that arrive after newer samples.
        """
        self._slots: tuple[Any, ...] = tuple(reads[f"samples.{sensor}.{n}"] for n in ("t", "age", "fresh"))
        self._counts, self._any_order = counts, any_order
        self._most_backlog = max(LONGEST_BACKLOG // period, FEWEST_STEPS)
        self._waiting: deque[GroupSample] = deque(maxlen=LONGEST_QUEUE)
        self._newest_time: int | None = None
        self._received_time: int | None = None
        self._falls = self._too_old = self._backlog = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def runs_backwards(self) -> bool:
        """True while the sensor's time stamps decrease."""
        return self._falls >= MOST_FALLS

    def add(self, sample: GroupSample) -> None:
        """Store a sample for a later control period, unless the sample is a duplicate or arrives after a newer
        sample."""
        if self._is_new(sample.t):
            self._counts.dropped += len(self._waiting) == LONGEST_QUEUE
            self._counts.received += 1
            self._waiting.append(sample)

    def clear(self) -> None:
        """Drop all samples of this sensor that wait for a control period."""
        self._waiting.clear()

    def _is_new(self, t: int) -> bool:
        """Return True if a sample of time t is neither a duplicate nor older than a sample that has already arrived."""
        if self._falls_back(t):
            return False
        before = t - 1 if self._newest_time is None else self._newest_time
        is_too_old = before - t > LONGEST_OVERTAKING
        self._too_old = self._too_old + 1 if is_too_old else 0
        if t < before and self._too_old < OTHER_CLOCK:
            self._counts.overtaken += 1
            return self._any_order and not is_too_old
        self._newest_time = t
        return t != before

    def _falls_back(self, t: int) -> bool:
        """Return True if the sensor's time stamps decrease. The first samples with decreasing stamps then no longer
        count as overtaken."""
        is_fall = self._received_time is not None and t < self._received_time
        self._received_time, self._falls = t, self._falls + 1 if is_fall else 0
        if self._falls == MOST_FALLS:
            self._counts.overtaken -= MOST_FALLS - 1
            self._counts.backward += MOST_FALLS - 1
        self._counts.backward += self.runs_backwards
        return self.runs_backwards

    def set_inputs(self, inputs: Any, t: int, to_local: Callable[[int], int] | None) -> None:
        """Write the sensor's next sample into the inputs of the compiled autopilot, for the control period at integer
        time t.

        to_local: function that converts a time of the sample's clock to the clock of t.
        """
        time, age, fresh = self._slots
        inputs[fresh] = bool(self._waiting)
        if self._waiting:
            sample = self._take_next()
            local = sample.t if to_local is None else to_local(sample.t)
            sample.write(inputs, local - sample.t)
        inputs[age] = (t - inputs[time]) * SECONDS_PER_UNIT

    def _take_next(self) -> GroupSample:
        """Return the sample that has waited longest, or the newest sample if samples have waited for too many control
        periods."""
        sample = self._waiting.popleft()
        self._backlog = self._backlog + 1 if self._waiting else 0
        if self._backlog > self._most_backlog:
            self._counts.dropped += len(self._waiting)
            sample = self._waiting.pop()
            self._waiting.clear()
        return sample
