"""What a log must say: events, counters and gaps, each quoted where it is found."""

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from studies.live_faults.flight import ProcessResult
from trimtab.logs.log import Log


class Evidence(NamedTuple):
    """What a flight left: what each process left, and the logs that can be read, by the process's name."""

    process_results: Mapping[str, ProcessResult]
    logs: Mapping[str, Log]


EvidenceCheck = Callable[[Evidence], str]
"""What a log says, quoted; empty where it doesn't."""


def logged_event(who: str, pattern: str) -> EvidenceCheck:
    """An event of a log."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        for event in log.metadata.get("events", []) if log else []:
            if re.search(pattern, event["text"]):
                return f"{who}: “{event['text']}”"
        return ""

    return look


def counter_rise(who: str, path: str, least: int = 1) -> EvidenceCheck:
    """A counter of a log that has risen."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        rise = int(log[path].max() - log[path].min())
        return f"{who}: `{path}` {rise}" if rise >= least else ""

    return look


def flag_gap(who: str, path: str, least: float) -> EvidenceCheck:
    """A flag of a log that stayed down for at least this long (s) between two times that it was up."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        times = log.t[log[path].astype(bool)]
        longest = float(np.diff(times).max()) if len(times) > 1 else 0.0
        return f"{who}: `{path}` silent for {longest:.2f} s" if longest >= least else ""

    return look


def peak_level(who: str, path: str, least: float) -> EvidenceCheck:
    """A number of a log that has reached a level."""

    def look(evidence: Evidence) -> str:
        log = evidence.logs.get(who)
        if log is None or path not in log:
            return ""
        most = float(np.nanmax(log[path]))
        return f"{who}: `{path}` up to {most:.3g}" if most >= least else ""

    return look


def printed_line(who: str, pattern: str) -> EvidenceCheck:
    """A line for people, on standard error."""

    def look(evidence: Evidence) -> str:
        found = re.search(f".*(?:{pattern}).*", evidence.process_results[who].output_text)
        return f"{who}, to people: “{found[0].strip()}”" if found else ""

    return look


def first_evidence(*several: EvidenceCheck) -> EvidenceCheck:
    """The first of several that is there."""

    def look(evidence: Evidence) -> str:
        return next((said for words in several if (said := words(evidence))), "")

    return look
