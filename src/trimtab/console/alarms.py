"""Alarms, link statistics and allowed requests of a flight, computed from the rows of its signals.

An alarm is shown as long as its cause persists, even after a pilot has acknowledged the alarm. Every start and end of
an alarm is logged.
Source: docs page, Console.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from trimtab.logs.robustness import VIOLATED
from trimtab.loop.supervisor_modes import CAUSES, ENDED, ENDED_BY, FAULT, LOST, MODES, explain_requests

ALARM, WARNING = "alarm", "warning"
MUTE = 0.5
"""Time (s) without a row of signals after which the autopilot counts as not responding."""
WARN_SHARE = 0.7
"""Age of data above which a warning is shown, as a fraction of the maximum age."""
LOSS_WINDOW = 2.0
OVERRUN_WINDOW, MOST_OVERRUNS = 2.0, 20
"""Time window (s), and maximum number of overruns in the window without a warning. A few overruns are normal on an
ordinary computer."""


class Alarm(NamedTuple):
    """Alarm or warning of a flight. id: name of the alarm, which remains the same while the numbers in the alarm's text
    change."""

    id: str
    level: str
    text: str


class Flight:
    """State of a flight as known to a console: the newest value of each signal, and active alarms."""

    def __init__(self, hello: Mapping[str, Any]) -> None:
        """hello: first message to the pages, which describes the signals in a row."""
        self._slots = {s["path"]: k for k, s in enumerate(hello["signals"])}
        self._ages: Sequence[Mapping[str, Any]] = hello["ages"]
        self._monitored = [path.split(".")[1] for path in self._slots if re.fullmatch(r"monitor\.\w+\.verdict", path)]
        self._has_supervisor, self._has_stick = hello["supervisor"] is not None, hello["pilot"] is not None
        self._row: Any = ()
        self.t, self.clock = math.nan, -math.inf
        self.piloted_since: float | None = None
        """Time (s, server's clock) at which a pilot took the stick. The time is kept if the pilot leaves without
        releasing the stick."""
        self._was_armed = False
        self._overruns: list[tuple[float, float]] = []
        self._counts: list[tuple[float, float, float]] = []

    def take_row(self, t: float, clock: float, row: Any) -> None:
        """Store the newest row, which has one number for each signal."""
        self.t, self.clock, self._row = t, clock, row
        self._was_armed |= bool(self.read("vehicle.armed"))
        kept = [c for c in self._overruns if clock - c[0] <= OVERRUN_WINDOW]
        self._overruns = [*kept, (clock, self.read("loop.overruns"))]

    def read(self, path: str) -> float:
        """Return the newest value of a signal, or NaN if the signal is unknown or no row has arrived."""
        k = self._slots.get(path)
        return math.nan if k is None or not len(self._row) else float(self._row[k])

    def _read_mode(self, path: str) -> int | None:
        value = self.read(path)
        return None if math.isnan(value) else int(value)

    def list_alarms(self, now: float) -> list[Alarm]:
        """Return the active alarms. now: current time of the server's clock (s)."""
        if self.clock == -math.inf:
            return []
        if now - self.clock > MUTE:
            return [Alarm("mute", ALARM, f"no data from the autopilot for {now - self.clock:.1f} s")]
        flight = (*self._vehicle_alarms(), *self._supervisor_alarms(), *self._monitor_alarms())
        return [*flight, *self._age_alarms(now), *self._loop_alarms()]

    def _vehicle_alarms(self) -> list[Alarm]:
        found = []
        if self._was_armed and not self.read("vehicle.armed") and self._read_mode("supervisor.mode") != ENDED:
            found.append(Alarm("disarmed", ALARM, "the vehicle is no longer armed"))
        if self.read("link.connected") == 0:
            found.append(Alarm("unconnected", ALARM, "the link is not connected"))
        return found

    def _supervisor_alarms(self) -> list[Alarm]:
        mode, cause = self._read_mode("supervisor.mode"), self._read_mode("supervisor.cause")
        if mode is None or cause is None or mode not in (LOST, FAULT, ENDED):
            return []
        level = WARNING if (mode, cause) == (ENDED, ENDED_BY) else ALARM
        return [Alarm(f"supervisor-{MODES[mode]}", level, f"{MODES[mode]}: {CAUSES[cause]}")]

    def _monitor_alarms(self) -> list[Alarm]:
        broken = [name for name in self._monitored if self._read_mode(f"monitor.{name}.verdict") == VIOLATED]
        numbers = {name: self.read(f"monitor.{name}.robustness") for name in broken}
        return [
            Alarm(f"monitor-{n}", ALARM, f"the formula {n} is violated, robustness {x:.3g}") for n, x in numbers.items()
        ]

    def _age_alarms(self, now: float) -> list[Alarm]:
        found = []
        for age in self._ages:
            value, limit, label = self.read(age["path"]), age["limit"], age["label"]
            if label == "stick":
                if self.piloted_since is None or not self.read("vehicle.armed"):
                    continue
                value = min(value, now - self.piloted_since)  # stick samples of an earlier pilot do not count
            if value > WARN_SHARE * limit:
                level = ALARM if value > limit else WARNING
                found.append(Alarm(f"age-{label}", level, f"{label} {value:.2f} s old, limit {limit:g} s"))
        return found

    def _loop_alarms(self) -> list[Alarm]:
        late = self._overruns[-1][1] - self._overruns[0][1]
        if not late > MOST_OVERRUNS:
            return []
        text = f"overruns: {late:g} late periods in {OVERRUN_WINDOW:g} s, at most {MOST_OVERRUNS} are normal"
        return [Alarm("overrun", WARNING, text)]

    def explain_requests(self) -> dict[str, dict[str, Any]]:
        """Return the requests of a pilot, each with True if the request is allowed, otherwise with the reason."""
        mode, check = self._read_mode("supervisor.mode"), self._read_mode("supervisor.check")
        armed = bool(self.read("vehicle.armed") == 1)
        if mode is None:
            why = dict.fromkeys(("hold", "resume", "clear"), "this scenario has no supervisor")
            why |= {"arm": "already armed" if armed else "", "end": "" if armed else "not armed"}
        else:
            why = explain_requests(mode, check or 0)
            if not armed and mode not in (FAULT, ENDED):
                why["arm"] = ""  # the vehicle's own checks decide about arming
        return {request: {"allowed": not text, "why": text} for request, text in why.items()}

    def describe_link(self, timing: Mapping[str, Any]) -> dict[str, Any]:
        """Return the statistics of the link for the pages. An unknown number becomes null in JSON."""
        ages = [self.read(a["path"]) for a in self._ages if a["path"].startswith("downlink.") and a["label"] != "stick"]
        down = min((a for a in ages if not math.isnan(a)), default=math.nan)
        now = (self.clock, self.read("link.samples"), self.read("link.lost"))
        self._counts = [c for c in self._counts if now[0] - c[0] <= LOSS_WINDOW] + [now]
        (_, samples, lost), span = self._counts[0], now[0] - self._counts[0][0]
        came, missed = now[1] - samples, now[2] - lost
        rate = came / span if span > 0 else math.nan
        loss = missed / (came + missed) if came + missed > 0 else math.nan
        trip = timing.get("round_trip")
        up = math.nan if trip is None else max(trip - down, 0.0)
        numbers = {"down": down, "up": up, "loss": loss, "rate": rate, "silence": self.read("link.silence")}
        known = {name: None if math.isnan(value) else value for name, value in numbers.items()}
        return known | {"round_trip": trip}
