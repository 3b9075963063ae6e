"""Cases of the campaign: frames on bad links, and attacks on the link."""

import hashlib
import struct
from collections.abc import Mapping

from studies.live_faults import acts
from studies.live_faults.acts import Act
from studies.live_faults.case import AUTOPILOT, EITHER, FAILSAFE, FLIES, STOPS, VEHICLE, Case
from studies.live_faults.cases_of_authority import other_system
from studies.live_faults.flight import FaultFlight
from studies.live_faults.relay import DOWN, UP
from studies.live_faults.words import (
    absent_event,
    counter_below,
    counter_rise,
    first_evidence,
    flag_gap,
    logged_event,
)
from trimtab.flight.mavlink.definitions import MessageDefinition
from trimtab.flight.mavlink.endpoint import Endpoint, checksum
from trimtab.flight.mavlink.keys import SigningKey
from trimtab.flight.mavlink.stamps import running_clock

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
"""Cases of frames that are damaged, lost, late, or repeated."""
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
"""Cases of overload, foreign data, and missing links."""


def send_samples_back(flight: FaultFlight) -> None:
    """Send fifty validly signed samples whose times decrease by 1 ms each, from half a second ago."""
    flight.let_fly(flight.undisturbed_s)
    with other_system(flight) as (injector, _):
        now = injector.read_vehicle_time()
    secret = SigningKey(flight.key.secret)
    vehicle = Endpoint(
        flight.knowledge.dialect, 1, 1, secret, link=9, datagrams=True, clock=running_clock(flight.clock)
    )
    for k in range(50):
        times = {"t": now - 5_000_000 - 10_000 * k, "valid": 1}
        flight.relay.send_bytes(DOWN, vehicle.pack("SAMPLE_NAVIGATION", times))
        flight.pause(0.005)


def renumber_frames(direction: int) -> Act:
    """Return an act that renumbers each frame of one direction and signs it again, as its sender would."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        definitions, secret = flight.knowledge.dialect.by_id, flight.key.secret

        def renumber(data: bytes) -> list[tuple[float, bytes]]:
            return [(0.0, renumber_frame(definitions, secret, data, data[-1]))]

        flight.relay.bends[direction].append(renumber)
        flight.let_fly(1.5)
        flight.relay.bends[direction].remove(renumber)

    return act


def renumber_frame(definitions: Mapping[int, MessageDefinition], secret: bytes, frame: bytes, number: int) -> bytes:
    """Return a signed frame with another sequence number and the same time stamp."""
    (low, high), length = struct.unpack_from("<HB", frame, 7), frame[1]
    body = frame[:4] + bytes((number,)) + frame[5 : 10 + length]
    body += checksum(body[1:], definitions[low | high << 16].crc_extra) + frame[12 + length : 19 + length]
    return body + hashlib.sha256(secret + body).digest()[:6]


def cut_one_way(direction: int, seconds: float) -> Act:
    """Return an act that blocks one direction."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.relay.cut_line(seconds, (direction,))

    return act


def _cut_one_way_case(direction: int, seconds: float) -> Case:
    name, stops = ("up" if direction == UP else "down"), direction == UP and seconds > 0.25
    seen = {
        UP: FAILSAFE if stops else flag_gap(VEHICLE, "firmware.command.fresh", 0.9 * seconds),
        DOWN: logged_event(AUTOPILOT, "no data from the vehicle")
        if seconds > 0.25
        else counter_rise(AUTOPILOT, "link.lost"),
    }[direction]
    what = "towards the vehicle" if direction == UP else "towards the autopilot"
    does, act = f"link cut only {what}, for {seconds:g} s", cut_one_way(direction, seconds)
    return Case(f"cut-{name}-{seconds:g}", does, act, STOPS if stops else FLIES, (seen,))


def _line_cases() -> list[Case]:
    """Return cases of wrong times and sequence numbers, and of a serial link with the faults of a datagram link."""
    return [
        Case(
            "numbers-random-up",
            "correctly signed commands with random sequence numbers, for 1.5 s",
            renumber_frames(UP),
            FLIES,
            (counter_below(VEHICLE, "wire.lost", 100),),
        ),
        Case(
            "numbers-random-down",
            "correctly signed samples with random sequence numbers, for 1.5 s",
            renumber_frames(DOWN),
            FLIES,
            (counter_below(AUTOPILOT, "link.lost", 1000),),
        ),
        Case(
            "samples-back",
            "50 correctly signed samples with decreasing times",
            send_samples_back,
            FLIES,
            (counter_rise(AUTOPILOT, "link.overtaken", 40), absent_event(AUTOPILOT, "lost: link lost")),
        ),
        Case(
            "truncated-serial",
            "3 of 4 pieces truncated on a serial line, for 1.5 s",
            acts.bend_packets(UP, acts.truncate_packets),
            EITHER,
            (counter_rise(VEHICLE, "wire.garbage"),),
            serial=True,
        ),
        Case(
            "lossy-serial",
            "every second piece lost on a serial line, for 1.5 s",
            acts.bend_packets(UP, acts.drop_half),
            FLIES,
            (counter_rise(VEHICLE, "wire.lost"),),
            serial=True,
        ),
        Case(
            "doubled-serial",
            "each piece received three times on a serial line, for 1.5 s",
            acts.bend_packets(UP, acts.repeat_packets),
            FLIES,
            (counter_rise(VEHICLE, "wire.refused"),),
            serial=True,
        ),
        Case(
            "late-serial",
            "pieces delayed by 1 s on a serial line, for 1.5 s",
            acts.bend_packets(UP, acts.delay_packets(1.0)),
            STOPS,
            (FAILSAFE,),
            serial=True,
        ),
    ]


ORDER = _line_cases()
ONE_WAY = [_cut_one_way_case(direction, seconds) for direction in (UP, DOWN) for seconds in (0.1, 0.4, 1.0)]
