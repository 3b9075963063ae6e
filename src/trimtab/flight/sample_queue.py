"""Queue of a sensor's samples that wait for an autopilot's steps, in order and without duplicates.

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

After a gap in the data, samples arrive in bursts, but each step fuses only one.
"""
LONGEST_BACKLOG, FEWEST_STEPS = ms(320), 8
"""Time and number of steps after which waiting samples are dropped. Otherwise the queue of a sensor whose rate equals
the rate of the steps would never become empty."""
LONGEST_OVERTAKING = ms(500)
"""A sample that lags the newest one by at most this time counts as overtaken. No estimator fuses an older sample."""
OTHER_CLOCK = 8
"""Number of consecutive samples beyond LONGEST_OVERTAKING after which the vehicle is assumed to have restarted."""
MOST_FALLS = 8
"""Number of consecutive samples of one sensor with decreasing time stamps after which its samples are rejected."""


@dataclasses.dataclass
class SampleCounts:
    """Counts of the samples of all sensors since the start."""

    received: int = 0
    dropped: int = 0
    """Samples dropped because the queue was full, or because samples had waited too long."""
    implausible: int = 0
    """Samples rejected because their time is too far from the current time."""
    overtaken: int = 0
    backward: int = 0
    """Samples of sensors with decreasing time stamps. All of them are rejected."""


class SampleQueue:
    """Waiting samples of one sensor, with a record of the times of earlier samples."""

    def __init__(
        self, sensor: str, reads: Mapping[str, Any], counts: SampleCounts, period: int, any_order: bool
    ) -> None:
        """Start without waiting samples.

        Args:
            sensor: name of the sensor.
            reads: slot of each input of the step, by path.
            counts: counters of samples, which this queue increases.
            period: period of the steps (100 ns).
            any_order: True if samples that newer samples have overtaken are fused too.
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
        """Store a sample for a step, unless it is a duplicate or a newer sample has overtaken it."""
        if self._is_new(sample.t):
            self._counts.dropped += len(self._waiting) == LONGEST_QUEUE
            self._counts.received += 1
            self._waiting.append(sample)

    def clear(self) -> None:
        """Drop the waiting samples."""
        self._waiting.clear()

    def _is_new(self, t: int) -> bool:
        """Return whether a sample of time t is neither a duplicate nor overtaken."""
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
        """Return True if the time stamps decrease. The first such samples then no longer count as overtaken."""
        is_fall = self._received_time is not None and t < self._received_time
        self._received_time, self._falls = t, self._falls + 1 if is_fall else 0
        if self._falls == MOST_FALLS:
            self._counts.overtaken -= MOST_FALLS - 1
            self._counts.backward += MOST_FALLS - 1
        self._counts.backward += self.runs_backwards
        return self.runs_backwards

    def set_inputs(self, inputs: Any, t: int, to_local: Callable[[int], int] | None) -> None:
        """Set the sensor's inputs of the step at integer time t.

        to_local: converts a time of the sample's clock to the clock of t.
        """
        time, age, fresh = self._slots
        inputs[fresh] = bool(self._waiting)
        if self._waiting:
            sample = self._take_next()
            local = sample.t if to_local is None else to_local(sample.t)
            sample.write(inputs, local - sample.t)
        inputs[age] = (t - inputs[time]) * SECONDS_PER_UNIT

    def _take_next(self) -> GroupSample:
        """Return the sample that has waited longest, or the newest one if too many samples have waited for too long."""
        sample = self._waiting.popleft()
        self._backlog = self._backlog + 1 if self._waiting else 0
        if self._backlog > self._most_backlog:
            self._counts.dropped += len(self._waiting)
            sample = self._waiting.pop()
            self._waiting.clear()
        return sample
