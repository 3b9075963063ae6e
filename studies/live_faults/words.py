"""Evidence in logs: required events, counters and gaps. Each check returns a quote of what it finds."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from studies.live_faults.flight import ProcessResult
from trimtab.flight.station.streams import PIECE
from trimtab.logs.log import Log


class Evidence(NamedTuple):
    """Evidence of a flight: results of the processes, and the readable logs by the process's name."""

    process_results: Mapping[str, ProcessResult]
    logs: Mapping[str, Log]


FROM_VEHICLE = "vehicle: "
USUAL = (
    r"^supervisor: (standby|flying): (start|automatic)",
    r"^(vehicle: )?autopilot: (standby|flying|lost|ended)",
    r"^(vehicle: )?(computer: arm request|disarmed: disarm request|disarmed: start)",
    r"^(vehicle: )?commanded by 1/191 session",
    r"^ended(: duration reached| by request)",
    r"^the vehicle's (settings|messages) ",
    r"^(vehicle: )?check .*: passed$",
    r"^(autopilot|vehicle)  .*  ok$",
    r"^ +check +value +limit$",
)
"""Patterns of lines in the log of any flight."""
EvidenceCheck = Callable[[Evidence], str]
"""Function that returns a quote of the evidence in a log, or an empty text if it is missing."""


def list_unexplained(evidence: Evidence, explains: Sequence[str]) -> list[str]:
    """Return the log lines that are neither usual nor explained by the act. explains: patterns of explained lines."""
    known = [re.compile(p) for p in (*USUAL, *explains)]
    return [
        f"{who}: “{text}”"
        for who, log in evidence.logs.items()
        for text in _join_pieces([event["text"] for event in log.metadata.get("events", [])])
        if not any(p.search(text) for p in known)
    ]


def _join_pieces(texts: Sequence[str]) -> list[str]:
    """Return the lines of a log, with status texts that were sent in pieces joined."""
    lines: list[str] = []
    is_open = False
    for text in texts:
        is_piece = text.startswith(FROM_VEHICLE)
        if is_open and is_piece:
            lines[-1] += text.removeprefix(FROM_VEHICLE)
        else:
            lines.append(text)
        is_open = is_piece and len(text) == len(FROM_VEHICLE) + PIECE
    return lines


def logged_event(who: str, pattern: str) -> EvidenceCheck:
    """Return a check for an event of a log."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        for event in log.metadata.get("events", []) if log else []:
            if re.search(pattern, event["text"]):
                return f"{who}: “{event['text']}”"
        return ""

    return look


def either_of(*checks: EvidenceCheck) -> EvidenceCheck:
    """Return a check for any of several kinds of evidence, which quotes the first."""
    return lambda evidence: next((said for said in (check(evidence) for check in checks) if said), "")


def counter_rise(who: str, path: str, least: int = 1) -> EvidenceCheck:
    """Return a check for a counter of a log that has risen."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        rise = int(log[path].max() - log[path].min())
        return f"{who}: `{path}` rose by {rise}" if rise >= least else ""

    return look


def flag_gap(who: str, path: str, least: float) -> EvidenceCheck:
    """Return a check for a flag of a log that was false for at least this time (s) between two times it was true."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        times = log.t[log[path].astype(bool)]
        longest = float(np.diff(times).max()) if len(times) > 1 else 0.0
        return f"{who}: `{path}` false for {longest:.2f} s" if longest >= least else ""

    return look


def peak_level(who: str, path: str, least: float) -> EvidenceCheck:
    """Return a check for a signal of a log that has reached a level."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        most = float(np.nanmax(log[path]))
        return f"{who}: `{path}` up to {most:.3g}" if most >= least else ""

    return look


def printed_line(who: str, pattern: str) -> EvidenceCheck:
    """Return a check for a line for the user, on standard error."""

    def look(evidence: Evidence) -> str:
        found = re.search(f".*(?:{pattern}).*", evidence.process_results[who].output_text)
        return f"{who}, to the user: “{found[0].strip()}”" if found else ""

    return look


def counter_below(who: str, path: str, limit: int) -> EvidenceCheck:
    """Return a check for a counter of a log that rose by less than an implausible number."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        rise = limit if log is None or path not in log else int(log[path].max() - log[path].min())
        return f"{who}: `{path}` rose by {rise}" if rise < limit else ""

    return look


def absent_event(who: str, pattern: str) -> EvidenceCheck:
    """Return a check that a log lacks a line."""
    present = logged_event(who, pattern)

    def look(evidence: Evidence) -> str:
        return "" if who not in evidence.logs or present(evidence) else f"{who}: no message “{pattern}”"

    return look


def arming_count(number: int) -> EvidenceCheck:
    """Return a check of the number of armings in the vehicle's log."""

    def look(evidence: Evidence) -> str:
        events = evidence.logs["vehicle-1"].metadata.get("events", []) if "vehicle-1" in evidence.logs else []
        count = sum(event["text"] == "computer: arm request" for event in events)
        return f"vehicle-1: number of armings: {count}" if count == number else ""

    return look


def exit_status(who: str, number: int) -> EvidenceCheck:
    """Return a check of the exit status of a process."""

    def look(evidence: Evidence) -> str:
        status = evidence.process_results[who].status
        return f"{who}: exit code {status}" if status == number else ""

    return look


def outputs_safe(why: str, most_ms: float = 100.0) -> EvidenceCheck:
    """Return a check for outputs that went safe on their own soon enough after the last row of the vehicle."""

    def look(evidence: Evidence) -> str:
        file = evidence.process_results["vehicle-1"].log.with_name("outputs.txt")
        text = file.read_text("utf-8") if file.exists() else ""
        found = re.search(rf"safe, ([0-9.]+) ms after the last row: .*{why}.*", text)
        return f"vehicle-1's outputs: “{found[0]}”" if found and float(found[1]) <= most_ms else ""

    return look


def first_evidence(*several: EvidenceCheck) -> EvidenceCheck:
    """Return a check for the first of several kinds of evidence that is found."""

    def look(evidence: Evidence) -> str:
        return next((said for words in several if (said := words(evidence))), "")

    return look
