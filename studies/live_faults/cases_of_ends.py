"""Cases of the campaign: processes that die, stop or get signals, clocks, disks, and writers of logs."""

import signal

from studies.live_faults import acts, machine
from studies.live_faults.case import AUTOPILOT, EITHER, FAILSAFE, FLIES, KILLED, STOPS, VEHICLE, Case
from studies.live_faults.cases_of_authority import CONFIRM, SECOND
from studies.live_faults.words import (
    arming_count,
    counter_rise,
    exit_status,
    flag_gap,
    logged_event,
    outputs_safe,
    peak_level,
    printed_line,
)

DISARMED = logged_event(VEHICLE, "disarmed: disarm request")
DEAD = logged_event(AUTOPILOT, "the flying process is gone")
SILENT = logged_event(AUTOPILOT, "no data from the vehicle")
PROCESSES: list[Case] = [
    Case("none", "no fault", acts.do_nothing, FLIES, (logged_event(VEHICLE, "disarmed: disarm request"),)),
    Case(
        "vehicle-killed",
        "vehicle's process killed",
        acts.send_signal("vehicle", signal.SIGKILL),
        evidence_checks=(
            logged_event(VEHICLE, "the flying process is gone"),
            SILENT,
            outputs_safe("is gone"),
            exit_status(AUTOPILOT, 1),
        ),
        statuses={VEHICLE: (KILLED,)},
    ),
    Case(
        "vehicle-restarted",
        "vehicle's process killed and restarted; no arming request follows",
        acts.restart_vehicle,
        evidence_checks=(
            logged_event(VEHICLE, "the flying process is gone"),
            SILENT,
            logged_event(AUTOPILOT, "from the vehicle again"),
        ),
        statuses={VEHICLE: (KILLED,)},
        fly=120.0,
    ),
    Case(
        "autopilot-killed",
        "autopilot's process killed",
        acts.send_signal("autopilot", signal.SIGKILL),
        STOPS,
        (FAILSAFE, DEAD),
        statuses={AUTOPILOT: (KILLED,)},
    ),
    Case(
        "autopilot-restarted",
        "autopilot's process killed; a second autopilot is started and asks the vehicle in failsafe to arm",
        acts.restart_autopilot,
        STOPS,
        (FAILSAFE, DEAD, logged_event(SECOND, CONFIRM), arming_count(1)),
        statuses={AUTOPILOT: (KILLED,), SECOND: (1,)},
        fly=20.0,
    ),
    Case(
        "autopilot-interrupted",
        "Ctrl-C on the autopilot",
        acts.send_signal("autopilot", signal.SIGINT),
        FLIES,
        (logged_event(VEHICLE, "disarmed: disarm request"),),
    ),
    Case(
        "vehicle-interrupted",
        "Ctrl-C on the vehicle",
        acts.send_signal("vehicle", signal.SIGINT),
        evidence_checks=(logged_event(VEHICLE, "ended by request"), SILENT),
    ),
    Case(
        "autopilot-frozen",
        "autopilot's process stopped for 1 s (SIGSTOP, SIGCONT)",
        acts.send_signal("autopilot", signal.SIGSTOP, signal.SIGCONT),
        STOPS,
        (FAILSAFE, counter_rise(AUTOPILOT, "loop.skipped", 400)),
        stopped_s={AUTOPILOT: 1.0},
    ),
    Case(
        "vehicle-frozen",
        "vehicle's process stopped for 1 s (SIGSTOP, SIGCONT)",
        acts.send_signal("vehicle", signal.SIGSTOP, signal.SIGCONT),
        EITHER,
        (peak_level(VEHICLE, "firmware.late", 0.9), SILENT, outputs_safe("is stopped")),
        stopped_s={VEHICLE: 1.0},
    ),
]
"""Cases of a vehicle or an autopilot that dies, stops, or is asked to end."""
CLOCKS: list[Case] = [
    Case(
        f"{who}-clock-{'on' if seconds > 0 else 'back'}",
        f"{who}'s wall clock stepped {'forward' if seconds > 0 else 'back'} by an hour",
        acts.step_clocks,
        FLIES,
        (logged_event(VEHICLE, "disarmed: disarm request"),),
        prepare=acts.prepare_clock(who, seconds),
        missing_requirement=machine.explain_no_compiler,
    )
    for who in ("vehicle", "autopilot")
    for seconds in (3600, -3600)
]
"""Cases of wall clocks that jump."""
DISKS: list[Case] = [
    Case(
        f"{name.partition('-')[0]}-disk-full{'-again' if after else ''}",
        f"disk of the {name.partition('-')[0]}'s log full" + (f"; space is freed after {after:g} s" if after else ""),
        acts.fill_disk(name, after),
        FLIES,
        (printed_line(name, "can't be written"), *([logged_event(name, "the log has a gap")] if after else [])),
        prepare=acts.prepare_disk(name),
        missing_requirement=machine.explain_no_mount,
        partial=(name,),
        statuses={} if name == VEHICLE else {AUTOPILOT: (1,)},
    )
    for name in (VEHICLE, AUTOPILOT)
    for after in (None, 1.0)
]
"""Cases of full disks."""
WRITERS: list[Case] = [
    Case(
        f"{name.partition('-')[0]}-writer-killed",
        f"the process that writes the {name.partition('-')[0]}'s log is killed",
        acts.kill_writer(name.partition("-")[0]),
        FLIES,
        (printed_line(name, "log's writer died"),),
        partial=(name,),
        statuses={} if name == VEHICLE else {AUTOPILOT: (1,)},
    )
    for name in (VEHICLE, AUTOPILOT)
]
"""Cases of logs whose writer process has died."""


