"""Before `fly` asks a vehicle to arm: its own checks beside the vehicle's, how long it waits for them, and its refusal.

What the estimator knows is checked here, where it is known; what the vehicle knows, by the vehicle, which decides again
by itself when it is asked to arm. Both are shown, and logged, as one table.
Source: docs page, Arming.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from trimtab.core.time import ms, seconds, to_seconds
from trimtab.live.arming import CONFIRMATION_CHECK, LEAST_SPACE, LOSS_WINDOW, MEGABYTE, MOST_LOSS, FrameLoss
from trimtab.live.autopilot_end import AutopilotEnd
from trimtab.live.flight_log import SYSTEM_DISK, Disk
from trimtab.live.remote import QUICK_ROUND_TRIP, RemoteVehicle
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import CHECKS
from trimtab.wire.arming import ArmingCheck, first_problem
from trimtab.wire.mavlink import FrameCounts

CHECK_PERIOD, PATIENCE = ms(100), seconds(10)
"""How often it looks, and how long it waits for what can pass by waiting."""
LONGEST_SILENCE = 0.25
STALE_AGE = 0.4
"""Seconds: the oldest estimate where no supervisor says what is too old; its own default."""
MOST_SIGMA = {"m": 1.0, "m/s": 0.5, "rad": 0.35, "rad/s": 0.2}
"""By unit: the greatest standard deviation of what an estimator says that it knows, and the law reads."""
STATE = "estimate.state."


class Preflight:
    """The checks of a flight that has not been armed yet. Times `now` are this end's, in 100 ns."""

    def __init__(
        self,
        scenario: Scenario,
        end: AutopilotEnd,
        remote: RemoteVehicle,
        counts: FrameCounts,
        disk: Disk = SYSTEM_DISK,
    ) -> None:
        """Nothing looked at yet. counts: of the frames that this end hears.  disk: where the log is written."""
        self._end, self._remote, self._loss, self._disk = end, remote, FrameLoss(counts), disk
        supervisor = scenario.autopilot.supervisor
        self._stale_age = STALE_AGE if supervisor is None else float(supervisor.stale_age)
        step = end.step
        wanted = {f"{STATE}sigma_{name}" for name in scenario.autopilot.law.reads}
        sigmas = [m for m in step.text.outputs if m.path in wanted and not m.shape]
        self._sigmas = {
            m.path.removeprefix(STATE): (step.writes[m.path], m.declaration.unit)
            for m in sigmas
            if m.declaration is not None and m.declaration.unit in MOST_SIGMA
        }
        self._next = 0
        self._began: int | None = None
        self._is_shown, self._obstacles = False, set[str]()
        self.log_folder: Path | None = None
        self.checks: list[ArmingCheck] = []
        """The vehicle's, then the autopilot's, as they were last: what a sensor lacks, the estimate lacks."""
        self._theirs = 0
        self.is_decided = False
        self.obstacle = ""
        """What is waited for now; empty for nothing that was known for a second."""
        self.refusal = ""
        """Why the flight is given up; empty while it is not."""

    def update(self, now: int, silence: int) -> bool:
        """Whether the vehicle may be asked to arm now. silence: time since it was heard."""
        if self._began is None:
            self._began = now
        self._loss.follow(now)
        self._remote.wants_checks = not self._remote.is_asking  # else one would overtake the other
        if self._remote.is_asking and now - self._began >= PATIENCE:
            self.refusal = "arming refused by the vehicle, or it does not answer; see what it said"
        if self._remote.is_asking or now < self._next:
            return False
        self._next = now + CHECK_PERIOD
        theirs = self._remote.checks.current(now)
        is_told = bool(theirs) or self._remote.checks.has_none
        self.checks, self._theirs = [*theirs, *self._check_autopilot(to_seconds(silence))], len(theirs)
        failing = [c for c in self.checks if not c.passes and not self._is_confirmed(c)]
        if not failing or now - self._began >= seconds(1):
            self.obstacle = first_problem(failing)
        waits = now - self._began < PATIENCE
        is_told = is_told and (not math.isnan(self._loss.share) or now - self._began > LOSS_WINDOW)
        if failing and (not waits or not all(c.heals for c in failing)):
            self.refusal = f"arming refused: {first_problem(failing)}"
        elif not waits and not is_told:
            self.refusal = "arming refused: the vehicle's checks did not come whole; look at the line"
        may_arm = is_told and not failing and not self.refusal
        self._began = now if may_arm else self._began
        self.is_decided = may_arm or bool(self.refusal)
        return may_arm

    def restart(self) -> None:
        """Look anew, and wait for as long again."""
        self._began, self.is_decided, self._is_shown, self.obstacle, self.refusal = None, False, False, "", ""
        self._obstacles.clear()

    def report(self, tell: Callable[[str], None]) -> None:
        """Lines for people and for the log: what is waited for, each once; the checks, when it is decided."""
        obstacle = self.obstacle.partition(":")[0]
        if obstacle and obstacle not in self._obstacles and not self.refusal:
            self._obstacles.add(obstacle)
            tell(f"not armed yet: {self.obstacle}")
        if self.is_decided and not self._is_shown:
            self._is_shown = True
            for line in self.table.splitlines():
                tell(line)

    def _is_confirmed(self, check: ArmingCheck) -> bool:
        return check.name == CONFIRMATION_CHECK and self._remote.confirms

    @property
    def table(self) -> str:
        """All checks, a line each, aligned."""
        rows = [("", "check", "value", "limit", "")]
        for k, c in enumerate(self.checks):
            verdict = "ok" if c.passes else "confirmed" if self._is_confirmed(c) else "REFUSED"
            rows.append(("vehicle" if k < self._theirs else "autopilot", c.name, c.value_text, c.limit_text, verdict))
        widths = [max(len(row[k]) for row in rows) for k in range(5)]
        return "\n".join("  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)

    def describe_checks(self) -> list[dict[str, Any]]:
        """As JSON."""
        return [
            {"of": "vehicle" if k < self._theirs else "autopilot", **c._asdict(), "passes": c.passes}
            for k, c in enumerate(self.checks)
        ]

    def _check_autopilot(self, silence: float) -> list[ArmingCheck]:
        step, remote, folder = self._end.step, self._remote, self.log_folder

        def read(path: str) -> float:
            return float(step.outputs[step.writes[path]])

        check = int(read("supervisor.check")) if "supervisor.check" in step.writes else 0
        space = math.nan if folder is None else self._disk.free_bytes(folder) / MEGABYTE
        sigmas = [
            ArmingCheck(name, float(step.outputs[at]), MOST_SIGMA[unit], unit, "wait until the estimator has settled")
            for name, (at, unit) in self._sigmas.items()
        ]
        return [
            ArmingCheck(
                "estimate valid", read("estimate.valid"), 1, "", "look whether its sensors come", at_least=True
            ),
            ArmingCheck("estimate age", read("estimate.age"), self._stale_age, "s", "look whether its sensors come"),
            *sigmas,
            ArmingCheck("supervisor's objections", float(check > 0), 0, "", f"it says: {CHECKS[check]}"),
            ArmingCheck("command valid", float(self._end.has_command), 1, "", "the law has none yet", at_least=True),
            ArmingCheck("line silence", silence, LONGEST_SILENCE, "s", "look at the line"),
            ArmingCheck("frames lost", self._loss.share, MOST_LOSS, "%", "bring the two ends of the line nearer"),
            ArmingCheck(
                "clock's round trip",
                to_seconds(remote.sync.shortest),
                to_seconds(QUICK_ROUND_TRIP),
                "s",
                "look at the line",
            ),
            ArmingCheck("settings that differ", remote.count_differences(), 0, "", "--accept PATH where it is meant"),
            ArmingCheck("space for the log", space, LEAST_SPACE, "MB", "make room on its disk", at_least=True),
        ]
