"""Cases of the campaign: other senders with the key, and wrong clocks."""

from collections.abc import Iterator
from contextlib import contextmanager

from studies.live_faults.acts import Act
from studies.live_faults.case import AUTOPILOT, FLIES, VEHICLE, Case
from studies.live_faults.flight import FaultFlight
from studies.live_faults.relay import DOWN
from studies.live_faults.words import counter_rise, logged_event, printed_line
from trimtab.flight.injector import Injector
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import SigningKey
from trimtab.flight.mavlink.protocol import CommandCode
from trimtab.flight.mavlink.stamps import running_clock

SECOND = "autopilot-2"
CONFIRM = "ended: arming refused: .*; type --rearm at fly"
"""Pattern of the message for an autopilot that asks to arm after a failsafe without a confirmation."""
OTHER_SYSTEM, COMPUTER = 7, 191
AHEAD, HOUR = 4_900_000, 36_000_000_000
"""Times of 0.49 s and an hour, in units of 100 ns."""
FULL_RUDDER = {"valid": 1, "rudder_pulse": 2.1e-3, "speed_rpm": 9000.0}


@contextmanager
def other_system(flight: FaultFlight) -> Iterator[tuple[Injector, Endpoint]]:
    """Join the link as another system with the key, bypassing the relay."""
    link, endpoint = flight.join_line(OTHER_SYSTEM, COMPUTER, flight.key)
    try:
        yield Injector(link, endpoint, flight.clock), endpoint
    finally:
        endpoint.close()
        link.close()


def send_commands(count: int, ahead: int = 0) -> Act:
    """Return an act in which another system with the key commands full rudder, with times ahead of the vehicle's."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        with other_system(flight) as (injector, endpoint):
            for _ in range(count):
                t = injector.read_vehicle_time() + ahead
                injector.link.send(endpoint.pack("COMMAND", {"t": t, "session": endpoint.session} | FULL_RUDDER))
                flight.pause(0.01)

    return act


def ask_to_disarm(flight: FaultFlight) -> None:
    """Ask to disarm, as another autopilot with the key, while the first one flies."""
    flight.let_fly(flight.undisturbed_s)
    with other_system(flight) as (injector, endpoint):
        asked = {"command": CommandCode.ARM, "param3": endpoint.session, "target_system": 1, "target_component": 1}
        for _ in range(10):
            injector.link.send(endpoint.pack("COMMAND_LONG", asked))
            flight.pause(0.02)


def start_second(*options: str) -> Act:
    """Return an act that starts a second `trimtab fly` with the same key, from another computer's folder."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.start_second(SECOND, *options)

    return act


def send_sample_ahead(flight: FaultFlight) -> None:
    """Send a validly signed sample of the vehicle, stamped an hour ahead."""
    flight.let_fly(flight.undisturbed_s)
    secret = SigningKey(flight.key.secret)
    with other_system(flight) as (injector, _):
        now = injector.read_vehicle_time()
    vehicle = Endpoint(
        flight.knowledge.dialect, 1, 1, secret, link=9, datagrams=True, clock=running_clock(flight.clock)
    )
    flight.relay.send_bytes(DOWN, vehicle.pack("SAMPLE_NAVIGATION", {"t": now + HOUR, "valid": 1}))


AUTHORITY: list[Case] = [
    Case(
        "second-autopilot",
        "a second autopilot with the key is started",
        start_second(),
        FLIES,
        (
            printed_line(SECOND, "wrong owner: the vehicle is flown by another autopilot"),
            printed_line(SECOND, "--take-over"),
            logged_event(VEHICLE, "commands without authority refused, from 1/191 session"),
        ),
        statuses={SECOND: (2,)},
        fly=20.0,
    ),
    Case(
        "taken-over",
        "a second autopilot takes the vehicle over",
        start_second("--take-over"),
        FLIES,
        (
            logged_event(AUTOPILOT, "ended: the vehicle was taken over by session"),
            logged_event(VEHICLE, "Control taken over from 1/191 session"),
            logged_event(VEHICLE, "disarmed: disarm request"),
        ),
        statuses={AUTOPILOT: (1,)},
        fly=20.0,
    ),
    Case(
        "foreign-commands",
        "another system with the key sends 50 commands of full rudder",
        send_commands(50),
        FLIES,
        (
            counter_rise(VEHICLE, "firmware.foreign", 50),
            logged_event(VEHICLE, "commands without authority refused, from 7/191"),
            logged_event(AUTOPILOT, "vehicle: commands without authority refused"),
        ),
    ),
    Case(
        "foreign-command-ahead",
        "another system with the key sends one command with a time stamp 0.49 s ahead",
        send_commands(1, AHEAD),
        FLIES,
        (counter_rise(VEHICLE, "firmware.foreign"), logged_event(VEHICLE, "commands without authority refused")),
    ),
    Case(
        "foreign-disarm",
        "another autopilot with the key sends ten disarm requests",
        ask_to_disarm,
        FLIES,
        (logged_event(VEHICLE, "Disarming by 7/191 session .* refused: vehicle belongs to 1/191 session"),),
    ),
    Case(
        "sample-ahead",
        "one correctly signed sample has a time stamp one hour ahead",
        send_sample_ahead,
        FLIES,
        (
            counter_rise(AUTOPILOT, "link.implausible"),
            logged_event(AUTOPILOT, r"sample rejected: its time is \+3\d\d\d\."),
        ),
    ),
]
"""Cases of senders that have the key but no authority. The vehicle must not obey them."""
