"""Vehicle's end and autopilot's end of a link in lockstep: virtual time advances only when the other end has answered.

At each instant, the vehicle's end sends the changed samples, then a message that ends the instant. The autopilot's end
answers with the command of this instant. So the results equal those of `simulate`, even if the link delays or loses
packets. The autopilot computes a command once all samples of an instant have arrived. Lost packets are sent again. If
the vehicle repeats an instant, the autopilot repeats the command.

Source: docs page, Lockstep.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.core.time import ms
from trimtab.flight.autopilot_end import AutopilotEnd, scenario_dialect
from trimtab.flight.exchange import GroupSample, receive_messages, request_answer
from trimtab.flight.flight_log import open_flight_log
from trimtab.flight.forwarded_requests import HEARTBEAT
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.dialect import INSTANT, Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandCode
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import compile_autopilot
from trimtab.run.cosimulation import prepare_world

RESEND_PERIOD = 0.2
"""Time after which an unanswered packet is sent again (s)."""
PATIENCE = 10.0
"""Time (s) without an answer after which the other end of the link counts as lost."""
LINGER = 1.0
"""Time (s) for which the autopilot's end waits for a repetition of the last instant before it ends."""
END_PACKETS = 3
"""Number of times that the vehicle's end sends the confirmation that the last command has arrived."""
START_PATIENCE = 120.0
"""Longest time (s) that the program at the other end may take to start, including its compilation."""


class NoAnswerError(Exception):
    """Error that the other end of the link did not answer in time."""


def lead_lockstep(
    vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, clock: Clock = SYSTEM_CLOCK
) -> Iterator[int]:
    """Run the vehicle's end for the scenario's duration. Yield each instant once the command for this instant has
    arrived.

    Raises NoAnswerError if the other end does not answer.
    """
    period, duration = vehicle.scenario.autopilot.period, vehicle.scenario.duration
    fresh = False
    for t in vehicle.instants():
        vehicle.advance(min(t, duration), fresh=fresh)
        if t >= duration:
            for _ in range(END_PACKETS):
                link.send(_pack_instant(endpoint, duration, 0))
            yield duration
            return
        fresh = t % period == 0
        if fresh:
            _await_command(vehicle, link, endpoint, t, clock).write(vehicle.world.inputs)
        yield t


def _await_command(vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, t: int, clock: Clock) -> GroupSample:
    """Send the samples of instant t repeatedly until the command arrives, and return the command."""
    changed = vehicle.changed_sensors()
    patience = PATIENCE if t else START_PATIENCE

    def packets() -> list[bytes]:
        samples = vehicle.sample_packets(endpoint, changed)
        return [*samples, _pack_instant(endpoint, t, len(changed))]

    def answer(message: Message) -> GroupSample | None:
        command = vehicle.command.assemble(message) if message.name in vehicle.command.names else None
        return command if command is not None and command.t == t else None

    command = request_answer(
        link, endpoint, packets, answer, patience=patience, resend_period=RESEND_PERIOD, clock=clock
    )
    if command is None:
        raise NoAnswerError(f"the autopilot has sent no command for {patience:g} s")
    return command


def _pack_instant(endpoint: Endpoint, t: int, samples: int) -> bytes:
    return endpoint.pack(endpoint.dialect.groups[INSTANT][0], {"t": t, "samples": samples})


