"""One case of the campaign: what is done, how it must end, what the logs must say; and the judgement of a flight."""

import contextlib
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from studies.live_faults.flight import FaultFlight, ProcessResult, VehicleKnowledge
from studies.live_faults.process import NotReady
from studies.live_faults.verdict import describe_course, failsafe_causes, find_violations
from studies.live_faults.words import Evidence, EvidenceCheck, logged_event
from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap

FLY_S, AFTER_S = 4.0, 2.0
"""How long the autopilot flies from arming on, and how long the vehicle stays up after it."""
FLIES, STOPS, EITHER = "flies on", "stops", "either"
KILLED = -signal.SIGKILL
VEHICLE, AUTOPILOT = "vehicle-1", "autopilot-1"
FAILSAFE = logged_event(VEHICLE, "failsafe: no command")


class Case(NamedTuple):
    """A fault of the pair.

    does: what is done to a flight that has been armed, in words.  act: does it.  ends: FLIES, no failsafe; STOPS, one;
    EITHER.  words: what the logs must say.  broken: for how long (s) actuators obey nobody.  statuses: exit statuses
    other than 0, by process.  fly: see FLY_S.  needs: why it can't be done here, or nothing.
    partial: whose log can't be whole.
    """

    name: str
    does: str
    act: Callable[[FaultFlight], None]
    expected_ending: str = EITHER
    evidence_checks: tuple[EvidenceCheck, ...] = ()
    actuator_fault_s: float = 0.0
    statuses: dict[str, tuple[int, ...]] = {}
    serial: bool = False
    fly: float = FLY_S
    prepare: Callable[[FaultFlight], dict[str, dict[str, str]]] = lambda _: {}
    missing_requirement: Callable[[], str] = lambda: ""
    partial: tuple[str, ...] = ()


class CaseOutcome(NamedTuple):
    """What became of a case. problems: empty where it holds.  skipped: why it was not done."""

    name: str
    does: str
    happened: str
    said: tuple[str, ...]
    problems: tuple[str, ...]
    skipped: str = ""

    @property
    def verdict(self) -> str:
        """In a word."""
        return "skipped" if self.skipped else "fails" if self.problems else "holds"


def fly_case(case: Case, known: VehicleKnowledge, folder: Path) -> CaseOutcome:
    """Do it, and judge it; nothing that goes wrong in it is raised."""
    why = case.missing_requirement()
    if why:
        return CaseOutcome(case.name, case.does, "", (), (), why)
    folder.mkdir(parents=True)
    try:
        flight = FaultFlight(folder, known, serial=case.serial)
        try:
            given = case.prepare(flight)
            flight.start_vehicle(case.fly + AFTER_S, **given.get("vehicle", {}))
            flight.start_autopilot(case.fly, **given.get("autopilot", {}))
            flight.wait_for_arming()
            case.act(flight)
            ended = flight.finish()
            return evaluate_flight(case, ended)
        finally:
            flight.close()
    except (NotReady, InputError, OSError) as error:
        return CaseOutcome(case.name, case.does, "", (), (f"{type(error).__name__}: {error}",))


def evaluate_flight(case: Case, ended: list[ProcessResult]) -> CaseOutcome:
    """By exit statuses, by what was said, and by the logs."""
    problems, logs = [], dict[str, Log]()
    for one in ended:
        allowed = case.statuses.get(one.name, (0,))
        if one.status not in allowed:
            problems.append(f"{one.name} ended with {one.status}: {one.output_text.strip()[-300:]}")
        if "Traceback" in one.output_text:
            problems.append(f"{one.name} crashed: {one.output_text.strip()[-300:]}")
        try:
            logs[one.name] = read_mcap(one.log)
        except (InputError, OSError) as error:
            problems.append(f"the log of {one.name} can't be read: {error}")
    happened = "; ".join(_describe_course(n, log) for n, log in logs.items() if n.startswith("vehicle"))
    for name, log in logs.items():
        if name.startswith("vehicle") and KILLED not in case.statuses.get(name, ()):
            result = next(one.result for one in ended if one.name == name) or {}
            problems += [f"{name}: {p}" for p in _check_log(case, log, result if name in case.partial else None)]
    evidence = Evidence({one.name: one for one in ended}, logs)
    said = [words(evidence) for words in case.evidence_checks]
    if "" in said:
        problems.append(f"nothing in the logs for what is asked of them, number {said.index('') + 1}")
    return CaseOutcome(case.name, case.does, happened, tuple(s for s in said if s), tuple(problems))


def _describe_course(name: str, log: Log) -> str:
    return describe_course(log) if name == "vehicle-1" else f"{name}: {describe_course(log)}"


def _check_log(case: Case, log: Log, told: dict[str, Any] | None) -> list[str]:
    """told: how a vehicle says that it ended, whose log can't be whole; else None."""
    found = find_violations(log, broken=_actuator_fault_interval(case, log), whole=told is None)
    if told is not None and told.get("mode") not in ("disarmed", "failsafe"):
        found.append(f"ended in mode {told.get('mode')}")
    causes = failsafe_causes(log)
    if case.expected_ending == FLIES and causes:
        found.append(f"went to failsafe ({', '.join(causes)}), which this is no reason for")
    if case.expected_ending == STOPS and not causes:
        found.append("did not go to failsafe")
    return found


def _actuator_fault_interval(case: Case, log: Log) -> tuple[float, float] | None:
    """When a fault of the actuators acted, by the event that says so."""
    if not case.actuator_fault_s:
        return None
    times: list[Any] = [e["t"] for e in log.metadata.get("events", []) if "actuators.fault.word" in e["text"]]
    with contextlib.suppress(IndexError):
        return times[0] - 0.5, times[0] + case.actuator_fault_s
    return None
