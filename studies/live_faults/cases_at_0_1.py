"""Cases of the campaign: flights that found further faults at version 0.1."""

import hashlib
import signal
import struct
from collections.abc import Mapping

from studies.live_faults import acts
from studies.live_faults.acts import Act
from studies.live_faults.case import AUTOPILOT, EITHER, FAILSAFE, FLIES, KILLED, STOPS, VEHICLE, Case, RefusedStart
from studies.live_faults.cases_of_authority import other_system
from studies.live_faults.disturbances import other_key, wrong_clock
from studies.live_faults.flight import FaultFlight
from studies.live_faults.relay import DOWN, UP
from studies.live_faults.words import (
    EvidenceCheck,
    absent_event,
    arming_count,
    counter_below,
    counter_rise,
    exit_status,
    flag_gap,
    logged_event,
    outputs_safe,
    printed_line,
)
from trimtab.flight.mavlink.definitions import MessageDefinition
from trimtab.flight.mavlink.endpoint import Endpoint, checksum
from trimtab.flight.mavlink.keys import SigningKey
from trimtab.flight.mavlink.protocol import CommandCode

DISARMED = logged_event(VEHICLE, "disarmed: disarm request")
PX4_MODES = {"rtl": (4.0, 5.0), "mission": (4.0, 4.0), "land": (4.0, 6.0)}
"""PX4's main mode AUTO, with its sub-modes."""
CUSTOM = 1.0


def _refused_case(name: str, does: str, start: RefusedStart, *evidence: EvidenceCheck) -> Case:
    does = f"{does}; then it flies with the command that the refusal suggests"
    return Case(name, does, acts.do_nothing, FLIES, (*evidence, DISARMED), refused_start=start)


def _clock_case(name: str, seconds: int) -> Case:
    which = "ahead of" if seconds > 0 else "behind"
    return _refused_case(
        f"autopilot-clock-{name}",
        f"autopilot's clock off by {seconds} s from its start",
        RefusedStart(rf"wrong clock: clocks differ by {abs(seconds)}\.\d s", environment=wrong_clock(seconds)),
        logged_event(VEHICLE, rf"refused: the clock of 1/191 is \d+\.\d s {which} this one"),
    )


def set_mode(main: float, part: float) -> Act:
    """Return an act in which a ground station asks for a mode of PX4."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        with flight.open_injector() as injector:
            asked = {"command": CommandCode.SET_MODE, "param1": CUSTOM, "param2": main, "param3": part}
            to = {"target_system": 1, "target_component": 1}
            for _ in range(3):
                injector.link.send(injector.endpoint.pack("COMMAND_LONG", asked | to))
                flight.pause(0.1)

    return act


def ask_to_arm(flight: FaultFlight) -> None:
    """Ask to arm from a ground station, three times."""
    with flight.open_injector() as injector:
        asked = {"command": CommandCode.ARM, "param1": 1.0, "target_system": 1, "target_component": 1}
        for _ in range(3):
            injector.link.send(injector.endpoint.pack("COMMAND_LONG", asked))
            flight.pause(0.1)


def arm_in_failsafe(flight: FaultFlight) -> None:
    """Kill the autopilot while the vehicle moves, and ask to arm as soon as it is in failsafe."""
    flight.let_fly(2.5)
    flight.autopilot.kill()
    flight.vehicle.wait_for("failsafe: no command")
    ask_to_arm(flight)


def send_samples_back(flight: FaultFlight) -> None:
    """Send fifty validly signed samples with decreasing times, a millisecond each, from half a second ago."""
    flight.let_fly(flight.undisturbed_s)
    with other_system(flight) as (injector, _):
        now = injector.read_vehicle_time()
    vehicle = Endpoint(flight.knowledge.dialect, 1, 1, SigningKey(flight.key.secret), link=9, datagrams=True)
    for k in range(50):
        times = {"t": now - 5_000_000 - 10_000 * k, "valid": 1}
        flight.relay.send_bytes(DOWN, vehicle.pack("SAMPLE_NAVIGATION", times))
        flight.pause(0.005)


def renumber_frames(direction: int) -> Act:
    """Return an act that renumbers each frame of one direction and signs it again, as its sender would."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        definitions, secret = flight.knowledge.dialect.by_id, flight.key.secret
        flight.relay.bend[direction] = lambda data: [(0.0, renumber_frame(definitions, secret, data, data[-1]))]
        flight.let_fly(1.5)
        flight.relay.bend.pop(direction)

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


