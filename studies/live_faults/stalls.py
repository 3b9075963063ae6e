"""Frozen, starved and hanging parts that can be drawn for a flight, one at a time and in pairs.

In a pair, one stall may prevent the other's usual ending. The outputs must be safe in time all the same
(`driver.OutputsCheck`), and one log must show the first cause.
"""

import math
import random
from typing import Protocol, runtime_checkable

from studies.live_faults import acts
from studies.live_faults.case import AUTOPILOT, EITHER, ENDED, FAILSAFE, FLIES, KILLED, STOPS, VEHICLE, Case
from studies.live_faults.disturbances import (
    LOST,
    NO_COMMAND,
    SILENT,
    STALE,
    TOLD,
    Disturbance,
    fill_disk,
    freeze_autopilot,
    freeze_vehicle,
    kill_autopilot,
    kill_outputs,
    kill_vehicle,
)
from studies.live_faults.flight import FaultFlight
from studies.live_faults.virtual_process import OUTPUTS
from studies.live_faults.words import (
    EvidenceCheck,
    counter_rise,
    either_of,
    exit_status,
    logged_event,
    outputs_safe,
    printed_line,
)

OUTPUTS_WORD = "trimtab.flight.outputs"
FROZEN = "the outputs' process is frozen"
STALLED = logged_event(AUTOPILOT, "^this end stalled for")
DISARMED = logged_event(VEHICLE, "disarmed: disarm request")
SHOWN_S = 0.4
"""Time (s) after which a log shows the first stall, whatever stalls next."""


@runtime_checkable
class VirtualStalls(Protocol):
    """Stalls that a flight in virtual time can cause in addition to signals."""

    def starve_process(self, who: str, seconds: float) -> None:
        """Give a process no processor time for a while."""
        ...

    def hang_disk(self, name: str, hangs: bool) -> None:
        """Make writes to the disk of a log hang, or continue."""
        ...

    def hang_terminal(self, name: str, hangs: bool) -> None:
        """Make the terminal of a process hang, or continue."""
        ...


def starve_process(who: str, seconds: float) -> acts.Act:
    """Return an act that gives a process no processor time for a while. who: VEHICLE, AUTOPILOT or OUTPUTS."""

    def act(flight: FaultFlight) -> None:
        assert isinstance(flight, VirtualStalls)
        flight.let_fly(flight.undisturbed_s)
        flight.starve_process(who, seconds)

    return act


def hang_disk_for(name: str, seconds: float) -> acts.Act:
    """Return an act that makes the disk of a log hang for a while."""

    def act(flight: FaultFlight) -> None:
        assert isinstance(flight, VirtualStalls)
        flight.let_fly(flight.undisturbed_s)
        flight.hang_disk(name, True)
        flight.let_fly(seconds)
        flight.hang_disk(name, False)

    return act


def hang_terminal_for(name: str, seconds: float) -> acts.Act:
    """Return an act that makes the terminal of a process hang for a while."""

    def act(flight: FaultFlight) -> None:
        assert isinstance(flight, VirtualStalls)
        flight.let_fly(flight.undisturbed_s)
        flight.hang_terminal(name, True)
        flight.let_fly(seconds)
        flight.hang_terminal(name, False)

    return act


def explain_virtual_only() -> str:
    """Return why a stall cannot be made with real processes."""
    return "only virtual time can starve a process or let a disk hang: needs a flight without --real-time"


def starve_autopilot(draw: random.Random) -> Disturbance:
    """Draw a stall: the autopilot gets no processor time."""
    seconds = round(draw.uniform(0.5, 1.5), 2)
    return Disturbance(
        "autopilot starved",
        f"autopilot starved for {seconds} s",
        starve_process(AUTOPILOT, seconds),
        STOPS,
        seconds,
        (FAILSAFE, STALLED, TOLD, exit_status(AUTOPILOT, 1)),
        (*NO_COMMAND, *LOST, *STALE, "^this end stalled for", "sample rejected: .* delayed"),
        stopped_s={AUTOPILOT: seconds},
        is_last=True,
        missing_requirement=explain_virtual_only,
    )


