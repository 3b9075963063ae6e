"""What a vehicle looks at before it lets itself be armed, and what it asks for after a failsafe.

The checks are made anew ten times a second, from what the vehicle knows: its sensors' samples, its line, its own
program. Who must not be armed is told why, and what to do, in the same words to all: `wire.arming`.
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
from trimtab.live.flight_log import SYSTEM_DISK, Disk
from trimtab.live.sensed_motion import QUANTITIES, Breach, SensedMotion
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.loop.faults import FaultyPart
from trimtab.loop.pilot_script import PilotScript
from trimtab.loop.stick_script import StickScript
from trimtab.loop.vehicle_limits import VehicleLimits
from trimtab.wire.arming import ArmingCheck, first_problem
from trimtab.wire.mavlink import FrameCounts

CHECK_PERIOD = ms(100)
LONGEST_SILENCE, LONGEST_PERIODS = ms(250), 5
"""A sensor is silent that gives nothing for so long, and for so many of its periods besides.

Some look often and give seldom, as a network of beacons does: the median of so many of their intervals counts, too.
"""
LONGEST_FAILSAFE = 10.0
"""Seconds: whoever has set the failsafe's time-out to more flies without one."""
MOST_LOSS, LEAST_FRAMES, LOSS_WINDOW = 50.0, 20, seconds(1)
"""Share of frames lost on the way (%), of at least so many; where they don't come within the window it isn't known."""
LONGEST_LINE_SILENCE = 3.0
"""Seconds: three heartbeats of a ground station."""
LONGEST_RADIO_SILENCE = 0.5
LEAST_SPACE = 100.0
"""MB for the log: ten minutes of a vehicle's."""
CONFIRMATION_CHECK = "confirmation"
MEGABYTE = 1e6


