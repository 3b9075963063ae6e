"""Findings at version 0.1, one per row, with the cases that try the same again.

A row says what happened then. Its cases measure what happens now.
"""

from collections.abc import Sequence
from typing import NamedTuple

from studies.live_faults.case import CaseOutcome

MENDED, AS_BEFORE = "mended", "as before"
MOST_SHOWN = 240
"""Maximum number of shown characters of the evidence of a row's cases."""


class FoundFault(NamedTuple):
    """Finding. tried, happened: at version 0.1.  cases: names of campaign cases."""

    tried: str
    happened: str
    cases: tuple[str, ...]


FOUND: tuple[FoundFault, ...] = (
    FoundFault(
        "vehicle's process killed, or frozen",
        "outputs stayed at the last row, thrust and lift on; the failsafe came when it woke, if at all",
        ("vehicle-killed", "vehicle-crashed", "vehicle-frozen", "vehicle-frozen-2"),
    ),
    FoundFault(
        "autopilot's clock 120 s behind",
        "refused for ever, never answered; the autopilot said “no connection”",
        ("autopilot-clock-120-behind", "autopilot-clock-hour-behind"),
    ),
    FoundFault(
        "autopilot's clock a day ahead, once",
        "its stamp was taken and kept; everybody with the right clock was refused for a day",
        ("autopilot-clock-day-ahead", "autopilot-clock-120-ahead"),
    ),
    FoundFault("replay of a log that names code as its scenario", "imported and called it", ("hostile-log",)),
    FoundFault(
        "one sample stamped an hour ahead", "clocks wrong for the rest of the flight; failsafe", ("sample-ahead",)
    ),
    FoundFault(
        "two autopilots with the key",
        "both obeyed; the end of one disarmed the other's vehicle",
        ("second-autopilot", "taken-over", "foreign-commands", "foreign-disarm"),
    ),
    FoundFault(
        "another signed system sends one command stamped 0.49 s ahead",
        "24 good commands rejected, failsafe",
        ("foreign-command-ahead",),
    ),
    FoundFault("two vehicles on one line", "both armed", ("twin",)),
    FoundFault(
        "another scenario, mass, sensor period on one side",
        "armed and flown without a word",
        ("other-scenario", "other-mass", "other-period"),
    ),
    FoundFault("arming with the only sensor off", "accepted", ("sensor-off-at-start",)),
    FoundFault("arming again in failsafe, while it moves", "accepted", ("armed-while-moving",)),
    FoundFault(
        "PX4's RTL, MISSION, LAND by DO_SET_MODE",
        "accepted, and flown as hold",
        ("mode-rtl", "mode-mission", "mode-land"),
    ),
    FoundFault("a mute client connects first by TCP", "the autopilot was locked out", ("mute-client",)),
    FoundFault("firmware.elf", "held the key, readable by all", ("key-in-firmware",)),
    FoundFault("vehicle without --out", "191 kB/s into the temporary folder, also while held", ("no-log-asked",)),
    FoundFault(
        "exit codes: vehicle killed, failsafe for most of a flight, log lost",
        "0",
        ("vehicle-killed", "cut-5", "vehicle-writer-killed"),
    ),
    FoundFault(
        "wrong key", "the autopilot said “no connection”; the vehicle told at its end only", ("wrong-key", "no-key")
    ),
    FoundFault(
        "sequence numbers random",
        "counters of lost frames told fiction",
        ("numbers-random-up", "numbers-random-down"),
    ),
    FoundFault("sensor times backwards", "“link lost”, for another cause", ("samples-back",)),
    FoundFault("frozen autopilot wakes", "“flying: found again” at a vehicle in failsafe", ("autopilot-frozen-told",)),
    FoundFault(
        "ground stations",
        "no global position, home, battery; missions, fence, logs, files timed out; every private sample to all; "
        "logs without wall time and frames",
        ("ground-station",),
    ),
    FoundFault("firmware", "for an emulated board only", ("board",)),
    FoundFault("exported C at INT64_MIN", "signed overflow, but for -fwrapv", ("least-times",)),
    FoundFault(
        "what other autopilots have: hardware watchdog, fence, log rotation, black box",
        "absent",
        ("features", "outputs-killed"),
    ),
)


def list_case_names() -> list[str]:
    """Return every case of a row, once."""
    return list(dict.fromkeys(name for row in FOUND for name in row.cases))


def compare_findings(outcomes: Sequence[CaseOutcome]) -> list[tuple[str, str, str, str]]:
    """Return for each row: tried, what happened at 0.1, what was seen now, verdict."""
    by_name = {one.name: one for one in outcomes}
    rows = []
    for row in FOUND:
        tried = [by_name[name] for name in row.cases if name in by_name]
        rows.append((row.tried, row.happened, "; ".join(_describe(one) for one in tried), judge_row(tried)))
    return rows


def judge_row(tried: Sequence[CaseOutcome]) -> str:
    """Return the verdict of a row: mended if every case holds."""
    verdicts = {one.verdict for one in tried} - {"skipped"}
    if not verdicts:
        return "skipped"
    return MENDED if verdicts == {"holds"} else AS_BEFORE if "fails" in verdicts else "kept waiting"


def _describe(one: CaseOutcome) -> str:
    """Return what a case saw: evidence of the logs, or problems."""
    seen = f"not tried, {one.skipped}" if one.skipped else ", ".join(one.problems or one.said) or one.happened
    text = " ".join(seen.split())
    return f"{one.name}: {text[:MOST_SHOWN]}{'…' if len(text) > MOST_SHOWN else ''}"
