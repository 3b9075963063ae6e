"""Both ends of a line in step: virtual time stands still until the other end has answered.

The vehicle's end says what has changed and closes the instant; the autopilot's end answers with the command of that
instant. So the numbers are those of `simulate`, whatever the line does: an instant is flown when all its samples are
there, what is lost is sent again, and an instant that comes twice is answered with the same command.
Source: docs page, Lockstep.

Whole flights in lockstep: a compiled side, its line, its log.

Source: docs page, Lockstep.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, to_seconds
from trimtab.live.autopilot_end import AutopilotEnd, frame_log_path, scenario_dialect
from trimtab.live.exchange import GroupSample
from trimtab.live.flight_log import FlightLog, LogSource
from trimtab.live.remote import HEARTBEAT
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import compile_autopilot, compile_world
from trimtab.run.program import describe_scenario
from trimtab.wire.definitions import Message
from trimtab.wire.dialect import INSTANT, Dialect, derive_dialect
from trimtab.wire.mavlink import Endpoint

RESEND_PERIOD = 0.2
"""Seconds after which what has not been answered is sent again."""
PATIENCE = 10.0
"""Seconds of silence after which the other end is given up."""
START_PATIENCE = 120.0
"""Seconds that it may take to come up: it may have to be compiled."""


class NoAnswerError(Exception):
    """The other end has not answered for too long."""


def lead_lockstep(vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, each: Callable[[int], None]) -> None:
    """The vehicle's end, for the scenario's duration; `each(t)` is called after every instant and at the end.

    Raises Silence when nobody answers.
    """
    period, duration = vehicle.scenario.autopilot.period, vehicle.scenario.duration
    fresh = False
    for t in vehicle.instants():
        vehicle.advance(min(t, duration), fresh=fresh)
        if t >= duration:
            each(duration)
            return
        fresh = t % period == 0
        if fresh:
            _await_command(vehicle, link, endpoint, t).write(vehicle.world.inputs)
        each(t)


def _await_command(vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, t: int) -> GroupSample:
    """The command for instant t."""
    given_up = monotonic() + (PATIENCE if t else START_PATIENCE)
    changed = vehicle.changed_sensors()
    while monotonic() < given_up:
        for packet in vehicle.sample_packets(endpoint, changed):
            link.send(packet)
        link.send(endpoint.pack(endpoint.dialect.groups[INSTANT][0], {"t": t, "samples": len(changed)}))
        again = monotonic() + RESEND_PERIOD
        while (left := again - monotonic()) > 0:
            for message in _receive_messages(link, endpoint, left):
                if message.name in vehicle.command.names:
                    taken = vehicle.command.assemble(message)
                    if taken is not None and taken.t == t:
                        return taken
    raise NoAnswerError(f"no command for {PATIENCE if t else START_PATIENCE:g} s")


def _receive_messages(link: Link, endpoint: Endpoint, timeout: float) -> list[Message]:
    """What has come and was accepted; who sent it may be answered."""
    messages = endpoint.feed(link.receive(timeout))
    if messages:
        link.accept_sender()
    return messages


def follow_lockstep(pilot: AutopilotEnd, link: Link, endpoint: Endpoint, duration: int, period: int) -> Iterator[int]:
    """The autopilot's end, for a duration: yields each instant after its step, before it is answered.

    Raises Silence when the vehicle says nothing more.
    """
    instant = endpoint.dialect.groups[INSTANT][0]
    done = -period
    given_up, quiet = monotonic() + START_PATIENCE, 0.0
    while done + period < duration:
        if monotonic() > quiet:  # on some lines the vehicle knows only those ends that it hears
            link.send(endpoint.pack("HEARTBEAT", HEARTBEAT))
            quiet = monotonic() + RESEND_PERIOD
        for message in _receive_messages(link, endpoint, RESEND_PERIOD):
            if message.name != instant:
                pilot.handle_message(message)
                continue
            t, samples = message.get("t"), message.get("samples")
            if t == done + period and pilot.queue_length == samples:
                pilot.fly_period(t)
                yield t
                done = t
            given_up, quiet = monotonic() + PATIENCE, monotonic() + RESEND_PERIOD
            for packet in pilot.command_packets(endpoint) if t == done else ():
                link.send(packet)
        if monotonic() > given_up:
            raise NoAnswerError(f"no instant after {done * 1e-7:g} s")


MakeEndpoint = Callable[[Dialect], Endpoint]


class LockstepVehicle:
    """The vehicle's end: it leads."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the world. endpoint: makes the vehicle's end for a dialect."""
        world, frame, command = compile_world(scenario, seed=seed)
        dialect = derive_dialect(frame, command)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(scenario, dialect, world)

    def run(self, link: Link, log: Path | None = None, log_period: int = ms(1)) -> LogFileSummary | None:
        """Lead through the scenario's duration; raises Silence where nobody follows."""
        body, world = self.body, self.body.world
        about = describe_scenario(self.scenario) | {"side": "vehicle", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(log_period)
        sources = [LogSource(body.row, world.text.outputs, lambda p: p)]
        book = FlightLog(log, sources, {}, about) if log else None

        def each(t: int) -> None:
            if book is not None and t and body.row_t % log_period == 0:
                book.write_row(body.row_t)

        written = None
        try:
            lead_lockstep(body, link, self.endpoint, each)
        finally:
            self.endpoint.close()
            written = book.close(self._final_truth()) if book else None
        return written

    def _final_truth(self) -> dict[str, Any]:
        world = self.body.world
        return {p: np.array(world.outputs[at]) for p, at in world.writes.items() if p.startswith("truth.")}


class LockstepAutopilot:
    """The autopilot's end: it follows."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the autopilot. endpoint: makes its end for a dialect."""
        scenario.check()
        dialect = scenario_dialect(scenario)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.pilot = AutopilotEnd(scenario, dialect, compile_autopilot(scenario, seed=seed))

    def run(self, link: Link, log: Path | None = None) -> LogFileSummary | None:
        """Follow through the scenario's duration; raises Silence where nobody leads."""
        step, period = self.pilot.step, self.scenario.autopilot.period
        about = describe_scenario(self.scenario) | {"side": "autopilot", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(period)
        sources = [
            LogSource(step.inputs, step.text.inputs, frame_log_path),
            LogSource(step.outputs, step.text.outputs, lambda p: p),
        ]
        book = FlightLog(log, sources, {}, about) if log else None
        written = None
        try:
            for t in follow_lockstep(self.pilot, link, self.endpoint, self.scenario.duration, period):
                if book is not None:
                    book.write_row(t)
        finally:
            self.endpoint.close()
            written = book.close() if book else None
        return written
