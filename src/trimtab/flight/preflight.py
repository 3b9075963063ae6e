"""Checks of the command `fly` before it asks a vehicle to arm. `fly` waits for checks that can still pass. If a check
cannot pass, `fly` gives up.

This module checks the estimate. The vehicle checks its own state, now and again when it is asked to arm. All results
are shown and logged in one table.
Source: docs page, Arming.
"""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.flight.autopilot_end import AutopilotEnd
from trimtab.flight.flight_log import SYSTEM_DISK, Disk
from trimtab.flight.mavlink.endpoint import FrameCounts
from trimtab.flight.prearm import CONFIRMATION_CHECK, LEAST_SPACE, LOSS_WINDOW, MEGABYTE, MOST_LOSS, FrameLoss
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.station.arming import ArmingCheck, first_problem
from trimtab.flight.vehicle_clock import QUICK_ROUND_TRIP
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import CHECKS

CHECK_PERIOD, PATIENCE = ms(100), seconds(10)
"""Time between two runs of the checks (100 ns), and longest wait for a failing check that can still pass (100 ns)."""
LONGEST_SILENCE = 0.25
STALE_AGE = 0.4
"""Largest accepted age of an estimate (s) in a flight without a supervisor, equal to the default of a supervisor."""
MOST_SIGMA = {"m": 1.0, "m/s": 0.5, "rad": 0.35, "rad/s": 0.2}
"""Largest accepted standard deviation of an estimated quantity that the law reads, by the unit of the quantity."""
STATE = "estimate.state."


class Preflight:
    """Checks of a flight before the vehicle is armed. Times `now` are by the autopilot's clock, in 100 ns."""

    def __init__(
        self,
        scenario: Scenario,
        end: AutopilotEnd,
        remote: RemoteVehicle,
        counts: FrameCounts,
        disk: Disk = SYSTEM_DISK,
    ) -> None:
        """Start before the first run of the checks. counts: frame counters of the autopilot's endpoint.  disk: disk of
        the log."""
        self._end, self._remote, self._loss, self._disk = end, remote, FrameLoss(counts), disk
        supervisor = scenario.autopilot.supervisor
        self._stale_age = STALE_AGE if supervisor is None else float(supervisor.stale_age)
        self._sigmas = _find_sigmas(end.step, scenario.autopilot.law.reads)
        self._next = 0
        self._began: int | None = None
        self._is_shown, self._obstacles = False, set[str]()
        self.log_folder: Path | None = None
        self.checks: list[ArmingCheck] = []
        """Last results of the checks. The vehicle's checks are first, because a missing sensor explains a missing
        estimate."""
        self._theirs = 0
        self.is_decided = False
        self.obstacle = ""
        """Text of the failing check that the flight waits for. It is empty if no check fails, and during the first
        second."""
        self.refusal = ""
        """Reason for giving up the flight, or an empty string."""

    def update(self, now: int, silence: int) -> bool:
        """Return True if the vehicle may be asked to arm now. silence: time (100 ns) since the last data from the
        vehicle."""
        if self._began is None:
            self._began = now
        self._loss.follow(now)
        self._remote.wants_checks = not self._remote.arming.is_asking  # of two requests, one could overtake the other
        if self._remote.arming.is_asking and now - self._began >= PATIENCE:
            self.refusal = "arming refused by the vehicle, or no answer; see the vehicle's messages"
        if self._remote.arming.is_asking or now < self._next:
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
            self.refusal = "arming refused: the vehicle's checks are incomplete; check the link"
        may_arm = is_told and not failing and not self.refusal
        self._began = now if may_arm else self._began
        self.is_decided = may_arm or bool(self.refusal)
        return may_arm

    def restart(self) -> None:
        """Restart the checks and the waiting time."""
        self._began, self.is_decided, self._is_shown, self.obstacle, self.refusal = None, False, False, "", ""
        self._obstacles.clear()

    def report(self, tell: Callable[[str], None]) -> None:
        """Report each new failing check once, and the table of all checks when the decision about arming is made."""
        obstacle = self.obstacle.partition(":")[0]
        if obstacle and obstacle not in self._obstacles and not self.refusal:
            self._obstacles.add(obstacle)
            tell(f"not armed yet: {self.obstacle}")
        if self.is_decided and not self._is_shown:
            self._is_shown = True
            for line in self.table.splitlines():
                tell(line)

    def _is_confirmed(self, check: ArmingCheck) -> bool:
        return check.name == CONFIRMATION_CHECK and self._remote.arming.confirms

    @property
    def table(self) -> str:
        """Text table of all checks, one line per check."""
        rows = [("", "check", "value", "limit", "")]
        for k, c in enumerate(self.checks):
            verdict = "ok" if c.passes else "confirmed" if self._is_confirmed(c) else "REFUSED"
            rows.append(("vehicle" if k < self._theirs else "autopilot", c.name, c.value_text, c.limit_text, verdict))
        widths = [max(len(row[k]) for row in rows) for k in range(5)]
        return "\n".join("  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)

    def describe_checks(self) -> list[dict[str, Any]]:
        """Return the checks as dictionaries for JSON."""
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
        accept = f"--accept {remote.comparison.first_difference()} if intended"
        sigmas = [
            ArmingCheck(name, float(step.outputs[at]), MOST_SIGMA[unit], unit, "wait until the estimator has settled")
            for name, (at, unit) in self._sigmas.items()
        ]
        return [
            ArmingCheck("estimate valid", read("estimate.valid"), 1, "", "check the vehicle's sensors", at_least=True),
            ArmingCheck("estimate age", read("estimate.age"), self._stale_age, "s", "check the vehicle's sensors"),
            *sigmas,
            ArmingCheck("supervisor's objections", float(check > 0), 0, "", f"reason: {CHECKS[check]}"),
            ArmingCheck(
                "command valid", float(self._end.has_command), 1, "", "wait for the law's first command", at_least=True
            ),
            ArmingCheck("link silence", silence, LONGEST_SILENCE, "s", "check the link"),
            ArmingCheck("frames lost", self._loss.share, MOST_LOSS, "%", "move the two ends closer"),
            ArmingCheck(
                "clock round trip",
                to_seconds(remote.clock.sync.shortest),
                to_seconds(QUICK_ROUND_TRIP),
                "s",
                "check the link",
            ),
            ArmingCheck("settings that differ", remote.comparison.count_differences(), 0, "", accept),
            ArmingCheck("space for the log", space, LEAST_SPACE, "MB", "free disk space", at_least=True),
        ]


def _find_sigmas(step: CompiledBlock, reads: Iterable[str]) -> dict[str, tuple[Any, str]]:
    """Return index in the output vector and unit of the standard deviation of each estimated quantity that a law
    reads."""
    wanted = {f"{STATE}sigma_{name}" for name in reads}
    return {
        m.path.removeprefix(STATE): (step.writes[m.path], m.declaration.unit)
        for m in step.text.outputs
        if m.path in wanted and not m.shape and m.declaration is not None and m.declaration.unit in MOST_SIGMA
    }
