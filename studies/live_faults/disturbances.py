"""Disturbances that can be drawn for a flight, with their required effects, known before the flight.

A disturbance defines how the flight must end, what both logs must contain, and which of their lines it explains.
Nothing in it is read from a flight.
"""

import random
import signal
from collections.abc import Callable
from typing import NamedTuple

from studies.live_faults import acts, machine
from studies.live_faults.case import (
    AUTOPILOT,
    EITHER,
    FAILSAFE,
    FLIES,
    KILLED,
    STOPS,
    VEHICLE,
    RefusedStart,
)
from studies.live_faults.cases_of_authority import (
    AHEAD,
    CONFIRM,
    SECOND,
    ask_to_disarm,
    send_commands,
    send_sample_ahead,
)
from studies.live_faults.cases_of_authority import start_second as start_another
from studies.live_faults.flight import FaultFlight
from studies.live_faults.words import (
    EvidenceCheck,
    arming_count,
    counter_rise,
    either_of,
    exit_status,
    flag_gap,
    logged_event,
    outputs_safe,
    printed_line,
)
from trimtab.flight.mavlink.keys import create_key
from trimtab.loop.fault_text import SEVERITY

SILENT = logged_event(AUTOPILOT, "no data from the vehicle")
HEARD = logged_event(AUTOPILOT, "from the vehicle again")
TOLD = logged_event(AUTOPILOT, "vehicle: failsafe: no command")
TOLD_REFUSED = logged_event(AUTOPILOT, "vehicle: commands without authority refused")
TOLD_DISARMING = logged_event(AUTOPILOT, "vehicle: Disarming by")
SENT_ONCE = TOLD, TOLD_REFUSED, TOLD_DISARMING
"""Messages that the vehicle sends to the autopilot only once. Another disturbance may lose them in transit."""
BEHIND = r"refused: the clock of 1/191 is \S+ s behind"
"""Message after a restart. A dead vehicle's stored time is ahead of its clock, so that no time stamp is used twice."""
RESTARTED = "no longer armed", "sample rejected", "clock has changed", "of another clock", "too long", BEHIND
NO_COMMAND = r"failsafe: no command", r"no longer armed"
LOST = (
    r"no data from the vehicle",
    r"from the vehicle again",
    r"supervisor: lost: link lost",
    r"supervisor: flying: found again",
)
STALE = r"supervisor: lost: (estimate stale|link lost)", r"supervisor: flying: found again"
"""Patterns of log lines after missing commands (NO_COMMAND), no data (LOST) and old samples (STALE)."""
UNCONFIRMED = (
    "arming refused: confirmation",
    "(confirmation|speed after failsafe) .* REFUSED$",
    "frames lost .* REFUSED$",  # frames lost on the killed autopilot's link, if counted late
)
REFUSED = logged_event(SECOND, CONFIRM)
"""Refusal of an autopilot that starts without a confirmation after another fault has caused a failsafe."""
GARBAGE = "supervisor: (ended|fault): ", "autopilot: fault"
"""Lines that follow from an estimate that is not finite or beyond the envelope."""
FORGED = "unsigned or signed"
"""Message after a bit flip in a signature. The checksum does not cover it, so the frame is complete but badly
signed.
"""
LONG_S = 20.0
"""Duration of a flight in which another process must start first (s)."""


class Disturbance(NamedTuple):
    """Disturbance of a flight.

    act: function that performs it, with its waits.  ends: how the flight must end, as in Case.  lasts: duration (s).
    evidence: required contents of the logs.  explains: patterns of log lines that it explains.
    fly: flight time that it needs (s).
    is_last: True if the flight does not go on as before, so that no disturbance may be drawn after it.
    partial: processes whose log may be incomplete.
    command_delay_s: delay of commands (s) within the vehicle.
    missing_requirement: returns the reason why this machine cannot do it in real time, or an empty text.
    """

    kind: str
    does: str
    act: Callable[[FaultFlight], None]
    ends: str
    lasts: float = 0.0
    evidence: tuple[EvidenceCheck, ...] = ()
    explains: tuple[str, ...] = ()
    statuses: dict[str, tuple[int, ...]] = {}
    stopped_s: dict[str, float] = {}
    prepare: Callable[[FaultFlight], dict[str, dict[str, str]]] = lambda _: {}
    refused_start: RefusedStart | None = None
    fly: float = 4.0
    is_last: bool = False
    actuator_fault_s: float = 0.0
    command_delay_s: float = 0.0
    partial: tuple[str, ...] = ()
    missing_requirement: Callable[[], str] = lambda: ""


