"""One case of the campaign: what is done, how it must end, what the logs must say; and the judgement of a flight."""

import contextlib
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from studies.live_faults.flight import Ended, Flight, Ground
from studies.live_faults.process import NotReady
from studies.live_faults.verdict import course, tripped, violations
from studies.live_faults.words import Evidence, Words, told
from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap

FLY_S, AFTER_S = 4.0, 2.0
"""How long the autopilot flies from arming on, and how long the vehicle stays up after it."""
FLIES, STOPS, EITHER = "flies on", "stops", "either"
KILLED = -signal.SIGKILL
VEHICLE, AUTOPILOT = "vehicle-1", "autopilot-1"
FAILSAFE = told(VEHICLE, "failsafe: no command")


class Case(NamedTuple):
    """A fault of the pair.

    does: what is done to a flight that has been armed, in words.  act: does it.  ends: FLIES, no failsafe; STOPS, one;
    EITHER.  words: what the logs must say.  broken: for how long (s) actuators obey nobody.  statuses: exit statuses
    other than 0, by process.  fly: see FLY_S.  needs: why it can't be done here, or nothing.
    partial: whose log can't be whole.
    """

    name: str
    does: str
    act: Callable[[Flight], None]
    ends: str = EITHER
    words: tuple[Words, ...] = ()
    broken: float = 0.0
    statuses: dict[str, tuple[int, ...]] = {}
    serial: bool = False
    fly: float = FLY_S
    prepare: Callable[[Flight], dict[str, dict[str, str]]] = lambda _: {}
    needs: Callable[[], str] = lambda: ""
    partial: tuple[str, ...] = ()


class Outcome(NamedTuple):
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


def fly_case(case: Case, known: Ground, folder: Path) -> Outcome:
    """Do it, and judge it; nothing that goes wrong in it is raised."""
    why = case.needs()
    if why:
        return Outcome(case.name, case.does, "", (), (), why)
    folder.mkdir(parents=True)
    try:
        flight = Flight(folder, known, serial=case.serial)
        try:
            given = case.prepare(flight)
            flight.start_vehicle(case.fly + AFTER_S, **given.get("vehicle", {}))
            flight.start_pilot(case.fly, **given.get("autopilot", {}))
            flight.armed()
            case.act(flight)
            ended = flight.finish()
            return judge(case, ended)
        finally:
            flight.close()
    except (NotReady, InputError, OSError) as error:
        return Outcome(case.name, case.does, "", (), (f"{type(error).__name__}: {error}",))


def judge(case: Case, ended: list[Ended]) -> Outcome:
    """By exit statuses, by what was said, and by the logs."""
    problems, logs = [], dict[str, Log]()
    for one in ended:
        allowed = case.statuses.get(one.name, (0,))
        if one.status not in allowed:
            problems.append(f"{one.name} ended with {one.status}: {one.said.strip()[-300:]}")
        if "Traceback" in one.said:
            problems.append(f"{one.name} crashed: {one.said.strip()[-300:]}")
        try:
            logs[one.name] = read_mcap(one.log)
        except (InputError, OSError) as error:
            problems.append(f"the log of {one.name} can't be read: {error}")
    happened = "; ".join(_course(n, log) for n, log in logs.items() if n.startswith("vehicle"))
    for name, log in logs.items():
        if name.startswith("vehicle") and KILLED not in case.statuses.get(name, ()):
            result = next(one.result for one in ended if one.name == name) or {}
            problems += [f"{name}: {p}" for p in _judged(case, log, result if name in case.partial else None)]
    evidence = Evidence({one.name: one for one in ended}, logs)
    said = [words(evidence) for words in case.words]
    if "" in said:
        problems.append(f"nothing in the logs for what is asked of them, number {said.index('') + 1}")
    return Outcome(case.name, case.does, happened, tuple(s for s in said if s), tuple(problems))


def _course(name: str, log: Log) -> str:
    return course(log) if name == "vehicle-1" else f"{name}: {course(log)}"


def _judged(case: Case, log: Log, told: dict[str, Any] | None) -> list[str]:
    """told: how a vehicle says that it ended, whose log can't be whole; else None."""
    found = violations(log, broken=_broken(case, log), whole=told is None)
    if told is not None and told.get("mode") not in ("disarmed", "failsafe"):
        found.append(f"ended in mode {told.get('mode')}")
    causes = tripped(log)
    if case.ends == FLIES and causes:
        found.append(f"went to failsafe ({', '.join(causes)}), which this is no reason for")
    if case.ends == STOPS and not causes:
        found.append("did not go to failsafe")
    return found


def _broken(case: Case, log: Log) -> tuple[float, float] | None:
    """When a fault of the actuators acted, by the event that says so."""
    if not case.broken:
        return None
    times: list[Any] = [e["t"] for e in log.metadata.get("events", []) if "actuators.fault.word" in e["text"]]
    with contextlib.suppress(IndexError):
        return times[0] - 0.5, times[0] + case.broken
    return None
