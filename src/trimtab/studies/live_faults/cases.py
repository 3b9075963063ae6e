"""The cases of the campaign."""

import signal

from trimtab.studies.live_faults import acts, machine
from trimtab.studies.live_faults.case import EITHER, FLIES, KILLED, STOPS, Case
from trimtab.studies.live_faults.relay import DOWN, UP
from trimtab.studies.live_faults.words import Words, counted, either, gap, noted, reached, told

VEHICLE, AUTOPILOT = "vehicle-1", "autopilot-1"
FAILSAFE = told(VEHICLE, "failsafe: no command")
WORDS = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
PARTS = ("sensor:navigation", "downlink", "uplink", "actuators")
SILENT = {"off", "stuck", "garbage"}
"""What of an uplink leaves no command that is new."""
CUTS = (0.1, 0.3, 1.0, 5.0)


def fault_words() -> list[Case]:
    """Each word on each part of the vehicle, for a second."""
    return [_word(part, word) for part in PARTS for word in WORDS]


def _word(part: str, word: str) -> Case:
    place = part.replace("sensor:", "sensors.")
    uplink = part == "uplink"
    ends = STOPS if uplink and word in SILENT else EITHER if uplink else FLIES
    says: tuple[Words, ...] = (told(VEHICLE, rf"world\.{place}\.fault\.word = {word}"),)
    return Case(
        f"{part.rpartition(':')[2]}-{word}",
        f"`{part} {word} for 1 s`, injected",
        acts.injected(f"{part} {word} for 1 s"),
        ends,
        (*says, FAILSAFE) if ends == STOPS else says,
        broken=1.0 if part == "actuators" else 0.0,
    )


def cuts() -> list[Case]:
    """The line cut both ways."""
    return [_cut(seconds, serial) for serial in (False, True) for seconds in CUTS]


def _cut(seconds: float, serial: bool) -> Case:
    stops = seconds >= 0.25
    lost = (gap(VEHICLE, "firmware.command.fresh", seconds * 0.9), counted(AUTOPILOT, "link.lost"))
    again = (FAILSAFE, told(AUTOPILOT, "nothing from the vehicle"), told(AUTOPILOT, "heard again"))
    return Case(
        f"cut-{seconds:g}{'-serial' if serial else ''}",
        f"{'serial line' if serial else 'line'} cut for {seconds:g} s",
        acts.cut(seconds),
        STOPS if stops else FLIES,
        again if stops else lost,
        serial=serial,
        fly=max(4.0, seconds + 3.0),
    )


def processes() -> list[Case]:
    """Ends that die, stop, or are told to end."""
    dead = told(AUTOPILOT, "the flying process is gone")
    silent = told(AUTOPILOT, "nothing from the vehicle")
    kill = signal.SIGKILL
    return [
        Case("none", "nothing", acts.nothing, FLIES, (told(VEHICLE, "disarmed: disarm request"),)),
        Case(
            "vehicle-killed",
            "vehicle's process killed",
            acts.signalled("vehicle", kill),
            words=(told(VEHICLE, "the flying process is gone"), silent),
            statuses={VEHICLE: (KILLED,)},
        ),
        Case(
            "vehicle-restarted",
            "vehicle's process killed and started again; nobody arms it",
            acts.vehicle_again,
            words=(told(VEHICLE, "the flying process is gone"), silent, told(AUTOPILOT, "heard again")),
            statuses={VEHICLE: (KILLED,)},
            fly=120.0,
        ),
        Case(
            "autopilot-killed",
            "autopilot's process killed",
            acts.signalled("autopilot", kill),
            STOPS,
            (FAILSAFE, dead),
            statuses={AUTOPILOT: (KILLED,)},
        ),
        Case(
            "autopilot-restarted",
            "autopilot's process killed; in failsafe, a person starts another, which asks to arm",
            acts.autopilot_again,
            STOPS,
            (FAILSAFE, dead, told("autopilot-2", "vehicle: computer: arm request")),
            statuses={AUTOPILOT: (KILLED,)},
            fly=20.0,
        ),
        Case(
            "autopilot-interrupted",
            "Ctrl-C on the autopilot",
            acts.signalled("autopilot", signal.SIGINT),
            FLIES,
            (told(VEHICLE, "disarmed: disarm request"),),
        ),
        Case(
            "vehicle-interrupted",
            "Ctrl-C on the vehicle",
            acts.signalled("vehicle", signal.SIGINT),
            words=(told(VEHICLE, "ended by request"), silent),
        ),
        Case(
            "autopilot-frozen",
            "autopilot's process stopped for 1 s (SIGSTOP, SIGCONT)",
            acts.signalled("autopilot", signal.SIGSTOP, signal.SIGCONT),
            STOPS,
            (FAILSAFE, counted(AUTOPILOT, "loop.skipped", 400)),
        ),
        Case(
            "vehicle-frozen",
            "vehicle's process stopped for 1 s (SIGSTOP, SIGCONT)",
            acts.signalled("vehicle", signal.SIGSTOP, signal.SIGCONT),
            EITHER,
            (reached(VEHICLE, "firmware.late", 0.9), silent),
        ),
    ]