def kill_autopilot(_: random.Random) -> Disturbance:
    """Draw a disturbance: the autopilot is killed."""
    return Disturbance(
        "autopilot killed",
        "autopilot killed",
        acts.send_signal("autopilot", signal.SIGKILL),
        STOPS,
        evidence=(FAILSAFE, logged_event(AUTOPILOT, "the flying process is gone"), exit_status(VEHICLE, 1)),
        explains=(*NO_COMMAND, "the flying process is gone"),
        statuses={AUTOPILOT: (KILLED,)},
        is_last=True,
    )


def freeze_autopilot(draw: random.Random) -> Disturbance:
    """Draw a disturbance: the autopilot is stopped and continued."""
    seconds = round(draw.uniform(0.5, 1.5), 2)
    return Disturbance(
        "autopilot frozen",
        f"autopilot frozen for {seconds} s",
        acts.send_signal("autopilot", signal.SIGSTOP, signal.SIGCONT, seconds),
        STOPS,
        seconds,
        (FAILSAFE, logged_event(AUTOPILOT, "^this end stalled for"), TOLD, exit_status(AUTOPILOT, 1)),
        (*NO_COMMAND, *LOST, *STALE, "^this end stalled for", "sample rejected: .* delayed"),
        stopped_s={AUTOPILOT: seconds},
        is_last=True,
    )


def replace_autopilot(draw: random.Random) -> Disturbance:
    """Draw a second autopilot: it asks to arm without confirmation after the first was killed, or it takes over."""
    if draw.random() < 0.5:
        return Disturbance(
            "autopilot replaced",
            "autopilot killed; another one started in failsafe, without a confirmation",
            acts.restart_autopilot,
            STOPS,
            evidence=(
                FAILSAFE,
                logged_event(AUTOPILOT, "the flying process is gone"),
                logged_event(SECOND, CONFIRM),
                arming_count(1),
            ),
            explains=(*NO_COMMAND, "the flying process is gone", *UNCONFIRMED),
            statuses={AUTOPILOT: (KILLED,), SECOND: (1,)},
            fly=LONG_S,
            is_last=True,
        )
    return Disturbance(
        "autopilot replaced",
        "another autopilot takes over",
        start_another("--take-over"),
        FLIES,
        evidence=(
            either_of(logged_event(AUTOPILOT, "ended: the vehicle was taken over by session"), REFUSED),
            either_of(logged_event(VEHICLE, "Control taken over from 1/191 session"), REFUSED),
            exit_status(AUTOPILOT, 1),
        ),
        explains=(
            "taken over",
            "Control taken over",
            "belongs to another autopilot now",
            "without authority",
            *UNCONFIRMED,
        ),
        statuses={AUTOPILOT: (1,)},
        fly=LONG_S,
        is_last=True,
    )


def impersonate(draw: random.Random) -> Disturbance:
    """Draw an attack: with the key, without the key, or with recorded packets."""
    count = draw.randrange(5, 60)
    foreign = logged_event(VEHICLE, "commands without authority refused, from 7/191")
    refused = logged_event(VEHICLE, "refused: .* frames so far were unsigned or signed with another key")
    disarm = (
        logged_event(VEHICLE, "Disarming by 7/191 session .* refused"),
        TOLD_DISARMING,
    )
    ways: list[tuple[str, acts.Act, tuple[EvidenceCheck, ...], tuple[str, ...]]] = [
        (f"{count} commands of another system", send_commands(count), (foreign, TOLD_REFUSED), ("without authority",)),
        (
            "another system's command, 0.49 s ahead",
            send_commands(1, AHEAD),
            (foreign, TOLD_REFUSED),
            ("without authority",),
        ),
        ("another system asks to disarm", ask_to_disarm, disarm, (r"Disarming by 7/191 session .* refused",)),
        (
            "a stranger without a key asks to disarm",
            acts.disarm_without_key(False),
            (refused,),
            ("unsigned or signed",),
        ),
        (
            "a stranger with another key asks to disarm",
            acts.disarm_without_key(True),
            (refused,),
            ("unsigned or signed",),
        ),
        ("all frames sent before are replayed", acts.replay_packets, (counter_rise(VEHICLE, "wire.refused", 5),), ()),
    ]
    does, act, evidence, explains = draw.choice(ways)
    return Disturbance("autopilot impersonated", does, act, FLIES, 1.0, evidence, explains)


