"""Cases of the campaign, with act, required ending and required log lines, and the verdict on a flight."""

import contextlib
import re
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from studies.live_faults.flight import NAME, FaultFlight, ProcessResult, VehicleKnowledge
from studies.live_faults.process import NotReady
from studies.live_faults.verdict import describe_course, failsafe_causes, find_violations
from studies.live_faults.words import Evidence, EvidenceCheck, list_unexplained, logged_event, printed_line
from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.run.replay import describe_replay, replay
from trimtab.scenarios.recorded import rebuild_scenario

FLY_S, AFTER_S = 4.0, 2.0
"""Flight time (s) of the autopilot after arming, and time (s) for which the vehicle runs on after the flight."""
FLIES, STOPS, EITHER = "flies on", "stops", "either"
KILLED = -signal.SIGKILL
REFUSED = 2
ENDED = (0, 1)
"""Exit statuses of a process that was neither refused nor crashed. 1 means that its result lists problems."""
VEHICLE, AUTOPILOT = "vehicle-1", "autopilot-1"
FAILSAFE = logged_event(VEHICLE, "failsafe: no command")


CAUSE, UNEXPLAINED, REPLAY = "cause:", "unexplained:", "replay"
"""First words of problems that do not concern safety."""
WAITING_S = 0.1
"""Longest accepted wait (s) of a process, the link or the campaign. A longer wait may be the cause of a failure."""
UNHEARD_S = 0.04
"""Delay of a vehicle (s) after which its outputs may have gone safe on their own. Outputs wait for 50 ms."""


class OpenFlight(Protocol):
    """Function that opens a flight, with real processes or in virtual time."""

    def __call__(self, folder: Path, known: VehicleKnowledge, *, serial: bool = False) -> FaultFlight:
        """Open a flight. serial: True for a link over a pair of serial devices."""
        ...


class RefusedStart(NamedTuple):
    """Start of an autopilot that must be refused. It then flies with the command that the refusal suggests.

    says: pattern of the refusal.  keeps_environment: True if the wrong environment remains for the second start.
    """

    says: str
    options: tuple[str, ...] = ()
    scenario: str = NAME
    environment: Callable[[FaultFlight], dict[str, str]] = lambda _: {}
    keeps_environment: bool = True


class Case(NamedTuple):
    """Fault of the pair, with its required effects.

    does: description of the act on an armed flight.  act: function that performs the act.
    expected_ending: FLIES (no failsafe), STOPS (failsafe) or EITHER.  evidence_checks: required evidence in the logs.
    actuator_fault_s: time for which actuators ignore commands (s).
    command_delay_s: delay of commands within the vehicle (s), by a fault of its uplink.
    statuses: exit statuses other than ENDED, by process.  fly: flight time (s), as FLY_S.
    missing_requirement: returns the reason why this machine cannot run the case, or an empty text.
    partial: processes whose log may be incomplete.  stopped_s: process -> time for which it was stopped on purpose (s).
    refused_start: start of an autopilot that is refused, before the flight.
    explains: patterns of log lines that the act explains; None allows any line.
    has_autopilot: False if the act itself flies the vehicle.
    """

    name: str
    does: str
    act: Callable[[FaultFlight], None]
    expected_ending: str = EITHER
    evidence_checks: tuple[EvidenceCheck, ...] = ()
    actuator_fault_s: float = 0.0
    command_delay_s: float = 0.0
    statuses: dict[str, tuple[int, ...]] = {}
    serial: bool = False
    fly: float = FLY_S
    prepare: Callable[[FaultFlight], dict[str, dict[str, str]]] = lambda _: {}
    missing_requirement: Callable[[], str] = lambda: ""
    partial: tuple[str, ...] = ()
    stopped_s: dict[str, float] = {}
    refused_start: RefusedStart | None = None
    vehicle_options: tuple[str, ...] = ()
    autopilot_options: tuple[str, ...] = ()
    explains: tuple[str, ...] | None = None
    has_autopilot: bool = True