def machines() -> list[Case]:
    """Clocks, disks, and the writers of logs."""
    steps = [
        Case(
            f"{who}-clock-{'on' if seconds > 0 else 'back'}",
            f"{who}'s wall clock stepped {'on' if seconds > 0 else 'back'} by an hour",
            machine.step_clock,
            FLIES,
            (told(VEHICLE, "disarmed: disarm request"),),
            prepare=machine.stepping(who, seconds),
            needs=machine.no_compiler,
        )
        for who in ("vehicle", "autopilot")
        for seconds in (3600, -3600)
    ]
    disks = [
        Case(
            f"{name.partition('-')[0]}-disk-full{'-again' if after else ''}",
            f"disk full below the {name.partition('-')[0]}'s log"
            + (f", {after:g} s later free again" if after else ""),
            machine.fill(name, after),
            FLIES,
            (noted(name, "can't be written"), *([told(name, "the log has a gap")] if after else [])),
            prepare=machine.small_disk(name),
            needs=machine.no_mount,
            partial=(name,),
            statuses={} if name == VEHICLE else {AUTOPILOT: (1,)},
        )
        for name in (VEHICLE, AUTOPILOT)
        for after in (None, 1.0)
    ]
    writers = [
        Case(
            f"{name.partition('-')[0]}-writer-killed",
            f"the process that writes the {name.partition('-')[0]}'s log killed",
            acts.writer_killed(name.partition("-")[0]),
            FLIES,
            (noted(name, "log's writer died"),),
            partial=(name,),
            statuses={} if name == VEHICLE else {AUTOPILOT: (1,)},
        )
        for name in (VEHICLE, AUTOPILOT)
    ]
    return [*steps, *disks, *writers]


