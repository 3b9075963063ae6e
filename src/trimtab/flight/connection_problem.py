"""Descriptions of problems that prevent a flight: wrong signing key, clock, scenario or owner of the vehicle. Each
description says what to type.

Source: docs page, Fly.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.flight.mavlink.stamps import MOST_LEAD, PER_SECOND
from trimtab.flight.station.identity import SettingDifference

VEHICLE_CLOCK, COMPUTER_CLOCK, STORED_CLOCK = "vehicle", "computer", "stored"
"""Choices of the clock for the time stamps of signed packets: the vehicle's clock, this computer's clock, or this
computer's clock continued from the stored time stamp.
"""


MOST_SHOWN = 8
"""Maximum number of differing settings that a message lists."""


class ConnectionProblem(NamedTuple):
    """Description of a connection problem, and the command that solves it."""

    problem: str
    fix: str


def key_problem(frames: int, typed: str) -> ConnectionProblem:
    """Return a description of the problem that vehicle and autopilot have different signing keys.

    frames: number of rejected frames of the vehicle.  typed: the command that the user typed.
    """
    problem = f"wrong key: the vehicle signs with another key than this end ({frames} frames)"
    return ConnectionProblem(problem, f"{typed} --key FILE   with a copy of the vehicle's key file")


def signing_problem(is_signed: bool, typed: str) -> ConnectionProblem:
    """Return a description of the problem that only one end of the link signs its packets. is_signed: True if the
    autopilot signs, False if the vehicle signs."""
    if is_signed:
        problem = "wrong key: the vehicle does not sign its frames, and this end accepts signed frames only"
        return ConnectionProblem(problem, f"{typed} --unsigned   or start the vehicle without --unsigned")
    problem = "wrong key: the vehicle accepts signed frames only, and this end has no key"
    return ConnectionProblem(problem, typed.replace(" --unsigned", ""))


def scenario_problem(differences: Sequence[SettingDifference], typed: str) -> ConnectionProblem:
    """Return a description of the problem that the vehicle flies another scenario, or other parameters.

    Args:
        differences: settings that differ between vehicle and autopilot; at least one.
        typed: the command that the user typed.
    """
    shown = [str(d) for d in differences[:MOST_SHOWN]]
    shown += [f"and {len(differences) - MOST_SHOWN} more"] if len(differences) > MOST_SHOWN else []
    problem = "\n  ".join(["wrong scenario: the vehicle's settings differ from this end's", *shown])
    name = next((d for d in differences if d.path == "scenario"), None)
    if name is not None and name.theirs and name.ours in typed:
        return ConnectionProblem(problem, typed.replace(name.ours, name.theirs, 1))
    if any(d.path in ("messages", "version") for d in differences):
        return ConnectionProblem(problem, "use the same trimtab, the same scenario and the same --set on both ends")
    settings = " ".join(f"--set {d.path}={d.theirs}" for d in differences)
    if len(differences) <= MOST_SHOWN and all(d.theirs and " " not in d.theirs for d in differences):
        other = " ".join((_without_settings(typed, [d.path for d in differences]), settings))
        return ConnectionProblem(problem, f"{other}   or, if intended, --accept {differences[0].path}")
    accepts = " ".join(f"--accept {root}" for root in sorted({".".join(d.path.split(".")[:2]) for d in differences}))
    return ConnectionProblem(problem, f"use the same --set on both ends; or, if intended,  {typed} {accepts}")


def _without_settings(typed: str, paths: Sequence[str]) -> str:
    """Return a command line without the --set options for the given paths, since a path may be set only once."""
    for path in map(re.escape, paths):
        typed = re.sub(rf" --set[ =](?:'{path}=[^']*'|{path}=\S+)", "", typed)
    return typed


def owner_problem(owner: int, typed: str) -> ConnectionProblem:
    """Return a description of the problem that another autopilot flies the vehicle.

    owner: session number of the other autopilot.  typed: the command that the user typed.
    """
    problem = f"wrong owner: the vehicle is flown by another autopilot, session {owner:06x}"
    return ConnectionProblem(problem, f"{typed} --take-over   or end that flight where it was started")


def clock_problem(lead: float, stored_lead: float, typed: str) -> ConnectionProblem:
    """Return a description of the problem that the clocks of vehicle and autopilot differ.

    Args:
        lead: lead of the vehicle's time stamps over the autopilot's time stamps (s).
        stored_lead: lead of the autopilot's time stamps over the clock of its computer (s). An earlier flight with a
            wrong clock can cause such a lead.
        typed: the command that the user typed.
    """
    if stored_lead > MOST_LEAD / PER_SECOND and abs(lead + stored_lead) <= MOST_LEAD / PER_SECOND:
        problem = f"wrong clock: the stored time stamp is {stored_lead:.1f} s ahead, from an earlier flight"
        return ConnectionProblem(problem, f"{typed} --clock {COMPUTER_CLOCK}")
    which = "ahead of" if lead > 0 else "behind"
    problem = f"wrong clock: clocks differ by {abs(lead):.1f} s, the vehicle's is {which} this computer's"
    return ConnectionProblem(problem, f"{typed} --clock {VEHICLE_CLOCK}   or correct the wrong clock:  date -s")