class CaseOutcome(NamedTuple):
    """Outcome of a case.

    problems: problems of the flight, none if the case holds.  skipped: reason why it was not flown.
    waited: processes that were kept waiting, with their times; empty if none was.
    replays: for each autopilot log with a step, True if its replay is bit-exact.
    repeated: True for a second flight, because a process was kept waiting in the first.
    digest: hash of all packets, log rows and events of a flight in virtual time.
    acted_s: reason why outputs should have been safe -> longest time (s) for which they acted, in virtual time.
    """

    name: str
    does: str
    happened: str
    said: tuple[str, ...]
    problems: tuple[str, ...]
    skipped: str = ""
    waited: str = ""
    replays: tuple[bool, ...] = ()
    repeated: bool = False
    digest: str = ""
    acted_s: dict[str, float] = {}

    def has_problem(self, kind: str | None) -> bool:
        """Return True if a problem is of this kind. kind None: the vehicle was not safe, or a process crashed."""
        kinds = [next((k for k in (CAUSE, UNEXPLAINED, REPLAY) if p.startswith(k)), None) for p in self.problems]
        return kind in kinds

    @property
    def verdict(self) -> str:
        """Verdict in one or two words.

        "kept waiting" means that the case failed on a machine that was too busy for any flight.
        """
        if self.skipped or not self.problems:
            return "skipped" if self.skipped else "holds"
        return "kept waiting" if self.waited else "fails"


def fly_case(case: Case, known: VehicleKnowledge, folder: Path, open_flight: OpenFlight = FaultFlight) -> CaseOutcome:
    """Fly a case and return its outcome. Errors become problems. open_flight: real processes, or virtual time."""
    why = case.missing_requirement()
    if why:
        return CaseOutcome(case.name, case.does, "", (), (), why)
    try:
        folder.mkdir(parents=True)
        flight = open_flight(folder, known, serial=case.serial)
        try:
            given = case.prepare(flight)
            flight.start_vehicle(case.fly + AFTER_S, *case.vehicle_options, **given.get("vehicle", {}))
            if not case.has_autopilot:
                case.act(flight)
                flight.end_vehicles()
                return evaluate_flight(case, flight.finish())
            if case.refused_start is None:
                flight.start_autopilot(case.fly, *case.autopilot_options, **given.get("autopilot", {}))
            else:
                _start_after_refusal(flight, case.refused_start, case.fly)
            flight.wait_for_arming()
            flight.relay.longest_wait_s = flight.overslept_s = 0.0
            case.act(flight)
            ended = flight.finish()
            own = {"the line": flight.relay.longest_wait_s, "the campaign": flight.overslept_s}
            waits = [f"{who} {s:.2f} s" for who, s in own.items() if s > WAITING_S]
            outcome = evaluate_flight(case, ended)
            return outcome._replace(waited=", ".join([*waits, *([outcome.waited] if outcome.waited else [])]))
        finally:
            flight.close()
    except NotReady as error:
        return CaseOutcome(case.name, case.does, "", (), (str(error),), waited=str(error) if error.is_late else "")
    except (InputError, OSError) as error:
        return CaseOutcome(case.name, case.does, "", (), (f"{type(error).__name__}: {error}",))


def _start_after_refusal(flight: FaultFlight, start: RefusedStart, duration: float) -> None:
    """Start an autopilot that is refused, then another one with the command that the refusal suggests."""
    environment = start.environment(flight)
    typed = flight.start_refused(*start.options, scenario=start.scenario, **environment)
    if not typed:
        raise NotReady(f"the refusal suggests no command: {flight.refused[-1].output_text.strip()[-300:]}", False)
    flight.start_as_told(typed, duration, **(environment if start.keeps_environment else {}))