def starve_vehicle(draw: random.Random) -> Disturbance:
    """Draw a stall: the vehicle gets no processor time. Its outputs are safe meanwhile, and latched."""
    seconds = round(draw.uniform(0.5, 1.5), 2)
    return Disturbance(
        "vehicle starved",
        f"vehicle starved for {seconds} s",
        starve_process(VEHICLE, seconds),
        EITHER,
        seconds,
        (
            SILENT,
            outputs_safe("hangs or is starved"),
            logged_event(VEHICLE, "outputs went safe: no data for"),
            exit_status(AUTOPILOT, 1),
            exit_status(VEHICLE, 1),
        ),
        (*LOST, *STALE, *NO_COMMAND, "outputs went safe", "sample rejected: .* delayed"),
        stopped_s={VEHICLE: seconds},
        fly=4.5,
        is_last=True,
        missing_requirement=explain_virtual_only,
    )


def freeze_outputs(draw: random.Random) -> Disturbance:
    """Draw a stall: the process of the outputs is stopped and continued."""
    seconds = round(draw.uniform(0.3, 1.5), 2)
    return _stalled_outputs(
        "outputs frozen",
        f"the process of the vehicle's outputs frozen for {seconds} s",
        acts.freeze_child("vehicle", OUTPUTS_WORD, seconds),
        seconds,
    )


def starve_outputs(draw: random.Random) -> Disturbance:
    """Draw a stall: the process of the outputs gets no processor time."""
    seconds = round(draw.uniform(0.3, 1.5), 2)
    return _stalled_outputs(
        "outputs starved",
        f"the process of the vehicle's outputs starved for {seconds} s",
        starve_process(OUTPUTS, seconds),
        seconds,
    )._replace(missing_requirement=explain_virtual_only)


def _stalled_outputs(kind: str, does: str, act: acts.Act, seconds: float) -> Disturbance:
    return Disturbance(
        kind,
        does,
        act,
        EITHER,
        seconds,
        (
            logged_event(VEHICLE, FROZEN),
            logged_event(VEHICLE, f"ended: {FROZEN}"),
            exit_status(VEHICLE, 1),
            exit_status(AUTOPILOT, 1),
        ),
        (FROZEN, *LOST, *STALE, *NO_COMMAND),
        is_last=True,
        partial=(VEHICLE,),
    )


def hang_disk(draw: random.Random) -> Disturbance:
    """Draw a stall: the disk of one of the logs hangs, for a while or until the log is abandoned."""
    who = draw.choice((VEHICLE, AUTOPILOT))
    if draw.random() < 0.5:
        seconds = round(draw.uniform(0.5, 3.0), 2)
        return Disturbance(
            "disk hangs",
            f"disk below the log of {who} hangs for {seconds} s",
            hang_disk_for(who, seconds),
            FLIES,
            seconds,
            (DISARMED,),
            missing_requirement=explain_virtual_only,
        )
    return Disturbance(
        "disk hangs",
        f"disk below the log of {who} hangs for good",
        hang_disk_for(who, 60.0),
        FLIES,
        60.0,
        (printed_line(who, "wrote nothing for 5 s"), exit_status(who, 1)),
        ("the flying process is gone",),
        partial=(who,),
        missing_requirement=explain_virtual_only,
    )


def hang_terminal(draw: random.Random) -> Disturbance:
    """Draw a stall: a terminal accepts no lines for a while."""
    who, seconds = draw.choice((VEHICLE, AUTOPILOT)), round(draw.uniform(0.5, 6.0), 2)
    return Disturbance(
        "terminal hangs",
        f"terminal of {who} hangs for {seconds} s",
        hang_terminal_for(who, seconds),
        FLIES,
        seconds,
        (DISARMED,),
        ("lines for the user were lost",),  # if the terminal hangs to the end
        missing_requirement=explain_virtual_only,
    )


def cut_line(draw: random.Random) -> Disturbance:
    """Draw a disturbance: the link is cut."""
    seconds = round(draw.uniform(0.45, 1.3), 2)
    does = f"link cut for {seconds} s"
    return Disturbance(
        "link cut", does, acts.cut_line(seconds), STOPS, seconds, (FAILSAFE,), (*NO_COMMAND, *LOST, *STALE)
    )


