"""Both ends of a line in step: virtual time stands still until the other end has answered.

The vehicle's end says what has changed and closes the instant; the autopilot's end answers with the command of that
instant. So the numbers are those of `simulate`, whatever the line does: an instant is flown when all its samples are
there, what is lost is sent again, and an instant that comes twice is answered with the same command.
Source: docs page, Lockstep.
"""

from collections.abc import Callable, Iterator
from time import monotonic

from trimtab.core.interfaces import Link
from trimtab.live.autopilot_end import Pilot
from trimtab.live.exchange import Taken
from trimtab.live.remote import HEARTBEAT
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.wire.dialect import INSTANT
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.message import Message

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