def shift_clock(draw: random.Random) -> Disturbance:
    """Draw a clock fault: an autopilot's wall clock steps in flight, is wrong from the start, or a stamp is wrong."""
    seconds = draw.choice((-3600, -120, 120, 3600, 86400))
    way = draw.randrange(3)
    if way == 0:
        return Disturbance(
            "autopilot mis-clocked",
            f"autopilot's wall clock steps by {seconds} s in flight",
            acts.step_clocks,
            FLIES,
            evidence=(logged_event(VEHICLE, "disarmed: disarm request"),),
            prepare=acts.prepare_clock("autopilot", seconds),
        )
    if way == 1:
        return Disturbance(
            "autopilot mis-clocked",
            "a sample stamped an hour ahead",
            send_sample_ahead,
            FLIES,
            evidence=(
                counter_rise(AUTOPILOT, "link.implausible"),
                logged_event(AUTOPILOT, r"sample rejected: its time is \+3\d\d\d\."),
            ),
            explains=("sample rejected",),
        )
    which = "ahead of" if seconds > 0 else "behind"
    return Disturbance(
        "autopilot mis-clocked",
        f"autopilot's clock wrong by {seconds} s from the start; then flown as the refusal suggests",
        acts.do_nothing,
        FLIES,
        evidence=(logged_event(VEHICLE, rf"refused: the clock of 1/191 is {abs(seconds)}\.?\d* s {which}"),),
        explains=("refused: the clock of 1/191", "packets are signed by the vehicle.s clock"),
        refused_start=RefusedStart(
            rf"wrong clock: clocks differ by {abs(seconds)}\.\d s",
            environment=wrong_clock(seconds),
        ),
    )


def misconfigure(draw: random.Random) -> Disturbance:
    """Draw an autopilot with another scenario, parameter or key: it is refused, then flies as the refusal suggests."""
    mass = round(draw.uniform(1.5, 4.0), 2)
    ways = [
        ("another scenario", RefusedStart("wrong scenario: ", scenario="hovercraft/spin"), ()),
        ("another mass", RefusedStart(r"world\.vehicle\.mass: ", ("--set", f"world.vehicle.mass={mass}")), ()),
        (
            "another period of the sensor",
            RefusedStart(r"wrong scenario: ", ("--set", "world.sensors.navigation.period=20 ms")),
            (),
        ),
        (
            "another key",
            RefusedStart("wrong key: ", environment=other_key),
            (logged_event(VEHICLE, "refused: .* frames so far were unsigned or signed with another key"),),
        ),
    ]
    does, start, evidence = draw.choice(ways)
    return Disturbance(
        "autopilot mis-configured",
        f"{does}; then flown as the refusal suggests",
        acts.do_nothing,
        FLIES,
        evidence=(*evidence, logged_event(VEHICLE, "disarmed: disarm request")),
        explains=("unsigned or signed", "accepted"),
        refused_start=start,
    )


def kill_vehicle(_: random.Random) -> Disturbance:
    """Draw a disturbance: the vehicle is killed."""
    return Disturbance(
        "vehicle killed",
        "vehicle killed",
        acts.send_signal("vehicle", signal.SIGKILL),
        EITHER,
        evidence=(
            logged_event(VEHICLE, "the flying process is gone"),
            SILENT,
            outputs_safe("is gone"),
            exit_status(AUTOPILOT, 1),
        ),
        explains=("the flying process is gone", *LOST, *STALE),
        statuses={VEHICLE: (KILLED,)},
        is_last=True,
    )


def freeze_vehicle(draw: random.Random) -> Disturbance:
    """Draw a disturbance: the vehicle is stopped and continued. Its outputs are safe meanwhile, and latched."""
    seconds = round(draw.uniform(0.5, 2.0), 2)
    return Disturbance(
        "vehicle frozen",
        f"vehicle frozen for {seconds} s",
        acts.send_signal("vehicle", signal.SIGSTOP, signal.SIGCONT, seconds),
        EITHER,
        seconds,
        (
            SILENT,
            outputs_safe("is stopped"),
            logged_event(VEHICLE, "outputs went safe: no data for"),
            exit_status(AUTOPILOT, 1),
            exit_status(VEHICLE, 1),
        ),
        (*LOST, *STALE, *NO_COMMAND, "outputs went safe", "sample rejected: .* delayed"),
        stopped_s={VEHICLE: seconds},
        fly=4.5,
        is_last=True,
    )


