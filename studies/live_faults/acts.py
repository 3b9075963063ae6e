"""What is done to a flight: to its line, to its processes, and by strangers."""

import os
import random
import signal
from collections.abc import Callable
from time import monotonic, sleep

from studies.live_faults.flight import INJECTOR, Flight, pause
from studies.live_faults.relay import DOWN, UP, Bend, Terminals
from trimtab.links.open_link import open_link
from trimtab.wire.keys import passphrase_key
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.protocol import Order

FLOWN_S = 1.0
"""For how long it flies until something is done."""
TICK_S = 0.01
DATAGRAM = 1000
Act = Callable[[Flight], None]


def injected(text: str) -> Act:
    """A fault word, put in live."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        flight.inject(text)

    return act


def cut(seconds: float) -> Act:
    """Nothing passes, either way."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        flight.relay.cut(seconds)

    return act


def bent(direction: int, make: Callable[[random.Random], Bend], seconds: float = 1.5) -> Act:
    """Each packet one way becomes something else for a while."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        flight.relay.bend[direction] = make(random.Random(1))
        pause(seconds)
        flight.relay.bend.pop(direction)

    return act


def truncated(draw: random.Random) -> Bend:
    """Three in four packets end too soon."""
    return lambda data: [(0.0, data[: draw.randrange(len(data))] if draw.random() < 0.75 else data)]


def flipped(draw: random.Random) -> Bend:
    """One bit of three in four packets is another."""

    def bend(data: bytes) -> list[tuple[float, bytes]]:
        if draw.random() < 0.75:
            bit = draw.randrange(8 * len(data))
            data = data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
        return [(0.0, data)]

    return bend


def thinned(draw: random.Random) -> Bend:
    """Half of the packets are lost."""
    return lambda data: [(0.0, data)] if draw.random() < 0.5 else []


def shuffled(draw: random.Random) -> Bend:
    """Each packet comes up to 100 ms later, so that they overtake each other."""
    return lambda data: [(draw.uniform(0.0, 0.1), data)]


def late(seconds: float) -> Callable[[random.Random], Bend]:
    """Each packet comes that much later."""
    return lambda _: lambda data: [(seconds, data)]


def doubled(_: random.Random) -> Bend:
    """Each packet comes three times."""
    return lambda data: [(0.0, data), (0.0, data), (0.03, data)]


def replayed(flight: Flight) -> None:
    """All that the autopilot has sent so far comes again, ten times as fast, while it flies."""
    pause(FLOWN_S)
    for packet in list(flight.relay.kept[UP]):
        flight.relay.put(UP, packet)
        sleep(0.002)


def replayed_after_cut(flight: Flight) -> None:
    """The line is cut for good; then all that the autopilot had sent, the request to arm too, comes again twice."""
    pause(FLOWN_S)
    recorded = list(flight.relay.kept[UP])
    flight.relay.cut(60.0)
    pause(0.6)
    for packet in recorded * 2:
        flight.relay.put(UP, packet)
        sleep(0.005)


def poured(direction: int, total: int, seconds: float) -> Act:
    """Random bytes, evenly over a time."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S / 2)
        pour(flight, direction, total, seconds)

    return act


def pour(flight: Flight, direction: int, total: int, seconds: float, real: tuple[bytes, ...] = ()) -> int:
    """Random bytes, or packets that were real ones, in datagrams; returns how many bytes."""
    draw, began, done, k = random.Random(2), monotonic(), 0, 0
    while done < total:
        due = total * min((monotonic() - began) / seconds, 1.0)
        while done < due:
            packet = real[k % len(real)] if real else draw.randbytes(min(DATAGRAM, total - done))
            flight.relay.put(direction, packet)
            done, k = done + len(packet), k + 1
        sleep(TICK_S)
    return done


def flooded(direction: int, times: float = 10.0, seconds: float = 1.5) -> Act:
    """Frames of a recording, as many as make up a multiple of the line's usual load."""

    def act(flight: Flight) -> None:
        before, began = flight.relay.carried[direction], monotonic()
        pause(FLOWN_S)
        rate = (flight.relay.carried[direction] - before) / (monotonic() - began)
        pour(flight, direction, int(times * rate * seconds), seconds, tuple(flight.relay.kept[direction]))

    return act


def signalled(who: str, number: int, then: int | None = None, after: float = 1.0) -> Act:
    """A signal to a process, and perhaps another one later."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        process = flight.vehicle if who == "vehicle" else flight.pilot
        process.send(number)
        if then is not None:
            pause(after)
            process.send(then)

    return act


def autopilot_again(flight: Flight) -> None:
    """The autopilot is killed; when the vehicle has gone to failsafe, somebody starts another one."""
    pause(FLOWN_S)
    flight.pilot.kill()
    flight.vehicle.wait_for("failsafe: no command")
    flight.start_pilot(1.5)
    flight.armed(2)


def vehicle_again(flight: Flight) -> None:
    """The vehicle is killed, and started again: its clock begins at zero, and it has not been armed."""
    pause(FLOWN_S)
    flight.vehicle.kill()
    flight.start_vehicle(1.0)
    flight.pilot.wait_for("heard again")
    pause(1.0)
    for one in (flight.pilot, flight.vehicle):
        one.send(signal.SIGINT)


def writer_killed(who: str) -> Act:
    """The process that writes a log is killed."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        process = flight.vehicle if who == "vehicle" else flight.pilot
        for child in process.children("stream_writer"):
            os.kill(child, signal.SIGKILL)

    return act


def unplugged(which: int, seconds: float) -> Act:
    """A serial device is gone for a while."""

    def act(flight: Flight) -> None:
        assert isinstance(flight.ends, Terminals)
        pause(FLOWN_S)
        flight.ends.unplug(which)
        pause(seconds)
        flight.ends.plug(which)

    return act


def stranger(signed: bool) -> Act:
    """Somebody without the key asks, a hundred times, to disarm."""

    def act(flight: Flight) -> None:
        pause(FLOWN_S)
        key = passphrase_key("another-key-than-that-of-the-vehicle") if signed else None
        link = open_link(flight.ends.listen)
        end = Endpoint(flight.known.dialect, *INJECTOR, key, unsigned=not signed, datagrams=True)
        asked = {"command": Order.ARM, "param1": 0.0, "target_system": 1, "target_component": 1}
        for _ in range(100):
            link.send(end.pack("COMMAND_LONG", asked))
            sleep(0.01)
        link.close()

    return act


def nothing(_: Flight) -> None:
    """A flight as it should be."""


BOTH = UP, DOWN
