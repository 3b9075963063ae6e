"""Checks of a vehicle before arming, and conditions for arming it again after a failsafe.

The checks run ten times a second on the vehicle. They use samples of the vehicle's sensors, and the state of its link
and its program. If arming is refused, pilot, ground station and log get the same explanation, with advice
(`flight.station.arming`).
Source: docs page, Arming.
"""

import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.actuators.failsafe import COMPUTER, FAILSAFE, MODES, Failsafe
from trimtab.core.interfaces import optional_member
from trimtab.core.time import SECONDS_PER_UNIT, ms, seconds, to_seconds
from trimtab.flight.flight_log import SYSTEM_DISK, Disk
from trimtab.flight.mavlink.endpoint import FrameCounts
from trimtab.flight.safety_settings import safety_checks
from trimtab.flight.sensed_motion import QUANTITIES, Breach, SensedMotion
from trimtab.flight.station.arming import ArmingCheck, first_problem
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.loop.faults import FaultyPart
from trimtab.loop.pilot_script import PilotScript
from trimtab.loop.stick_script import StickScript
from trimtab.loop.vehicle_limits import VehicleLimits

CHECK_PERIOD = ms(100)
LONGEST_SILENCE, LONGEST_PERIODS = ms(250), 5
"""Time (100 ns), and number of sensor periods, whose sum is the largest accepted age of a sensor's newest sample.

Some sensors, such as a network of beacons, deliver fewer samples than one per period. If the median of the last
intervals between samples is longer than the period, it replaces the period.
"""
MOST_LOSS, LEAST_FRAMES, LOSS_WINDOW = 50.0, 20, seconds(1)
"""Largest accepted share of lost frames (%), smallest number of frames from which the share is computed, and time (100
ns) after which the share is unknown if fewer frames have arrived."""
LONGEST_LINE_SILENCE = 3.0
"""Longest accepted time without data on the link (s): three periods of a ground station's heartbeat."""
LONGEST_RADIO_SILENCE = 0.5
LEAST_SPACE = 100.0
"""Smallest accepted free space for the log (MB), enough for ten minutes of a vehicle's log."""
CONFIRMATION_CHECK = "confirmation"
MEGABYTE = 1e6


class FrameLoss:
    """Share of frames that a link has lost recently. Frames lost before the first received frame do not count."""

    def __init__(self, counts: FrameCounts) -> None:
        """counts: frame counters of the receiving end."""
        self._counts = counts
        self._first: int | None = None
        self._before: tuple[int, int, int] | None = None
        self.share = math.nan
        """Share of lost frames in the last time window (%), or NaN if too few frames have arrived."""

    def follow(self, now: int) -> None:
        """Update the share of lost frames, and start a new time window when the current window has enough frames or is
        over."""
        accepted, lost = self._counts.accepted, self._counts.lost
        if self._first is None:
            self._first = accepted
        if self._before is None:
            self._before = (now, accepted, lost) if accepted != self._first else None
            return
        since, accepted_before, lost_before = self._before
        frames = accepted - accepted_before + max(lost - lost_before, 0)
        if frames >= LEAST_FRAMES:
            self.share = 100.0 * max(lost - lost_before, 0) / frames
        elif now - since >= LOSS_WINDOW:
            self.share = math.nan
        if frames >= LEAST_FRAMES or now - since >= LOSS_WINDOW:
            self._before = now, accepted, lost