def kill_outputs(_: random.Random) -> Disturbance:
    """Draw a disturbance: the process that applies the vehicle's outputs is killed."""
    return Disturbance(
        "outputs killed",
        "the process of the vehicle's outputs killed",
        acts.kill_child("vehicle", "trimtab.flight.outputs"),
        EITHER,
        evidence=(
            logged_event(VEHICLE, "the outputs' process died"),
            logged_event(VEHICLE, "ended: the outputs' process died"),
            exit_status(VEHICLE, 1),
            exit_status(AUTOPILOT, 1),
        ),
        explains=("the outputs' process died", *LOST, *STALE, *NO_COMMAND),
        is_last=True,
        partial=(VEHICLE,),
    )


def restart_vehicle(_: random.Random) -> Disturbance:
    """Draw a disturbance: the vehicle is killed and started again, and nothing arms it."""
    return Disturbance(
        "vehicle restarted",
        "vehicle killed and started again; nobody arms it",
        acts.restart_vehicle,
        EITHER,
        evidence=(
            logged_event(VEHICLE, "the flying process is gone"),
            SILENT,
            HEARD,
            outputs_safe("is gone"),
            exit_status(AUTOPILOT, 1),
        ),
        explains=("the flying process is gone", *LOST, *STALE, *RESTARTED),
        statuses={VEHICLE: (KILLED,)},
        fly=120.0,
        is_last=True,
    )


def break_sensor(draw: random.Random) -> Disturbance:
    """Draw a fault of the navigation system, or of the link from it to the autopilot."""
    part = draw.choice(("sensor:navigation", "downlink"))
    word = draw.choice(("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"))
    seconds = round(draw.uniform(1.0, 1.4), 2)
    place = part.replace("sensor:", "sensors.")
    not_a_number = (part, word) == ("sensor:navigation", "garbage")
    gap = {"off": 0.8 * seconds, "slow": 0.02, "delayed": 0.15, "intermittent": 0.08}.get(word)
    silent = word == "off" or (part == "downlink" and word in ("stuck", "garbage"))
    evidence: list[EvidenceCheck] = [logged_event(VEHICLE, rf"world\.{place}\.fault\.kind = {word}")]
    if gap is not None:
        evidence.append(flag_gap(AUTOPILOT, "downlink.navigation.fresh", gap))
    evidence += [FAILSAFE, logged_event(AUTOPILOT, GARBAGE[0])] if not_a_number else []
    explains = (r"fault\.", *(STALE if silent or not_a_number or word in ("slow", "delayed", "intermittent") else ()))
    explains += LOST if silent else ()  # a vehicle without samples sends data once a second
    explains += (*GARBAGE, *NO_COMMAND) if not_a_number else ()
    ends = STOPS if not_a_number else FLIES
    does = f"{part} {word} for {seconds} s"
    return Disturbance("sensor or downlink", does, acts.inject_fault(does), ends, seconds, tuple(evidence), explains)


def break_uplink(draw: random.Random) -> Disturbance:
    """Draw a fault between link and failsafe."""
    word = draw.choice(("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"))
    seconds = round(draw.uniform(0.5, 1.4), 2)
    stops = word in ("off", "stuck", "garbage")
    evidence = (logged_event(VEHICLE, rf"world\.uplink\.fault\.kind = {word}"), *((FAILSAFE, TOLD) if stops else ()))
    does = f"uplink {word} for {seconds} s"
    ends, explains = STOPS if stops else EITHER, (r"fault\.", *NO_COMMAND)
    delay = SEVERITY[word] if word == "delayed" else 0.0
    return Disturbance(
        "uplink", does, acts.inject_fault(does), ends, seconds, evidence, explains, command_delay_s=delay
    )


def break_actuators(draw: random.Random) -> Disturbance:
    """Draw a fault of the actuators. They then ignore all commands."""
    word = draw.choice(("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"))
    seconds = round(draw.uniform(0.3, 1.2), 2)
    does = f"actuators {word} for {seconds} s"
    evidence = (logged_event(VEHICLE, rf"world\.actuators\.fault\.kind = {word}"),)
    return Disturbance(
        "actuators", does, acts.inject_fault(does), FLIES, seconds, evidence, (r"fault\.",), actuator_fault_s=seconds
    )


