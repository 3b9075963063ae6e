"""What is wrong in a flight, out of its rows: alarms, what the link does, and which requests would be refused.

An alarm stays as long as its cause does, whoever has acknowledged it; each that comes or goes is an event of the log.
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
"""Seconds without a row, after which the autopilot does not answer."""
WARN_SHARE = 0.7
"""Of an age's limit, from which on it is warned of."""
LOSS_WINDOW = 2.0
OVERRUN_WINDOW, MOST_OVERRUNS = 2.0, 20
"""Seconds in which no more periods may end too late: a machine that is not for real time alone has one now and then."""


class Alarm(NamedTuple):
    """Something wrong. id: what it is, whatever its numbers are now."""

    id: str
    level: str
    text: str


class Flight:
    """What a console knows of a flight at one moment: its newest row by path."""

    def __init__(self, hello: Mapping[str, Any]) -> None:
        """hello: what pages are told first."""
        self._slots = {s["path"]: k for k, s in enumerate(hello["signals"])}
        self._ages: Sequence[Mapping[str, Any]] = hello["ages"]
        self._monitored = [path.split(".")[1] for path in self._slots if re.fullmatch(r"monitor\.\w+\.verdict", path)]
        self._has_supervisor, self._has_stick = hello["supervisor"] is not None, hello["pilot"] is not None
        self._row: Any = ()
        self.t, self.clock = math.nan, -math.inf
        self.is_piloted = False
        """Somebody has the stick, or had it and left without giving it back."""
        self._was_armed = False
        self._overruns: list[tuple[float, float]] = []
        self._counts: list[tuple[float, float, float]] = []

    def take_row(self, t: float, clock: float, row: Any) -> None:
        """The newest row, a number for each signal."""
        self.t, self.clock, self._row = t, clock, row
        self._was_armed |= bool(self.read("vehicle.armed"))
        kept = [c for c in self._overruns if clock - c[0] <= OVERRUN_WINDOW]
        self._overruns = [*kept, (clock, self.read("loop.overruns"))]

    def read(self, path: str) -> float:
        """A signal; NaN where there is none, or no row yet."""
        k = self._slots.get(path)
        return math.nan if k is None or not len(self._row) else float(self._row[k])

    def _read_mode(self, path: str) -> int | None:
        value = self.read(path)
        return None if math.isnan(value) else int(value)

    def list_alarms(self, now: float) -> list[Alarm]:
        """All that is wrong at the server's clock `now` (s)."""
        if self.clock == -math.inf:
            return []
        if now - self.clock > MUTE:
            return [Alarm("mute", ALARM, f"the autopilot does not answer for {now - self.clock:.1f} s")]
        flight = (*self._vehicle_alarms(), *self._supervisor_alarms(), *self._monitor_alarms())
        return [*flight, *self._age_alarms(), *self._loop_alarms()]

    def _vehicle_alarms(self) -> list[Alarm]:
        found = []
        if self._was_armed and not self.read("vehicle.armed") and self._read_mode("supervisor.mode") != ENDED:
            found.append(Alarm("disarmed", ALARM, "the vehicle is not armed any more"))
        if self.read("link.connected") == 0:
            found.append(Alarm("unconnected", ALARM, "the line has no connection"))
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
        return [Alarm(f"monitor-{n}", ALARM, f"{n} is violated, robustness {x:.3g}") for n, x in numbers.items()]

    def _age_alarms(self) -> list[Alarm]:
        found = []
        for age in self._ages:
            value, limit, label = self.read(age["path"]), age["limit"], age["label"]
            if label == "stick" and not (self.is_piloted and self.read("vehicle.armed")):
                continue
            if value > WARN_SHARE * limit:
                level = ALARM if value > limit else WARNING
                found.append(Alarm(f"age-{label}", level, f"{label} {value:.2f} s old, limit {limit:g} s"))
        return found

    def _loop_alarms(self) -> list[Alarm]:
        late = self._overruns[-1][1] - self._overruns[0][1]
        if not late > MOST_OVERRUNS:
            return []
        text = f"overruns: {late:g} periods ended too late in {OVERRUN_WINDOW:g} s, {MOST_OVERRUNS} are usual at most"
        return [Alarm("overrun", WARNING, text)]

    def explain_requests(self) -> dict[str, dict[str, Any]]:
        """For each request whether it is allowed, and why not."""
        mode, check = self._read_mode("supervisor.mode"), self._read_mode("supervisor.check")
        armed = bool(self.read("vehicle.armed") == 1)
        if mode is None:
            why = dict.fromkeys(("hold", "resume", "clear"), "this scenario has no supervisor")
            why |= {"arm": "it is armed" if armed else "", "end": "" if armed else "it is not armed"}
        else:
            why = explain_requests(mode, check or 0)
            if not armed and mode not in (FAULT, ENDED):
                why["arm"] = ""  # the vehicle is asked, which has checks of its own
        return {request: {"allowed": not text, "why": text} for request, text in why.items()}

    def describe_link(self, timing: Mapping[str, Any]) -> dict[str, Any]:
        """What the line does; numbers that are not known are null."""
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