def follow_lockstep(
    autopilot_end: AutopilotEnd,
    link: Link,
    endpoint: Endpoint,
    duration: int,
    period: int,
    clock: Clock = SYSTEM_CLOCK,
) -> Iterator[int]:
    """Run the autopilot's end for a duration. Yield each instant after its command is computed and before the command
    is sent.

    Raises NoAnswerError if the vehicle sends no more data.
    """
    instant = endpoint.dialect.groups[INSTANT][0]
    arming = {"command": CommandCode.ARM, "param1": 1.0, "param3": endpoint.session, "target_system": endpoint.system}
    done = -period

    def now() -> float:
        return clock.monotonic_ns() / NS_PER_SECOND

    deadline, heartbeat_time = now() + START_PATIENCE, 0.0
    while done + period < duration:
        if now() > heartbeat_time:  # on some links the vehicle sends only to peers that have already sent a packet
            link.send(endpoint.pack("HEARTBEAT", HEARTBEAT))
            if done < 0:  # firmware waits to be armed; a virtual vehicle ignores this request
                link.send(endpoint.pack("COMMAND_LONG", arming))
            heartbeat_time = now() + RESEND_PERIOD
        for message in receive_messages(link, endpoint, RESEND_PERIOD):
            if message.name != instant:
                autopilot_end.handle_message(message)
                continue
            t, samples = message.get("t"), message.get("samples")
            if t == done + period and autopilot_end.queue_length == samples:
                autopilot_end.fly_period(t)
                yield t
                done = t
            deadline, heartbeat_time = now() + PATIENCE, now() + RESEND_PERIOD
            for packet in autopilot_end.command_packets(endpoint) if t == done else ():
                link.send(packet)
        if now() > deadline:
            raise NoAnswerError(f"the vehicle has sent no data after the instant {done * 1e-7:g} s")
    deadline = now() + LINGER
    while now() < deadline:  # the last command may be lost: answer repetitions of the last instant
        for message in receive_messages(link, endpoint, RESEND_PERIOD):
            if message.name == instant and message.get("t") > done:
                return
            if message.name == instant:
                deadline = now() + LINGER
                for packet in autopilot_end.command_packets(endpoint):
                    link.send(packet)


MakeEndpoint = Callable[[Dialect], Endpoint]


class LockstepVehicle:
    """Vehicle's end of a link in lockstep. It sends the samples of each instant and waits for the command."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the simulated vehicle. endpoint: function that makes the vehicle's endpoint for a MAVLink dialect."""
        world, frame, command = prepare_world(scenario, seed=seed)
        dialect = derive_dialect(frame, command)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(scenario, dialect, world)

    def run(self, link: Link, log: Path | None = None, log_period: int = ms(1)) -> LogFileSummary | None:
        """Run for the scenario's duration. Raise NoAnswerError if no autopilot answers."""
        body = self.body
        flight_log = open_flight_log(
            log, body.log_sources(), {}, self.scenario, side="vehicle", seed=self.seed, log_period=log_period
        )
        summary = None
        try:
            for t in lead_lockstep(body, link, self.endpoint):
                if flight_log is not None and t and body.row_t % log_period == 0:
                    flight_log.await_room()
                    flight_log.write_row(body.row_t)
        finally:
            self.endpoint.close()
            summary = flight_log.close(body.final_truth()) if flight_log else None
        return summary


class LockstepAutopilot:
    """Autopilot's end of a link in lockstep. It answers the samples of each instant with a command."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the autopilot. endpoint: function that makes the autopilot's endpoint for a MAVLink dialect."""
        scenario.check()
        dialect = scenario_dialect(scenario)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.autopilot_end = AutopilotEnd(scenario, dialect, compile_autopilot(scenario, seed=seed))

    def run(self, link: Link, log: Path | None = None) -> LogFileSummary | None:
        """Answer each instant of the vehicle for the scenario's duration. Raise NoAnswerError if the vehicle sends no
        instants."""
        period = self.scenario.autopilot.period
        sources = self.autopilot_end.log_sources()
        flight_log = open_flight_log(
            log, sources, {}, self.scenario, side="autopilot", seed=self.seed, log_period=period
        )
        summary = None
        try:
            for t in follow_lockstep(self.autopilot_end, link, self.endpoint, self.scenario.duration, period):
                if flight_log is not None:
                    flight_log.await_room()
                    flight_log.write_row(t)
        finally:
            self.endpoint.close()
            summary = flight_log.close() if flight_log else None
        return summary