def start_twin(flight: FaultFlight) -> None:
    """Start a second vehicle on the link, with the same numbers and the same key; then an autopilot."""
    flight.start_twin()
    flight.start_refused()


def arm_at_once(flight: FaultFlight) -> None:
    """Ask to arm a vehicle that has just started, from a ground station."""
    flight.let_fly(1.0)
    ask_to_arm(flight)
    flight.let_fly(0.5)


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


def _line_cases() -> list[Case]:
    """Return cases of wrong times and numbers, and of a serial link as bad as a datagram link."""
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


def _refusals() -> list[Case]:
    """Return cases of autopilots that are refused, and then fly with the command that the refusal suggests."""
    flags = "wrong scenario: the vehicle's settings differ from this end's"
    return [
        _clock_case("120-behind", -120),
        _clock_case("hour-behind", -3600),
        _clock_case("120-ahead", 120),
        _clock_case("day-ahead", 86400),
        _refused_case(
            "wrong-key",
            "autopilot with a different key, in a file of the same name",
            RefusedStart("wrong key: ", environment=other_key),
            logged_event(VEHICLE, "frames so far were unsigned or signed with another key"),
        ),
        _refused_case("no-key", "autopilot without a key, --unsigned", RefusedStart("wrong key: ", ("--unsigned",))),
        _refused_case(
            "other-scenario",
            "autopilot of hovercraft/spin, another scenario",
            RefusedStart(flags, scenario="hovercraft/spin"),
        ),
        _refused_case(
            "other-mass",
            "autopilot with the mass of a heavier vehicle",
            RefusedStart(r"world\.vehicle\.mass: \S+ on the vehicle, 2\.8 here", ("--set", "world.vehicle.mass=2.8")),
        ),
        _refused_case(
            "other-period",
            "autopilot with another sensor period",
            RefusedStart(r"navigation\.period: ", ("--set", "world.sensors.navigation.period=20 ms")),
        ),
    ]


def _station_cases() -> list[Case]:
    """Return cases of a ground station's requests that are unsupported, or not allowed now."""
    held = absent_event(AUTOPILOT, "supervisor: hold")
    modes = [
        Case(
            f"mode-{name}",
            f"a ground station requests PX4's mode {name.upper()} by DO_SET_MODE",
            set_mode(*numbers),
            FLIES,
            (held, DISARMED, exit_status(AUTOPILOT, 0)),
        )
        for name, numbers in PX4_MODES.items()
    ]
    return [
        *modes,
        Case(
            "armed-while-moving",
            "autopilot killed; a ground station asks to arm while the vehicle moves in failsafe",
            arm_in_failsafe,
            STOPS,
            (FAILSAFE, logged_event(VEHICLE, "Arming .*refused"), arming_count(1)),
            statuses={AUTOPILOT: (KILLED,)},
        ),
        Case(
            "twin",
            "a second vehicle on the link, with the same system number and key",
            start_twin,
            evidence_checks=(
                printed_line("refused-1", "two vehicles answer on this link as 1/1"),
                exit_status("refused-1", 2),
                arming_count(0),
            ),
            has_autopilot=False,
        ),
        Case(
            "sensor-off-at-start",
            "the only sensor is off; a ground station asks to arm",
            arm_at_once,
            evidence_checks=(logged_event(VEHICLE, "Arming refused: "), arming_count(0)),
            vehicle_options=("--fault", "sensor:navigation off"),
            has_autopilot=False,
        ),
    ]


ONE_WAY = [_cut_one_way_case(direction, seconds) for direction in (UP, DOWN) for seconds in (0.1, 0.4, 1.0)]
AT_0_1: list[Case] = [*_refusals(), *_station_cases(), *_signal_cases(), *_line_cases(), *ONE_WAY]
