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
from trimtab.live.autopilot_end import Pilot, dialect_for, frame_name
from trimtab.live.exchange import Taken
from trimtab.live.flight_log import FlightLog, Source
from trimtab.live.remote import HEARTBEAT
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.live.world_step import compiled_world
from trimtab.logs.stream import Written
from trimtab.loop.scenario import Scenario
from trimtab.run.fast_step import fast_step
from trimtab.run.program import described
from trimtab.wire.definitions import Message
from trimtab.wire.dialect import INSTANT, Dialect, dialect_of
from trimtab.wire.mavlink import Endpoint

AGAIN = 0.2
"""Seconds after which what has not been answered is sent again."""
PATIENCE = 10.0
"""Seconds of silence after which the other end is given up."""
FIRST = 120.0
"""Seconds that it may take to come up: it may have to be compiled."""


class Silence(Exception):
    """The other end has not answered for too long."""


def lead(vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, each: Callable[[int], None]) -> None:
    """The vehicle's end, for the scenario's duration; `each(t)` is called after every instant and at the end.

    Raises Silence when nobody answers.
    """
    period, duration = vehicle.scenario.autopilot.period, vehicle.scenario.duration
    fresh = False
    for t in vehicle.instants():
        vehicle.turn(min(t, duration), fresh=fresh)
        if t >= duration:
            each(duration)
            return
        fresh = t % period == 0
        if fresh:
            _ask(vehicle, link, endpoint, t).write(vehicle.world.inputs)
        each(t)


def _ask(vehicle: VirtualVehicle, link: Link, endpoint: Endpoint, t: int) -> Taken:
    """The command for instant t."""
    given_up = monotonic() + (PATIENCE if t else FIRST)
    changed = vehicle.changed()
    while monotonic() < given_up:
        for packet in vehicle.packets(endpoint, changed):
            link.send(packet)
        link.send(endpoint.pack(endpoint.dialect.groups[INSTANT][0], {"t": t, "samples": len(changed)}))
        again = monotonic() + AGAIN
        while (left := again - monotonic()) > 0:
            for message in _heard(link, endpoint, left):
                if message.name in vehicle.command.names:
                    taken = vehicle.command.take(message)
                    if taken is not None and taken.t == t:
                        return taken
    raise Silence(f"no command for {PATIENCE if t else FIRST:g} s")


def _heard(link: Link, endpoint: Endpoint, timeout: float) -> list[Message]:
    """What has come and was accepted; who sent it may be answered."""
    messages = endpoint.feed(link.receive(timeout))
    if messages:
        link.vouch()
    return messages


def follow(pilot: Pilot, link: Link, endpoint: Endpoint, duration: int, period: int) -> Iterator[int]:
    """The autopilot's end, for a duration: yields each instant after its step, before it is answered.

    Raises Silence when the vehicle says nothing more.
    """
    instant = endpoint.dialect.groups[INSTANT][0]
    done = -period
    given_up, quiet = monotonic() + FIRST, 0.0
    while done + period < duration:
        if monotonic() > quiet:  # on some lines the vehicle knows only those ends that it hears
            link.send(endpoint.pack("HEARTBEAT", HEARTBEAT))
            quiet = monotonic() + AGAIN
        for message in _heard(link, endpoint, AGAIN):
            if message.name != instant:
                pilot.take(message)
                continue
            t, samples = message.get("t"), message.get("samples")
            if t == done + period and pilot.waiting == samples:
                pilot.fly(t)
                yield t
                done = t
            given_up, quiet = monotonic() + PATIENCE, monotonic() + AGAIN
            for packet in pilot.commands(endpoint) if t == done else ():
                link.send(packet)
        if monotonic() > given_up:
            raise Silence(f"no instant after {done * 1e-7:g} s")


MakeEndpoint = Callable[[Dialect], Endpoint]


class LockstepVehicle:
    """The vehicle's end: it leads."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the world. endpoint: makes the vehicle's end for a dialect."""
        world, frame, command = compiled_world(scenario, seed=seed)
        dialect = dialect_of(frame, command)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(scenario, dialect, world)

    def run(self, link: Link, log: Path | None = None, log_period: int = ms(1)) -> Written | None:
        """Lead through the scenario's duration; raises Silence where nobody follows."""
        body, world = self.body, self.body.world
        about = described(self.scenario) | {"side": "vehicle", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(log_period)
        sources = [Source(body.row, world.exported.outputs, lambda p: p)]
        book = FlightLog(log, sources, {}, about) if log else None

        def each(t: int) -> None:
            if book is not None and t and body.row_t % log_period == 0:
                book.put(body.row_t)

        written = None
        try:
            lead(body, link, self.endpoint, each)
        finally:
            self.endpoint.close()
            written = book.close(self._final()) if book else None
        return written

    def _final(self) -> dict[str, Any]:
        world = self.body.world
        return {p: np.array(world.outputs[at]) for p, at in world.writes.items() if p.startswith("truth.")}


class LockstepPilot:
    """The autopilot's end: it follows."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the autopilot. endpoint: makes its end for a dialect."""
        scenario.check()
        dialect = dialect_for(scenario)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.pilot = Pilot(scenario, dialect, fast_step(scenario, seed=seed))

    def run(self, link: Link, log: Path | None = None) -> Written | None:
        """Follow through the scenario's duration; raises Silence where nobody leads."""
        step, period = self.pilot.step, self.scenario.autopilot.period
        about = described(self.scenario) | {"side": "autopilot", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(period)
        sources = [
            Source(step.inputs, step.exported.inputs, frame_name),
            Source(step.outputs, step.exported.outputs, lambda p: p),
        ]
        book = FlightLog(log, sources, {}, about) if log else None
        written = None
        try:
            for t in follow(self.pilot, link, self.endpoint, self.scenario.duration, period):
                if book is not None:
                    book.put(t)
        finally:
            self.endpoint.close()
            written = book.close() if book else None
        return written
