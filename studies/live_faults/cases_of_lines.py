"""Cases of the campaign: what a bad line, and bad people on it, do to frames."""

from studies.live_faults import acts
from studies.live_faults.case import AUTOPILOT, FAILSAFE, FLIES, STOPS, VEHICLE, Case
from studies.live_faults.relay import DOWN, UP
from studies.live_faults.words import counted, either, told

LOST, DAMAGED, GARBAGE, REFUSED = "wire.lost", "wire.damaged", "wire.garbage", "wire.refused"
HEARD_LOST, HEARD_DAMAGED, HEARD_GARBAGE, HEARD_REFUSED = "link.lost", "link.damaged", "link.garbage", "link.refused"
FUZZ = 10_000_000
SEEN = either(counted(VEHICLE, GARBAGE, 1000), FAILSAFE)
FRAMES: list[Case] = [
    Case(
        "truncated-up",
        "3 of 4 commands cut short, 1.5 s",
        acts.bent(UP, acts.truncated),
        words=(counted(VEHICLE, GARBAGE),),
    ),
    Case(
        "truncated-down",
        "3 of 4 samples cut short, 1.5 s",
        acts.bent(DOWN, acts.truncated),
        FLIES,
        (counted(AUTOPILOT, HEARD_GARBAGE),),
    ),
    Case(
        "flipped-up",
        "a bit of 3 of 4 commands turned over, 1.5 s",
        acts.bent(UP, acts.flipped),
        words=(counted(VEHICLE, DAMAGED),),
    ),
    Case(
        "flipped-down",
        "a bit of 3 of 4 samples turned over, 1.5 s",
        acts.bent(DOWN, acts.flipped),
        FLIES,
        (counted(AUTOPILOT, HEARD_DAMAGED),),
    ),
    Case(
        "flipped-serial",
        "a bit of 3 of 4 pieces turned over on a serial line, 1.5 s",
        acts.bent(UP, acts.flipped),
        words=(counted(VEHICLE, DAMAGED),),
        serial=True,
    ),
    Case("lossy-up", "every other command lost, 1.5 s", acts.bent(UP, acts.thinned), FLIES, (counted(VEHICLE, LOST),)),
    Case(
        "lossy-down",
        "every other sample lost, 1.5 s",
        acts.bent(DOWN, acts.thinned),
        FLIES,
        (counted(AUTOPILOT, HEARD_LOST),),
    ),
    Case(
        "shuffled",
        "commands overtake each other by up to 100 ms, 1.5 s",
        acts.bent(UP, acts.shuffled),
        FLIES,
        (counted(VEHICLE, "firmware.rejected"),),
    ),
    Case(
        "shuffled-down",
        "samples overtake each other by up to 100 ms, 1.5 s",
        acts.bent(DOWN, acts.shuffled),
        FLIES,
        (counted(AUTOPILOT, "link.overtaken"),),
    ),
    Case(
        "doubled",
        "each command comes three times, 1.5 s",
        acts.bent(UP, acts.doubled),
        FLIES,
        (counted(VEHICLE, REFUSED),),
    ),
    Case("late-up", "commands 1 s late, 1.5 s", acts.bent(UP, acts.late(1.0)), STOPS, (FAILSAFE,)),
    Case(
        "late-down",
        "samples 1 s late, 1.5 s",
        acts.bent(DOWN, acts.late(1.0)),
        FLIES,
        (told(AUTOPILOT, "nothing from"),),
    ),
]
"""Frames that are damaged, lost, late, or come again."""
POURED: list[Case] = [
    Case("fuzz-up", "10⁷ random bytes to the vehicle in 4 s", acts.poured(UP, FUZZ, 4.0), words=(SEEN,), fly=7.0),
    Case(
        "fuzz-down",
        "10⁷ random bytes to the autopilot in 4 s",
        acts.poured(DOWN, FUZZ, 4.0),
        words=(counted(AUTOPILOT, HEARD_GARBAGE, 1000),),
        fly=7.0,
    ),
    Case(
        "fuzz-serial",
        "10⁶ random bytes into the vehicle's serial line in 2 s",
        acts.poured(UP, FUZZ // 10, 2.0),
        words=(counted(VEHICLE, GARBAGE, 1000),),
        fly=5.0,
        serial=True,
    ),
    Case(
        "replayed",
        "all that the autopilot had sent comes again while it flies",
        acts.replayed,
        FLIES,
        (counted(VEHICLE, REFUSED, 20),),
    ),
    Case(
        "replayed-after-cut",
        "line cut for good; then all that had been sent comes again twice, the request to arm too",
        acts.replayed_after_cut,
        STOPS,
        (FAILSAFE, counted(VEHICLE, REFUSED, 40)),
    ),
    Case(
        "flood-up",
        "10 × the bandwidth to the vehicle, recorded frames, 1.5 s",
        acts.flooded(UP),
        FLIES,
        (counted(VEHICLE, REFUSED, 200),),
    ),
    Case(
        "flood-down",
        "10 × the bandwidth to the autopilot, recorded frames, 1.5 s",
        acts.flooded(DOWN),
        FLIES,
        (counted(AUTOPILOT, HEARD_REFUSED, 200),),
    ),
    Case(
        "flood-serial",
        "10 × the bandwidth into the vehicle's serial line, recorded pieces, 1.5 s",
        acts.flooded(UP),
        words=(counted(VEHICLE, REFUSED, 200),),
        serial=True,
    ),
    Case(
        "stranger-unsigned",
        "somebody asks 100 times to disarm, unsigned",
        acts.stranger(False),
        FLIES,
        (counted(VEHICLE, REFUSED, 50),),
    ),
    Case(
        "stranger-signed",
        "the same, signed with another key",
        acts.stranger(True),
        FLIES,
        (counted(VEHICLE, REFUSED, 50),),
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
"""More than a line carries, what was not meant for it, and no line at all."""