class FrameLoss:
    """The share of frames that a line has lost lately. It begins with a frame: what was not heard before is no loss."""

    def __init__(self, counts: FrameCounts) -> None:
        """counts: of the end that hears."""
        self._counts = counts
        self._first: int | None = None
        self._before: tuple[int, int, int] | None = None
        self.share = math.nan
        """Of the last window, %; NaN where too few frames have come to tell."""

    def follow(self, now: int) -> None:
        """End the window where there are frames enough, or it is over."""
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
    """A sensor's newest sample, and how often there is a new one."""

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
        """Note a new sample."""
        time = int(self._outputs[self._time])
        if time != self._last:
            self._intervals.append(time - self._last)
            self._last = time

    @property
    def limit(self) -> float:
        """How old a sample may be (s)."""
        interval = sorted(self._intervals)[LONGEST_PERIODS // 2]
        return to_seconds(LONGEST_SILENCE + LONGEST_PERIODS * max(interval, self._period))

    def age(self, t: int) -> float:
        """How old the newest sample is (s); infinite where there never was one."""
        outputs = self._outputs
        return (t - int(outputs[self._time])) * SECONDS_PER_UNIT if outputs[self._valid] else math.inf

    def count_wrong_numbers(self) -> int:
        """How many of its numbers are not finite."""
        return int((~np.isfinite(self._outputs[self._numbers])).sum())


class ArmingGuard:
    """A vehicle's checks, its fence and envelope, and what a failsafe leaves behind. Times are the vehicle's."""

    def __init__(
        self,
        body: VirtualVehicle,
        limits: VehicleLimits,
        failsafe: Failsafe,
        counts: FrameCounts,
        radio_silence: Callable[[int], int | None],
        disk: Disk = SYSTEM_DISK,
    ) -> None:
        """Nothing watched yet.

        Args:
            body: whose sensors.
            limits: fence, envelope, and what is rest.
            failsafe: its time-out is checked.
            counts: frames of the vehicle's end.
            radio_silence: time since the safety pilot's receiver was heard, None if it never was.
            disk: where the log is written.
        """
        self._body, self._failsafe, self._disk = body, failsafe, disk
        self.motion, self._limits = SensedMotion(body, limits), limits
        self._counts, self._loss, self._radio_silence = counts, FrameLoss(counts), radio_silence
        self._accepted, self._frame_time = 0, 0
        self._sensors = _list_sensors(body)
        self._has_failed_safe = self._is_confirmed = False
        self.log_folder: Path | None = None
        self.checks: list[ArmingCheck] = []
        """As they were made last."""
        self._next = 0

    def follow(self, t: int, mode: str) -> None:
        """Each instant, after the failsafe's step: what has to be remembered, and the checks where they are due."""
        if mode == MODES[FAILSAFE] and not self._has_failed_safe:
            self._has_failed_safe, self._is_confirmed = True, False
            self._next = t  # who asks to arm in the next moment is not to find checks from before
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
        """A person has disarmed it since the failsafe."""
        self._is_confirmed = True

    @property
    def problem(self) -> str:
        """Why it can't be armed, whoever confirms what; empty if it can."""
        return first_problem([c for c in self.checks if c.name != CONFIRMATION_CHECK])

    @property
    def confirmation_problem(self) -> str:
        """Why it can't be armed without a confirmation; empty if it can."""
        return first_problem([c for c in self.checks if c.name == CONFIRMATION_CHECK])

    def find_breach(self, t: int) -> Breach | None:
        """The limit of fence or envelope that the vehicle is beyond."""
        return self.motion.find_breach(t, self._silent_sensors(t)) if self.motion.bounds else None

    def _silent_sensors(self, t: int) -> dict[str, float]:
        return {name: age for name, watch in self._sensors.items() if (age := watch.age(t)) > watch.limit}

    def _make_checks(self, t: int) -> list[ArmingCheck]:
        checks = [
            ArmingCheck(f"{name} age", watch.age(t), watch.limit, "s", f"switch {name} on")
            for name, watch in self._sensors.items()
        ]
        wrong = sum(watch.count_wrong_numbers() for watch in self._sensors.values())
        checks.append(ArmingCheck("sensor values not finite", wrong, 0, "", "look at the sensors in the log"))
        return [*checks, *self._check_bounds(), *self._check_program(t), *self._check_after_failsafe()]

    def _check_bounds(self) -> list[ArmingCheck]:
        advice = {"fence": "bring it back inside the fence", "envelope": "let it come to rest"}
        bounds = [(name, QUANTITIES[name], bound) for name, bound in self.motion.bounds.items()]
        return [
            ArmingCheck(f"{q.kind} {name}", self.motion.value(name), bound, q.unit, advice[q.kind])
            for name, q, bound in bounds
        ]

    def _check_program(self, t: int) -> list[ArmingCheck]:
        silence, folder = self._radio_silence(t), self.log_folder
        space = math.nan if folder is None else self._disk.free_bytes(folder) / MEGABYTE
        radio = math.nan if silence is None else to_seconds(silence)
        time_out = to_seconds(self._failsafe.timeout)
        line_silence = (t - self._frame_time) * SECONDS_PER_UNIT
        return [
            ArmingCheck("line silence", line_silence, LONGEST_LINE_SILENCE, "s", "look at the line"),
            ArmingCheck("frames lost", self._loss.share, MOST_LOSS, "%", "bring the two ends of the line nearer"),
            ArmingCheck(
                "failsafe time-out", time_out, LONGEST_FAILSAFE, "s", "leave --set failsafe.timeout out", heals=False
            ),
            ArmingCheck("receiver silence", radio, LONGEST_RADIO_SILENCE, "s", "switch the pilot's transmitter on"),
            ArmingCheck("space for the log", space, LEAST_SPACE, "MB", "make room on its disk", at_least=True),
            ArmingCheck("battery", math.nan, 0.0, "V", "charge it", at_least=True),
        ]

    def _check_after_failsafe(self) -> list[ArmingCheck]:
        """Rest, and a person's confirmation, where the last flight ended in failsafe."""
        if not self._has_failed_safe:
            return []
        speed, rate = self.motion.mean_motion()
        advice = "let it come to rest, or start the vehicle anew"
        confirm = "type --rearm at fly; in a ground station disarm, then arm"
        return [
            ArmingCheck("speed after failsafe", speed, float(self._limits.rest_speed), "m/s", advice),
            ArmingCheck("rate of turn after failsafe", rate, float(self._limits.rest_rate), "rad/s", advice),
            ArmingCheck(CONFIRMATION_CHECK, float(self._is_confirmed), 1.0, "", confirm, at_least=True, heals=False),
        ]


def _list_sensors(body: VirtualVehicle) -> dict[str, _SensorWatch]:
    """The sensors that a vehicle has: neither a pilot's script nor an ideal twin's."""
    sensors = {}
    for name, sensor in body.scenario.world.sensors.items():
        while isinstance(sensor, FaultyPart):
            sensor = sensor.inner
        if not isinstance(sensor, PilotScript | StickScript) and optional_member(sensor, "FEELS") != "state":
            sensors[name] = _SensorWatch(body, name, sensor.period)
    return sensors