class _SensorWatch:
    """Age of a sensor's newest sample, and interval between its samples."""

    def __init__(self, body: VirtualVehicle, name: str, period: int) -> None:
        writes, start = body.world.writes, f"downlink.{name}."
        self._outputs: Any = body.world.outputs
        every = np.arange(len(self._outputs))
        values = [np.atleast_1d(every[at]) for p, at in writes.items() if p.startswith(f"{start}value.")]
        self._numbers = np.concatenate([np.zeros(0, np.intp), *values])
        self._time: Any = writes[f"{start}t"]
        self._valid: Any = writes[f"{start}valid"]
        self._period, self._last = period, 0
        self._intervals: deque[int] = deque([period] * LONGEST_PERIODS, maxlen=LONGEST_PERIODS)

    def follow(self) -> None:
        """Record the time of a new sample."""
        time = int(self._outputs[self._time])
        if time != self._last:
            self._intervals.append(time - self._last)
            self._last = time

    @property
    def limit(self) -> float:
        """Largest accepted age (s) of the sensor's newest sample."""
        interval = sorted(self._intervals)[LONGEST_PERIODS // 2]
        return to_seconds(LONGEST_SILENCE + LONGEST_PERIODS * max(interval, self._period))

    def age(self, t: int) -> float:
        """Return the age (s) of the sensor's newest sample. Before the first sample, the age is infinite."""
        outputs = self._outputs
        return (t - int(outputs[self._time])) * SECONDS_PER_UNIT if outputs[self._valid] else math.inf

    def count_wrong_numbers(self) -> int:
        """Return the number of values in the newest sample that are not finite."""
        return int((~np.isfinite(self._outputs[self._numbers])).sum())


UNCHECKED = "the checks have not run yet"


class ArmingGuard:
    """Guard of a vehicle: checks before arming, limits of position and motion (fence and envelope), and conditions for
    arming after a failsafe.

    Times are by the vehicle's clock, in 100 ns.
    """

    def __init__(
        self,
        body: VirtualVehicle,
        limits: VehicleLimits,
        failsafe: Failsafe,
        counts: FrameCounts,
        radio_silence: Callable[[int], int | None],
        disk: Disk = SYSTEM_DISK,
    ) -> None:
        """Start before the first run of the checks.

        body: vehicle with the sensors.  limits: fence, envelope, and limits of speed and turn rate at rest.
        failsafe: failsafe whose time-out is checked.  counts: frame counters of the vehicle's endpoint.
        radio_silence: function that returns the time since the last data from the safety pilot's receiver, or None if
        no data was ever received.  disk: disk of the log.
        """
        self._body, self._failsafe, self._disk = body, failsafe, disk
        self.motion, self._limits = SensedMotion(body, limits), limits
        self._counts, self._loss, self._radio_silence = counts, FrameLoss(counts), radio_silence
        self._accepted, self._frame_time = 0, 0
        self._sensors = _list_sensors(body)
        self._is_failsafe = self._has_failed_safe = self._is_confirmed = False
        self.log_folder: Path | None = None
        self.watchdog: int | None = None
        """Time (100 ns) without an output row after which the outputs become safe. None: no outputs process."""
        self.confirmed: frozenset[str] = frozenset()
        """Names of safety settings beyond their limits that the user has confirmed."""
        self.checks: list[ArmingCheck] = []
        """Results of the checks before arming, from their last run."""
        self._next = 0

    def follow(self, t: int, mode: str) -> None:
        """Update the state, and run the checks if they are due. Call this at each instant, after the compiled failsafe
        has run.

        mode: mode of the failsafe.
        """
        is_new, self._is_failsafe = mode == MODES[FAILSAFE] and not self._is_failsafe, mode == MODES[FAILSAFE]
        if is_new:
            self._has_failed_safe, self._is_confirmed = True, False
            self._next = t  # a request to arm must not be judged by checks before the failsafe
        elif mode == MODES[COMPUTER] and self._has_failed_safe:
            self._has_failed_safe = False
        for watch in self._sensors.values():
            watch.follow()
        if self._counts.accepted != self._accepted:
            self._accepted, self._frame_time = self._counts.accepted, t
        if t >= self._next:
            self._next = t + CHECK_PERIOD
            self._loss.follow(t)
            self.motion.note_moment(t)
            self.checks = self._make_checks(t)

    def confirm(self) -> None:
        """Record that the user has disarmed the vehicle after the failsafe."""
        self._is_confirmed = True

    @property
    def problem(self) -> str:
        """Reason why the vehicle cannot be armed even with the user's confirmation, or an empty string."""
        if not self.checks:
            return UNCHECKED
        return first_problem([c for c in self.checks if c.name != CONFIRMATION_CHECK])

    @property
    def may_be_armed(self) -> bool:
        """True if all checks pass."""
        return not (self.problem or self.confirmation_problem)

    @property
    def confirmation_problem(self) -> str:
        """Reason why the vehicle cannot be armed without the user's confirmation, or an empty string."""
        return first_problem([c for c in self.checks if c.name == CONFIRMATION_CHECK])

    def find_breach(self, t: int) -> Breach | None:
        """Return the limit of fence or envelope that the vehicle violates, or None."""
        return self.motion.find_breach(t, self._silent_sensors(t)) if self.motion.bounds else None

    def _silent_sensors(self, t: int) -> dict[str, float]:
        return {name: age for name, watch in self._sensors.items() if (age := watch.age(t)) > watch.limit}

    def _make_checks(self, t: int) -> list[ArmingCheck]:
        checks = [
            ArmingCheck(f"{name} age", watch.age(t), watch.limit, "s", f"switch {name} on")
            for name, watch in self._sensors.items()
        ]
        wrong = sum(watch.count_wrong_numbers() for watch in self._sensors.values())
        checks.append(ArmingCheck("sensor values not finite", wrong, 0, "", "check the sensors in the log"))
        return [*checks, *self._check_bounds(), *self._check_program(t), *self._check_after_failsafe()]

    def _check_bounds(self) -> list[ArmingCheck]:
        advice = {"fence": "bring the vehicle back inside the fence", "envelope": "let the vehicle come to rest"}
        bounds = [(name, QUANTITIES[name], bound) for name, bound in self.motion.bounds.items()]
        return [
            ArmingCheck(f"{q.kind} {name}", self.motion.value(name), bound, q.unit, advice[q.kind])
            for name, q, bound in bounds
        ]

    def _check_program(self, t: int) -> list[ArmingCheck]:
        silence, folder = self._radio_silence(t), self.log_folder
        space = math.nan if folder is None else self._disk.free_bytes(folder) / MEGABYTE
        radio = math.nan if silence is None else to_seconds(silence)
        line_silence = (t - self._frame_time) * SECONDS_PER_UNIT
        return [
            ArmingCheck("link silence", line_silence, LONGEST_LINE_SILENCE, "s", "check the link"),
            ArmingCheck("frames lost", self._loss.share, MOST_LOSS, "%", "move the two ends closer"),
            ArmingCheck("receiver silence", radio, LONGEST_RADIO_SILENCE, "s", "switch the pilot's transmitter on"),
            ArmingCheck("space for the log", space, LEAST_SPACE, "MB", "free disk space", at_least=True),
            *safety_checks(self._failsafe, self._limits, self.watchdog, self.confirmed),
        ]

    def _check_after_failsafe(self) -> list[ArmingCheck]:
        """Return the checks after a failsafe: the vehicle must be at rest, and the user must confirm."""
        if not self._has_failed_safe:
            return []
        speed, rate = self.motion.mean_motion()
        advice = "let the vehicle come to rest, or restart it"
        confirm = "type --rearm at fly; in a ground station disarm, then arm"
        return [
            ArmingCheck("speed after failsafe", speed, float(self._limits.rest_speed), "m/s", advice),
            ArmingCheck("rate of turn after failsafe", rate, float(self._limits.rest_rate), "rad/s", advice),
            ArmingCheck(CONFIRMATION_CHECK, float(self._is_confirmed), 1.0, "", confirm, at_least=True, heals=False),
        ]


def _list_sensors(body: VirtualVehicle) -> dict[str, _SensorWatch]:
    """Return a watch of the samples of each sensor, by the sensor's name. Scripts of a pilot, and sensors of the
    complete state (FEELS = "state"), are left out."""
    sensors = {}
    for name, sensor in body.scenario.world.sensors.items():
        while isinstance(sensor, FaultyPart):
            sensor = sensor.inner
        if not isinstance(sensor, PilotScript | StickScript) and optional_member(sensor, "FEELS") != "state":
            sensors[name] = _SensorWatch(body, name, sensor.period)
    return sensors
