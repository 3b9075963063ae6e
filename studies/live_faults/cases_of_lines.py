"""Cases of the campaign: frames on bad links, and attacks on the link."""

from studies.live_faults import acts
from studies.live_faults.case import AUTOPILOT, FAILSAFE, FLIES, STOPS, VEHICLE, Case
from studies.live_faults.relay import DOWN, UP
from studies.live_faults.words import counter_rise, first_evidence, logged_event

LOST, DAMAGED, GARBAGE, REFUSED = "wire.lost", "wire.damaged", "wire.garbage", "wire.refused"
HEARD_LOST, HEARD_DAMAGED, HEARD_GARBAGE, HEARD_REFUSED = "link.lost", "link.damaged", "link.garbage", "link.refused"
FUZZ = 10_000_000
SEEN = first_evidence(counter_rise(VEHICLE, GARBAGE, 1000), FAILSAFE)
FRAMES: list[Case] = [
    Case(
        "truncated-up",
        "3 of 4 commands truncated, for 1.5 s",
        acts.bend_packets(UP, acts.truncate_packets),
        evidence_checks=(counter_rise(VEHICLE, GARBAGE),),
    ),
    Case(
        "truncated-down",
        "3 of 4 samples truncated, for 1.5 s",
        acts.bend_packets(DOWN, acts.truncate_packets),
        FLIES,
        (counter_rise(AUTOPILOT, HEARD_GARBAGE),),
    ),
    Case(
        "flipped-up",
        "one bit inverted in 3 of 4 commands, for 1.5 s",
        acts.bend_packets(UP, acts.flip_bits),
        evidence_checks=(counter_rise(VEHICLE, DAMAGED),),
    ),
    Case(
        "flipped-down",
        "one bit inverted in 3 of 4 samples, for 1.5 s",
        acts.bend_packets(DOWN, acts.flip_bits),
        FLIES,
        (counter_rise(AUTOPILOT, HEARD_DAMAGED),),
    ),
    Case(
        "flipped-serial",
        "one bit inverted in 3 of 4 pieces on a serial line, for 1.5 s",
        acts.bend_packets(UP, acts.flip_bits),
        evidence_checks=(counter_rise(VEHICLE, DAMAGED),),
        serial=True,
    ),
    Case(
        "lossy-up",
        "every second command lost, for 1.5 s",
        acts.bend_packets(UP, acts.drop_half),
        FLIES,
        (counter_rise(VEHICLE, LOST),),
    ),
    Case(
        "lossy-down",
        "every second sample lost, for 1.5 s",
        acts.bend_packets(DOWN, acts.drop_half),
        FLIES,
        (counter_rise(AUTOPILOT, HEARD_LOST),),
    ),
    Case(
        "shuffled",
        "commands delayed by up to 100 ms, so that their order changes, for 1.5 s",
        acts.bend_packets(UP, acts.shuffle_packets),
        FLIES,
        (counter_rise(VEHICLE, "firmware.rejected"),),
    ),
    Case(
        "shuffled-down",
        "samples delayed by up to 100 ms, so that their order changes, for 1.5 s",
        acts.bend_packets(DOWN, acts.shuffle_packets),
        FLIES,
        (counter_rise(AUTOPILOT, "link.overtaken"),),
    ),
    Case(
        "doubled",
        "each command received three times, for 1.5 s",
        acts.bend_packets(UP, acts.repeat_packets),
        FLIES,
        (counter_rise(VEHICLE, REFUSED),),
    ),
    Case(
        "late-up",
        "commands delayed by 1 s, for 1.5 s",
        acts.bend_packets(UP, acts.delay_packets(1.0)),
        STOPS,
        (FAILSAFE,),
    ),
    Case(
        "late-down",
        "samples delayed by 1 s, for 1.5 s",
        acts.bend_packets(DOWN, acts.delay_packets(1.0)),
        FLIES,
        (logged_event(AUTOPILOT, "no data from"),),
    ),
]
"""Frames that are damaged, lost, late, or repeated."""
POURED: list[Case] = [
    Case(
        "fuzz-up",
        "10⁷ random bytes to the vehicle in 4 s",
        acts.pour_garbage(UP, FUZZ, 4.0),
        evidence_checks=(SEEN,),
        fly=7.0,
    ),
    Case(
        "fuzz-down",
        "10⁷ random bytes to the autopilot in 4 s",
        acts.pour_garbage(DOWN, FUZZ, 4.0),
        evidence_checks=(counter_rise(AUTOPILOT, HEARD_GARBAGE, 1000),),
        fly=7.0,
    ),
    Case(
        "fuzz-serial",
        "10⁶ random bytes into the vehicle's serial line in 2 s",
        acts.pour_garbage(UP, FUZZ // 10, 2.0),
        evidence_checks=(counter_rise(VEHICLE, GARBAGE, 1000),),
        fly=5.0,
        serial=True,
    ),
    Case(
        "replayed",
        "all frames sent by the autopilot are replayed in flight",
        acts.replay_packets,
        FLIES,
        (counter_rise(VEHICLE, REFUSED, 20),),
    ),
    Case(
        "replayed-after-cut",
        "link cut permanently; then all frames sent before are replayed twice, with the arming request",
        acts.replay_after_cut,
        STOPS,
        (FAILSAFE, counter_rise(VEHICLE, REFUSED, 40)),
    ),
    Case(
        "flood-up",
        "recorded frames sent to the vehicle at 10 × the usual data rate, for 1.5 s",
        acts.flood_line(UP),
        FLIES,
        (counter_rise(VEHICLE, REFUSED, 200),),
    ),
    Case(
        "flood-down",
        "recorded frames sent to the autopilot at 10 × the usual data rate, for 1.5 s",
        acts.flood_line(DOWN),
        FLIES,
        (counter_rise(AUTOPILOT, HEARD_REFUSED, 200),),
    ),
    Case(
        "flood-serial",
        "recorded pieces sent into the vehicle's serial line at 10 × the usual data rate, for 1.5 s",
        acts.flood_line(UP),
        evidence_checks=(counter_rise(VEHICLE, REFUSED, 200),),
        serial=True,
    ),
    Case(
        "stranger-unsigned",
        "an unknown sender sends 100 unsigned disarm requests",
        acts.disarm_without_key(False),
        FLIES,
        (counter_rise(VEHICLE, REFUSED, 50),),
    ),
    Case(
        "stranger-signed",
        "an unknown sender sends 100 disarm requests, signed with another key",
        acts.disarm_without_key(True),
        FLIES,
        (counter_rise(VEHICLE, REFUSED, 50),),
    ),
    Case(
        "unplugged-vehicle",
        "vehicle's serial device disconnected for 1 s",
        acts.unplug_device(UP, 1.0),
        STOPS,
        (FAILSAFE,),
        serial=True,
    ),
    Case(
        "unplugged-autopilot",
        "autopilot's serial device disconnected for 1 s",
        acts.unplug_device(DOWN, 1.0),
        STOPS,
        (FAILSAFE, logged_event(AUTOPILOT, "no data from")),
        serial=True,
    ),
]
"""Overload, foreign data, and missing links."""