def lines() -> list[Case]:
    """What a bad line, and bad people on it, do to frames."""
    lost, damaged, garbage, refused = ("wire.lost", "wire.damaged", "wire.garbage", "wire.refused")
    heard = {n: n.replace("wire.", "link.") for n in (lost, damaged, garbage, refused)}
    bend, fuzz = acts.bent, 10_000_000
    seen = either(counted(VEHICLE, garbage, 1000), FAILSAFE)
    return [
        Case(
            "truncated-up",
            "3 of 4 commands cut short, 1.5 s",
            bend(UP, acts.truncated),
            words=(counted(VEHICLE, garbage),),
        ),
        Case(
            "truncated-down",
            "3 of 4 samples cut short, 1.5 s",
            bend(DOWN, acts.truncated),
            FLIES,
            (counted(AUTOPILOT, heard[garbage]),),
        ),
        Case(
            "flipped-up",
            "a bit of 3 of 4 commands turned over, 1.5 s",
            bend(UP, acts.flipped),
            words=(counted(VEHICLE, damaged),),
        ),
        Case(
            "flipped-down",
            "a bit of 3 of 4 samples turned over, 1.5 s",
            bend(DOWN, acts.flipped),
            FLIES,
            (counted(AUTOPILOT, heard[damaged]),),
        ),
        Case(
            "flipped-serial",
            "a bit of 3 of 4 pieces turned over on a serial line, 1.5 s",
            bend(UP, acts.flipped),
            words=(counted(VEHICLE, damaged),),
            serial=True,
        ),
        Case("lossy-up", "every other command lost, 1.5 s", bend(UP, acts.thinned), FLIES, (counted(VEHICLE, lost),)),
        Case(
            "lossy-down",
            "every other sample lost, 1.5 s",
            bend(DOWN, acts.thinned),
            FLIES,
            (counted(AUTOPILOT, heard[lost]),),
        ),
        Case(
            "shuffled",
            "commands overtake each other by up to 100 ms, 1.5 s",
            bend(UP, acts.shuffled),
            FLIES,
            (counted(VEHICLE, refused),),
        ),
        Case(
            "doubled",
            "each command comes three times, 1.5 s",
            bend(UP, acts.doubled),
            FLIES,
            (counted(VEHICLE, refused),),
        ),
        Case("late-up", "commands 1 s late, 1.5 s", bend(UP, acts.late(1.0)), STOPS, (FAILSAFE,)),
        Case(
            "late-down",
            "samples 1 s late, 1.5 s",
            bend(DOWN, acts.late(1.0)),
            FLIES,
            (told(AUTOPILOT, "nothing from"),),
        ),
        Case("fuzz-up", "10⁷ random bytes to the vehicle in 4 s", acts.poured(UP, fuzz, 4.0), words=(seen,), fly=7.0),
        Case(
            "fuzz-down",
            "10⁷ random bytes to the autopilot in 4 s",
            acts.poured(DOWN, fuzz, 4.0),
            words=(counted(AUTOPILOT, heard[garbage], 1000),),
            fly=7.0,
        ),
        Case(
            "fuzz-serial",
            "10⁶ random bytes into the vehicle's serial line in 2 s",
            acts.poured(UP, fuzz // 10, 2.0),
            words=(counted(VEHICLE, garbage, 1000),),
            fly=5.0,
            serial=True,
        ),
        Case(
            "replayed",
            "all that the autopilot had sent comes again while it flies",
            acts.replayed,
            FLIES,
            (counted(VEHICLE, refused, 20),),
        ),
        Case(
            "replayed-after-cut",
            "line cut for good; then all that had been sent comes again twice, the request to arm too",
            acts.replayed_after_cut,
            STOPS,
            (FAILSAFE, counted(VEHICLE, refused, 40)),
        ),
        Case(
            "flood-up",
            "10 × the bandwidth to the vehicle, recorded frames, 1.5 s",
            acts.flooded(UP),
            FLIES,
            (counted(VEHICLE, refused, 200),),
        ),
        Case(
            "flood-down",
            "10 × the bandwidth to the autopilot, recorded frames, 1.5 s",
            acts.flooded(DOWN),
            FLIES,
            (counted(AUTOPILOT, heard[refused], 200),),
        ),
        Case(
            "flood-serial",
            "10 × the bandwidth into the vehicle's serial line, recorded pieces, 1.5 s",
            acts.flooded(UP),
            words=(counted(VEHICLE, refused, 200),),
            serial=True,
        ),
        Case(
            "stranger-unsigned",
            "somebody asks 100 times to disarm, unsigned",
            acts.stranger(False),
            FLIES,
            (counted(VEHICLE, refused, 50),),
        ),
        Case(
            "stranger-signed",
            "the same, signed with another key",
            acts.stranger(True),
            FLIES,
            (counted(VEHICLE, refused, 50),),
        ),
        Case(
            "unplugged-vehicle",
            "vehicle's serial device gone for 1 s",
            acts.unplugged(UP, 1.0),
            STOPS,
            (FAILSAFE,),
            serial=True,
        ),
        Case(
            "unplugged-autopilot",
            "autopilot's serial device gone for 1 s",
            acts.unplugged(DOWN, 1.0),
            STOPS,
            (FAILSAFE, told(AUTOPILOT, "nothing from")),
            serial=True,
        ),
    ]


def cases() -> list[Case]:
    """All of them, in the order of the table."""
    return [*fault_words(), *cuts(), *processes(), *machines(), *lines()]