def evaluate_flight(case: Case, ended: list[ProcessResult]) -> CaseOutcome:
    """Judge a flight by exit statuses, output and logs."""
    problems, logs = [], dict[str, Log]()
    for one in ended:
        if one.name.startswith("refused"):
            start = case.refused_start
            if start and (one.status != REFUSED or not re.search(start.says, one.output_text)):
                problems.append(f"{one.name} ended with {one.status}: {one.output_text.strip()[-300:]}")
            continue
        allowed = case.statuses.get(one.name, ENDED)
        if one.status not in allowed:
            problems.append(f"{one.name} ended with {one.status}: {one.output_text.strip()[-300:]}")
        elif one.status in ENDED and bool((one.result or {}).get("problems")) != bool(one.status):
            problems.append(f"{one.name} ended with {one.status}, which contradicts its result: {one.result}")
        if "Traceback" in one.output_text:
            problems.append(f"{one.name} crashed: {one.output_text.strip()[-300:]}")
        try:
            logs[one.name] = one.read_log()
        except (InputError, OSError) as error:
            problems.append(f"the log of {one.name} cannot be read: {error}")
    happened = "; ".join(_describe_course(n, log) for n, log in logs.items() if n.startswith("vehicle"))
    for name, log in logs.items():
        if name.startswith("vehicle") and KILLED in case.statuses.get(name, ()):
            cut = find_violations(log, broken=_actuator_fault_interval(case, log), whole=False)
            problems += [f"{name}: {p}" for p in cut]
        elif name.startswith("vehicle"):
            result = next(one.result for one in ended if one.name == name) or {}
            problems += [f"{name}: {p}" for p in _check_log(case, log, result if name in case.partial else None)]
    evidence = Evidence({one.name: one for one in ended}, logs)
    said = [words(evidence) for words in case.evidence_checks]
    if "" in said:
        problems.append(f"{CAUSE} the logs lack required evidence number {said.index('') + 1}")
    if case.explains is not None:
        problems += [f"{UNEXPLAINED} {line}" for line in list_unexplained(evidence, case.explains)]
    if case.refused_start is not None:
        said = [printed_line("refused-1", case.refused_start.says)(evidence), *said]
    replays = [_check_replay(name, log) for name, log in logs.items() if name.startswith("autopilot") and len(log)]
    problems += [p for p in replays if p]
    texts = tuple(s for s in said if s)
    waited = ", ".join(_list_waits(case, logs))
    equal = tuple(not p for p in replays)
    return CaseOutcome(case.name, case.does, happened, texts, tuple(problems), "", waited, equal)


def _check_replay(name: str, log: Log) -> str:
    """Return the problem found by replaying an autopilot's log, or an empty text if all bits are equal."""
    try:
        again = replay(log, rebuild_scenario(log, None))
    except InputError as error:
        return f"{REPLAY} of {name}: {error}"
    return "" if again.exact else f"{REPLAY} of {name}: {describe_replay(again)}"


def _list_waits(case: Case, logs: Mapping[str, Log]) -> list[str]:
    """Return the processes that waited for a processor, by their own logs, while the vehicle was not held."""
    waits = []
    for name, log in logs.items():
        path = "firmware.late" if name.startswith("vehicle") else "loop.late"
        went_safe = any(e["text"].startswith("outputs went safe") for e in log.metadata.get("events", []))
        counts = ~log["firmware.held"].astype(bool) if "firmware.held" in log else np.ones(len(log), bool)
        longest = float(np.max(log[path][counts | went_safe], initial=0.0)) if path in log else 0.0
        if longest > (UNHEARD_S if went_safe else WAITING_S) + case.stopped_s.get(name, 0.0):
            waits.append(f"{name} {longest:.2f} s")
    return waits


def _describe_course(name: str, log: Log) -> str:
    return describe_course(log) if name == "vehicle-1" else f"{name}: {describe_course(log)}"


def _check_log(case: Case, log: Log, told: dict[str, Any] | None) -> list[str]:
    """Return the problems of a log. told: result of a vehicle whose log may be incomplete; else None."""
    found = find_violations(log, broken=_actuator_fault_interval(case, log), whole=told is None)
    if told is not None and told.get("mode") not in ("disarmed", "failsafe"):
        found.append(f"ended in mode {told.get('mode')}")
    causes = failsafe_causes(log)
    if case.expected_ending == FLIES and causes:
        found.append(f"went to failsafe ({', '.join(causes)}), for which the case is no reason")
    if case.expected_ending == STOPS and not causes:
        found.append("did not go to failsafe")
    return found


def _actuator_fault_interval(case: Case, log: Log) -> tuple[float, float] | None:
    """Return the start and end (s) of an actuator fault, from its logged event, or None."""
    if not case.actuator_fault_s:
        return None
    times: list[Any] = [e["t"] for e in log.metadata.get("events", []) if "actuators.fault.kind" in e["text"]]
    with contextlib.suppress(IndexError):
        return times[0] - 0.5, times[0] + case.actuator_fault_s
    return None
