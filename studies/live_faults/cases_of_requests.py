"""Cases of the campaign: autopilots that are refused, and requests of ground stations."""

from studies.live_faults import acts
from studies.live_faults.acts import Act
from studies.live_faults.case import AUTOPILOT, FAILSAFE, FLIES, KILLED, STOPS, VEHICLE, Case, RefusedStart
from studies.live_faults.cases_of_ends import DISARMED
from studies.live_faults.disturbances import other_key, wrong_clock
from studies.live_faults.flight import FaultFlight
from studies.live_faults.words import (
    EvidenceCheck,
    absent_event,
    arming_count,
    exit_status,
    logged_event,
    printed_line,
)
from trimtab.flight.mavlink.protocol import CommandCode

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


def start_twin(flight: FaultFlight) -> None:
    """Start a second vehicle on the link, with the same system number and key, then an autopilot."""
    flight.start_twin()
    flight.start_refused()


def arm_at_once(flight: FaultFlight) -> None:
    """Ask to arm a vehicle that has just started, from a ground station."""
    flight.let_fly(1.0)
    ask_to_arm(flight)
    flight.let_fly(0.5)


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
    """Return cases of a ground station's requests that are unsupported, or not allowed at that time."""
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


REQUESTS: list[Case] = [*_refusals(), *_station_cases()]
