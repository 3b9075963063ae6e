"""Why an autopilot's end doesn't fly: wrong key, wrong clock, wrong scenario, wrong owner; each with what to type.

Source: docs page, Fly.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.wire.identity import SettingDifference
from trimtab.wire.stamps import MOST_LEAD, PER_SECOND

VEHICLE_CLOCK, COMPUTER_CLOCK, STORED_CLOCK = "vehicle", "computer", "stored"
"""By which clock an end signs: the other end's, this computer's whatever is stored, or on from what is stored."""


MOST_SHOWN = 8
"""Differences that are listed."""


class ConnectionProblem(NamedTuple):
    """What is wrong, and what to type."""

    problem: str
    fix: str


def key_problem(frames: int, typed: str) -> ConnectionProblem:
    """The vehicle has another key. frames: of its, that were refused; typed: the command that was typed."""
    problem = f"wrong key: {frames} frames came from the vehicle that another key than this end's has signed"
    return ConnectionProblem(problem, f"{typed} --key FILE   with a copy of the vehicle's key file")


def signing_problem(is_signed: bool, typed: str) -> ConnectionProblem:
    """One end signs, the other does not. is_signed: whether this one does."""
    if is_signed:
        problem = "wrong key: the vehicle signs nothing, and this end takes signed frames only"
        return ConnectionProblem(problem, f"{typed} --unsigned   or the vehicle without it")
    problem = "wrong key: the vehicle takes signed frames only, and this end has no key"
    return ConnectionProblem(problem, typed.replace(" --unsigned", ""))


def scenario_problem(differences: Sequence[SettingDifference], typed: str) -> ConnectionProblem:
    """The vehicle is another than this end flies: another scenario, or other numbers.

    Args:
        differences: at least one.
        typed: the command that was typed.
    """
    shown = [str(d) for d in differences[:MOST_SHOWN]]
    shown += [f"and {len(differences) - MOST_SHOWN} more"] if len(differences) > MOST_SHOWN else []
    problem = "\n  ".join(["wrong scenario: the vehicle's settings are not this end's", *shown])
    name = next((d for d in differences if d.path == "scenario"), None)
    if name is not None and name.theirs and name.ours in typed:
        return ConnectionProblem(problem, typed.replace(name.ours, name.theirs, 1))
    if any(d.path in ("messages", "version") for d in differences):
        return ConnectionProblem(problem, "the same trimtab, the same scenario and the same --set on both ends")
    settings = " ".join(f"--set {d.path}={d.theirs}" for d in differences)
    if len(differences) <= MOST_SHOWN and all(d.theirs and " " not in d.theirs for d in differences):
        other = " ".join((_without_settings(typed, [d.path for d in differences]), settings))
        return ConnectionProblem(problem, f"{other}   or, where it is meant, --accept {differences[0].path}")
    accepts = " ".join(f"--accept {root}" for root in sorted({".".join(d.path.split(".")[:2]) for d in differences}))
    return ConnectionProblem(problem, f"the same --set on both ends; or, where it is meant,  {typed} {accepts}")


def _without_settings(typed: str, paths: Sequence[str]) -> str:
    """The command without what it sets at these paths: no path is taken twice."""
    for path in map(re.escape, paths):
        typed = re.sub(rf" --set[ =](?:'{path}=[^']*'|{path}=\S+)", "", typed)
    return typed


def owner_problem(owner: int, typed: str) -> ConnectionProblem:
    """Somebody else flies it. owner: the session of that one; typed: the command that was typed."""
    problem = f"wrong owner: the vehicle is flown by another autopilot, session {owner:06x}"
    return ConnectionProblem(problem, f"{typed} --take-over   or end that flight where it was started")


def clock_problem(lead: float, stored_lead: float, typed: str) -> ConnectionProblem:
    """The two clocks differ.

    Args:
        lead: of the vehicle's time stamps over this end's (s).
        stored_lead: of this end's over its computer's clock (s): a wrong clock once, that was stored.
        typed: the command that was typed.
    """
    if stored_lead > MOST_LEAD / PER_SECOND and abs(lead + stored_lead) <= MOST_LEAD / PER_SECOND:
        problem = f"wrong clock: an earlier flight's was {stored_lead:.1f} s ahead, and this end goes on from there"
        return ConnectionProblem(problem, f"{typed} --clock {COMPUTER_CLOCK}")
    which = "ahead of" if lead > 0 else "behind"
    problem = f"wrong clock: clocks differ by {abs(lead):.1f} s, the vehicle's is {which} this computer's"
    return ConnectionProblem(problem, f"{typed} --clock {VEHICLE_CLOCK}   or set the one that is wrong by  date -s")