def break_line(draw: random.Random) -> Disturbance:
    """Draw a fault of the link: cut, lossy, shuffled or with flipped bits."""
    way = draw.choice(("cut", "blink", "lossy", "flipped", "doubled"))
    if way == "cut":
        seconds = round(draw.uniform(0.45, 1.3), 2)
        evidence = FAILSAFE, SILENT, HEARD
        explains = (*NO_COMMAND, *LOST, *STALE)
        return Disturbance(
            "line", f"link cut for {seconds} s", acts.cut_line(seconds), STOPS, seconds, evidence, explains
        )
    if way == "blink":
        seconds = round(draw.uniform(0.05, 0.15), 2)
        evidence = (counter_rise(AUTOPILOT, "link.lost"),)
        return Disturbance("line", f"link cut for {seconds} s", acts.cut_line(seconds), FLIES, seconds, evidence)
    direction = draw.choice((acts.UP, acts.DOWN))
    where, who, what = (("commands", VEHICLE, "wire"), ("samples", AUTOPILOT, "link"))[direction]
    make, counter, does = {
        "lossy": (acts.drop_half, "lost", f"every second one of the {where} lost"),
        "flipped": (acts.flip_bits, "damaged", f"one bit inverted in 3 of 4 {where}"),
        "doubled": (acts.repeat_packets, "refused", f"{where} received three times"),
    }[way]
    up = direction == acts.UP
    ends = EITHER if up and way == "flipped" else FLIES
    return Disturbance(
        "line",
        f"{does}, for 1 s",
        acts.bend_packets(direction, make, 1.0),
        ends,
        1.0,
        (counter_rise(who, f"{what}.{counter}"),),
        (*(NO_COMMAND if ends == EITHER else ()), *((FORGED, *LOST) if way == "flipped" else ())),
    )


def spoil_network(draw: random.Random) -> Disturbance:
    """Draw a bad network both ways: packets are lost, doubled, late, and overtake each other."""
    loss, late = round(draw.uniform(0.05, 0.3), 2), round(draw.uniform(0.01, 0.1), 3)
    seconds = round(draw.uniform(0.5, 1.4), 2)
    return Disturbance(
        "bad network",
        f"{loss:.0%} of the packets lost, others up to {late * 1e3:.0f} ms late, {seconds} s",
        acts.bend_both_ways(acts.spoil_packets(loss, late), seconds),
        FLIES,
        seconds,
        (either_of(counter_rise(VEHICLE, "wire.lost"), counter_rise(AUTOPILOT, "link.lost")),),
        STALE,
    )


def fill_disk(draw: random.Random) -> Disturbance:
    """Draw a disturbance: the disk of one of the logs is full for a while."""
    who = draw.choice((VEHICLE, AUTOPILOT))
    seconds = round(draw.uniform(0.3, 1.0), 2)
    return Disturbance(
        "disk full",
        f"disk full below the log of {who} for {seconds} s",
        acts.fill_disk(who, seconds),
        FLIES,
        seconds,
        (printed_line(who, "can't be written"), logged_event(who, "the log has a gap"), exit_status(who, 1)),
        ("the log has a gap", "the log lacks"),
        prepare=acts.prepare_disk(who),
        partial=(who,),
        missing_requirement=machine.explain_no_mount,
    )


LAST = (
    kill_autopilot,
    freeze_autopilot,
    replace_autopilot,
    kill_vehicle,
    freeze_vehicle,
    restart_vehicle,
    kill_outputs,
)
STARTS = (shift_clock, misconfigure)
PASSING = (
    impersonate,
    break_sensor,
    break_uplink,
    break_actuators,
    break_line,
    spoil_network,
    fill_disk,
)


def wrong_clock(seconds: int) -> Callable[[FaultFlight], dict[str, str]]:
    """Return the environment of an autopilot with a wrong time of day."""

    def environment(flight: FaultFlight) -> dict[str, str]:
        flight.step_clocks()
        return flight.prepare_clock(seconds)

    return environment


def other_key(flight: FaultFlight) -> dict[str, str]:
    """Return the environment of an autopilot with another key under the same vehicle's name."""
    create_key(flight.folder / "other" / "keys" / "hovercraft.key")
    return {"TRIMTAB_CONFIG": str(flight.folder / "other")}
