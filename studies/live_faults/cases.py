"""Cases of the campaign, each with its disturbance and the expected result."""

from studies.live_faults import acts
from studies.live_faults.case import AUTOPILOT, EITHER, FAILSAFE, FLIES, STOPS, VEHICLE, Case
from studies.live_faults.cases_of_authority import AUTHORITY
from studies.live_faults.cases_of_ends import CLOCKS, DISKS, PROCESSES, SIGNALS, WRITERS
from studies.live_faults.cases_of_lines import FRAMES, ONE_WAY, ORDER, POURED
from studies.live_faults.cases_of_requests import REQUESTS
from studies.live_faults.stalls import STALL_CASES
from studies.live_faults.words import EvidenceCheck, counter_rise, flag_gap, logged_event

WORDS = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
PARTS = ("sensor:navigation", "downlink", "uplink", "actuators")
SILENT = {"off", "stuck", "garbage"}
"""Kinds of faults of an uplink that let no new command through."""
NOT_A_NUMBER = ("sensor:navigation", "garbage")
"""Fault that yields NaN. The supervisor then ends the flight, as a vehicle's only sensor cannot be trusted again."""
CUTS = (0.1, 0.3, 1.0, 5.0)
LOST_S = 9.0
"""Flight time (s): 1 until the link is lost, 5.2 until the supervisor ends the flight, 1.25 until the lift is off."""


def fault_cases() -> list[Case]:
    """Return a case for each kind of fault in each part of the vehicle. The fault lasts a second."""
    return [_fault_case(part, word) for part in PARTS for word in WORDS]


def _fault_case(part: str, word: str) -> Case:
    place = part.replace("sensor:", "sensors.")
    uplink = part == "uplink"
    silent = word in SILENT if uplink else (part, word) == NOT_A_NUMBER
    ends = STOPS if silent else EITHER if uplink else FLIES
    says: tuple[EvidenceCheck, ...] = (logged_event(VEHICLE, rf"world\.{place}\.fault\.kind = {word}"),)
    return Case(
        f"{part.rpartition(':')[2]}-{word}",
        f"fault `{part} {word} for 1 s` injected",
        acts.inject_fault(f"{part} {word} for 1 s"),
        ends,
        (*says, FAILSAFE) if ends == STOPS else says,
        actuator_fault_s=1.0 if part == "actuators" else 0.0,
    )


def loss_cases() -> list[Case]:
    """Return cases with a part between sensor and actuators lost for good. The remaining parts must end the flight."""
    ended = logged_event(AUTOPILOT, "supervisor: ended: lost for too long")
    return [_loss_case("sensor:navigation", ended), _loss_case("downlink", ended), _loss_case("uplink")]


def _loss_case(part: str, *more: EvidenceCheck) -> Case:
    place = part.replace("sensor:", "sensors.")
    return Case(
        f"{part.rpartition(':')[2]}-lost",
        f"fault `{part} off` injected, permanent",
        acts.inject_fault(f"{part} off"),
        STOPS,
        (logged_event(VEHICLE, rf"world\.{place}\.fault\.kind = off"), *more, FAILSAFE),
        fly=LOST_S,
    )


def cut_cases() -> list[Case]:
    """Return cases with the link cut both ways."""
    return [_cut_case(seconds, serial) for serial in (False, True) for seconds in CUTS]


def _cut_case(seconds: float, serial: bool) -> Case:
    stops = seconds >= 0.25
    lost = (flag_gap(VEHICLE, "firmware.command.fresh", seconds * 0.9), counter_rise(AUTOPILOT, "link.lost"))
    again = (
        FAILSAFE,
        logged_event(AUTOPILOT, "no data from the vehicle"),
        logged_event(AUTOPILOT, "from the vehicle again"),
    )
    return Case(
        f"cut-{seconds:g}{'-serial' if serial else ''}",
        f"{'serial line' if serial else 'link'} cut for {seconds:g} s",
        acts.cut_line(seconds),
        STOPS if stops else FLIES,
        again if stops else lost,
        serial=serial,
        fly=max(4.0, seconds + 3.0),
    )


def all_cases() -> list[Case]:
    """Return all cases, in the order of the table."""
    ends, lines = [*PROCESSES, *CLOCKS, *DISKS, *WRITERS, *STALL_CASES], [*FRAMES, *POURED]
    others = [*AUTHORITY, *REQUESTS, *SIGNALS, *ORDER, *ONE_WAY]
    return [*fault_cases(), *loss_cases(), *cut_cases(), *ends, *lines, *others]