def _signal_cases() -> list[Case]:
    """Return cases of processes that are asked to end, or crash."""
    crash, gone = -signal.SIGSEGV, "the flying process is gone"
    return [
        Case(
            "autopilot-terminated",
            "SIGTERM sent to the autopilot",
            acts.send_signal("autopilot", signal.SIGTERM),
            EITHER,
            (exit_status(AUTOPILOT, 1), DISARMED),
        ),
        Case(
            "vehicle-terminated",
            "SIGTERM sent to the vehicle",
            acts.send_signal("vehicle", signal.SIGTERM),
            EITHER,
            (logged_event(VEHICLE, "ended by request"), exit_status(AUTOPILOT, 1)),
        ),
        Case(
            "autopilot-crashed",
            "autopilot's process crashes (SIGSEGV)",
            acts.send_signal("autopilot", signal.SIGSEGV),
            STOPS,
            (FAILSAFE, logged_event(AUTOPILOT, gone), exit_status(VEHICLE, 1)),
            statuses={AUTOPILOT: (crash,)},
        ),
        Case(
            "vehicle-crashed",
            "vehicle's process crashes (SIGSEGV)",
            acts.send_signal("vehicle", signal.SIGSEGV),
            EITHER,
            (logged_event(VEHICLE, gone), outputs_safe("is gone"), exit_status(AUTOPILOT, 1)),
            statuses={VEHICLE: (crash, KILLED)},
        ),
        Case(
            "vehicle-frozen-2",
            "vehicle's process stopped for 2 s",
            acts.send_signal("vehicle", signal.SIGSTOP, signal.SIGCONT, 2.0),
            EITHER,
            (
                logged_event(AUTOPILOT, "no data from the vehicle"),
                outputs_safe("is stopped"),
                logged_event(VEHICLE, "outputs went safe: no data for"),
            ),
            stopped_s={VEHICLE: 2.0},
        ),
        Case(
            "outputs-killed",
            "the process that applies the vehicle's outputs is killed",
            acts.kill_child("vehicle", "trimtab.flight.outputs"),
            EITHER,
            (logged_event(VEHICLE, "the outputs' process died"), exit_status(VEHICLE, 1), exit_status(AUTOPILOT, 1)),
        ),
        Case(
            "autopilot-frozen-0.15",
            "autopilot's process stopped for 0.15 s",
            acts.send_signal("autopilot", signal.SIGSTOP, signal.SIGCONT, 0.15),
            FLIES,
            (flag_gap(VEHICLE, "firmware.command.fresh", 0.14),),
            stopped_s={AUTOPILOT: 0.15},
        ),
        Case(
            "autopilot-frozen-told",
            "autopilot's process stopped for 1 s; it must then report that the vehicle is in failsafe",
            acts.send_signal("autopilot", signal.SIGSTOP, signal.SIGCONT),
            STOPS,
            (
                FAILSAFE,
                logged_event(AUTOPILOT, "found again, but the vehicle is in failsafe"),
                exit_status(AUTOPILOT, 1),
            ),
            stopped_s={AUTOPILOT: 1.0},
        ),
    ]


SIGNALS = _signal_cases()