CAUSES: dict[str, tuple[EvidenceCheck, ...]] = {
    "autopilot killed": (logged_event(AUTOPILOT, "the flying process is gone"),),
    "autopilot frozen": (FAILSAFE, STALLED),
    "autopilot starved": (FAILSAFE, STALLED),
    "vehicle killed": (outputs_safe("is gone", math.inf),),
    "vehicle frozen": (outputs_safe("is stopped", math.inf),),
    "vehicle starved": (outputs_safe("hangs or is starved", math.inf),),
    "outputs killed": (logged_event(VEHICLE, "the outputs' process died"),),
    "outputs frozen": (logged_event(VEHICLE, FROZEN),),
    "outputs starved": (logged_event(VEHICLE, FROZEN),),
    "link cut": (FAILSAFE, SILENT, counter_rise(AUTOPILOT, "link.lost")),
    "disk full": (printed_line(VEHICLE, "can't be written"), printed_line(AUTOPILOT, "can't be written")),
}
"""Kind of the first stall -> evidence, at least one of which appears in a log or on a terminal in any pair.

The second stall may delay the outputs' report. The driver shows when the outputs were safe.
"""
UNSEEN = "disk hangs", "terminal hangs"
"""Kinds of stalls that leave no trace if the flight goes on normally."""
SINGLE = starve_autopilot, starve_vehicle, freeze_outputs, starve_outputs, hang_disk, hang_terminal
STALLS = (
    *SINGLE,
    kill_autopilot,
    freeze_autopilot,
    kill_vehicle,
    freeze_vehicle,
    kill_outputs,
    fill_disk,
    cut_line,
)


def _kill_both_on_a_disk_that_hangs(flight: FaultFlight) -> None:
    assert isinstance(flight, VirtualStalls)
    flight.let_fly(flight.undisturbed_s)
    flight.hang_disk(VEHICLE, True)
    flight.let_fly(0.3)
    flight.autopilot.kill()
    flight.vehicle.kill()
    flight.let_fly(1.0)
    flight.hang_disk(VEHICLE, False)


STALL_CASES: list[Case] = [
    Case(
        "disk-hangs-both-killed",
        "disk below the vehicle's log hangs; then the vehicle and the autopilot are killed",
        _kill_both_on_a_disk_that_hangs,
        EITHER,
        (outputs_safe("is gone"),),
        statuses={VEHICLE: (KILLED,), AUTOPILOT: (KILLED,)},
        partial=(VEHICLE,),
        missing_requirement=explain_virtual_only,
    ),
    *(
        Case(
            f"{name.partition('-')[0]}-terminal-hangs",
            f"terminal of the {name.partition('-')[0]} accepts no output for 2 s",
            hang_terminal_for(name, 2.0),
            FLIES,
            (DISARMED, exit_status(VEHICLE, 0), exit_status(AUTOPILOT, 0)),
            missing_requirement=explain_virtual_only,
        )
        for name in (VEHICLE, AUTOPILOT)
    ),
    Case(
        "outputs-frozen",
        "the process that applies the vehicle's outputs is stopped for 1 s (SIGSTOP, SIGCONT)",
        acts.freeze_child("vehicle", OUTPUTS_WORD, 1.0),
        EITHER,
        (logged_event(VEHICLE, FROZEN), exit_status(VEHICLE, 1)),
        partial=(VEHICLE,),
    ),
]
"""Cases of hanging disks and terminals, and of frozen outputs, one at a time."""


def combine_stalls(case: Case, pair: tuple[Disturbance, Disturbance], gap_s: float) -> Case:
    """Return the case of two stalls, with the requirements that hold however the stalls interact.

    Args:
        case: case with name, description and act.
        pair: the stalls, in the order of their starts.
        gap_s: time between the starts (s).
    """
    shown = pair[:1] if gap_s >= SHOWN_S else pair
    causes = [check for stall in shown for check in CAUSES.get(stall.kind, ())]
    evidence = () if any(stall.kind in UNSEEN for stall in shown) else (either_of(*causes),)
    ends = {stall.ends for stall in pair}
    return case._replace(
        expected_ending=FLIES if ends == {FLIES} else EITHER,
        evidence_checks=evidence,
        statuses={who: (*ENDED, *statuses) for stall in pair for who, statuses in stall.statuses.items()},
        command_delay_s=max(stall.command_delay_s for stall in pair),
        stopped_s={who: sum(s.stopped_s.get(who, 0.0) for s in pair) for stall in pair for who in stall.stopped_s},
        fly=max(stall.fly for stall in pair),
        partial=tuple(who for stall in pair for who in stall.partial),
        missing_requirement=lambda: next((why for s in pair if (why := s.missing_requirement())), ""),
        explains=tuple(pattern for stall in pair for pattern in stall.explains),
    )
