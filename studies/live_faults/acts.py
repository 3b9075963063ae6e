"""What is done to a flight: to its line, to its processes, and by strangers."""

import random
import signal
from collections.abc import Callable

from studies.live_faults.flight import INJECTOR, FaultFlight
from studies.live_faults.relay import DOWN, UP, Bend, Terminals
from trimtab.wire.keys import passphrase_key
from trimtab.wire.protocol import CommandCode

TICK_S = 0.01
DATAGRAM = 1000
Act = Callable[[FaultFlight], None]
Prepare = Callable[[FaultFlight], dict[str, dict[str, str]]]
"""Prepares a flight; gives environments, by process: "vehicle" or "autopilot"."""


def inject_fault(text: str) -> Act:
    """A fault word, put in live."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.inject_fault(text)

    return act


def cut_line(seconds: float) -> Act:
    """Nothing passes, either way."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.relay.cut_line(seconds)

    return act


def bend_packets(direction: int, make: Callable[[random.Random], Bend], seconds: float = 1.5) -> Act:
    """Each packet one way becomes something else for a while."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.relay.bend[direction] = make(random.Random(1))
        flight.let_fly(seconds)
        flight.relay.bend.pop(direction)

    return act


def bend_both_ways(make: Callable[[random.Random], Bend], seconds: float) -> Act:
    """Each packet either way becomes something else for a while."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        for direction in (UP, DOWN):
            flight.relay.bend[direction] = make(random.Random(direction))
        flight.let_fly(seconds)
        for direction in (UP, DOWN):
            flight.relay.bend.pop(direction)

    return act


def spoil_packets(loss: float, late: float) -> Callable[[random.Random], Bend]:
    """Packets are lost, one in twenty comes twice, and each comes up to `late` seconds later."""

    def make(draw: random.Random) -> Bend:
        def bend(data: bytes) -> list[tuple[float, bytes]]:
            if draw.random() < loss:
                return []
            return [(draw.uniform(0.0, late), data) for _ in range(2 if draw.random() < 0.05 else 1)]

        return bend

    return make


def truncate_packets(draw: random.Random) -> Bend:
    """Three in four packets end too soon."""
    return lambda data: [(0.0, data[: draw.randrange(len(data))] if draw.random() < 0.75 else data)]


def flip_bits(draw: random.Random) -> Bend:
    """One bit of three in four packets is another."""

    def bend(data: bytes) -> list[tuple[float, bytes]]:
        if draw.random() < 0.75:
            bit = draw.randrange(8 * len(data))
            data = data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
        return [(0.0, data)]

    return bend


def drop_half(draw: random.Random) -> Bend:
    """Half of the packets are lost."""
    return lambda data: [(0.0, data)] if draw.random() < 0.5 else []


def shuffle_packets(draw: random.Random) -> Bend:
    """Each packet comes up to 100 ms later, so that they overtake each other."""
    return lambda data: [(draw.uniform(0.0, 0.1), data)]


def delay_packets(seconds: float) -> Callable[[random.Random], Bend]:
    """Each packet comes that much later."""
    return lambda _: lambda data: [(seconds, data)]


def repeat_packets(_: random.Random) -> Bend:
    """Each packet comes three times."""
    return lambda data: [(0.0, data), (0.0, data), (0.03, data)]


def replay_packets(flight: FaultFlight) -> None:
    """All that the autopilot has sent so far comes again, ten times as fast, while it flies."""
    flight.let_fly(flight.undisturbed_s)
    for packet in list(flight.relay.recent_packets[UP]):
        flight.relay.send_bytes(UP, packet)
        flight.pause(0.002)


def replay_after_cut(flight: FaultFlight) -> None:
    """The line is cut for good; then all that the autopilot had sent, the request to arm too, comes again twice."""
    flight.let_fly(flight.undisturbed_s)
    recorded = list(flight.relay.recent_packets[UP])
    flight.relay.cut_line(60.0)
    flight.let_fly(0.6)
    for packet in recorded * 2:
        flight.relay.send_bytes(UP, packet)
        flight.pause(0.005)


def pour_garbage(direction: int, total: int, seconds: float) -> Act:
    """Random bytes, evenly over a time."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s / 2)
        send_stream(flight, direction, total, seconds)

    return act


def send_stream(flight: FaultFlight, direction: int, total: int, seconds: float, real: tuple[bytes, ...] = ()) -> int:
    """Random bytes, or packets that were real ones, in datagrams; returns how many bytes."""
    draw, began, done, k = random.Random(2), flight.now(), 0, 0
    while done < total:
        due = total * min((flight.now() - began) / seconds, 1.0)
        while done < due:
            packet = real[k % len(real)] if real else draw.randbytes(min(DATAGRAM, total - done))
            flight.relay.send_bytes(direction, packet)
            done, k = done + len(packet), k + 1
        flight.pause(TICK_S)
    return done


def flood_line(direction: int, times: float = 10.0, seconds: float = 1.5) -> Act:
    """Frames of a recording, as many as make up a multiple of the line's usual load."""

    def act(flight: FaultFlight) -> None:
        before, began = flight.relay.byte_counts[direction], flight.now()
        flight.let_fly(flight.undisturbed_s)
        rate = (flight.relay.byte_counts[direction] - before) / (flight.now() - began)
        send_stream(
            flight, direction, int(times * rate * seconds), seconds, tuple(flight.relay.recent_packets[direction])
        )

    return act


def send_signal(who: str, number: int, then: int | None = None, after: float = 1.0) -> Act:
    """A signal to a process, and perhaps another one later."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        process = flight.vehicle if who == "vehicle" else flight.autopilot
        process.send(number)
        if then is not None:
            flight.let_fly(after)
            process.send(then)

    return act


def restart_autopilot(flight: FaultFlight) -> None:
    """The autopilot is killed; with the vehicle in failsafe somebody starts another one, and confirms nothing."""
    flight.let_fly(flight.undisturbed_s)
    flight.autopilot.kill()
    flight.vehicle.wait_for("failsafe: no command")
    flight.start_autopilot(1.5)
    flight.vehicle.wait_for("arming refused: confirmation")
    flight.let_fly(1.0)
    flight.vehicle.send(signal.SIGINT)


def restart_vehicle(flight: FaultFlight) -> None:
    """The vehicle is killed, and started again: its clock begins at zero, and it has not been armed."""
    flight.let_fly(flight.undisturbed_s)
    flight.vehicle.kill()
    flight.start_vehicle(1.0)
    flight.autopilot.wait_for("from the vehicle again")
    flight.let_fly(1.0)
    for one in (flight.autopilot, flight.vehicle):
        one.send(signal.SIGINT)


def kill_child(who: str, word: str) -> Act:
    """A process that an end has started is killed. word: in its command line."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        process = flight.vehicle if who == "vehicle" else flight.autopilot
        process.kill_child(word)

    return act


def kill_writer(who: str) -> Act:
    """The process that writes a log is killed."""
    return kill_child(who, "stream_writer")


def prepare_clock(who: str, seconds: int) -> Prepare:
    """A process whose wall clock jumps at `step_clocks`."""
    return lambda flight: {who: flight.prepare_clock(seconds)}


def step_clocks(flight: FaultFlight) -> None:
    """The wall clock jumps, and stays there."""
    flight.let_fly(flight.undisturbed_s)
    flight.step_clocks()


def prepare_disk(name: str) -> Prepare:
    """A small disk, where a process writes its log."""

    def prepare(flight: FaultFlight) -> dict[str, dict[str, str]]:
        flight.prepare_disk(name)
        return {}

    return prepare


def fill_disk(name: str, free_after: float | None) -> Act:
    """All that is left of the small disk is taken, and perhaps given back."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.fill_disk(name)
        if free_after is not None:
            flight.let_fly(free_after)
            flight.free_disk(name)

    return act


def unplug_device(which: int, seconds: float) -> Act:
    """A serial device is gone for a while."""

    def act(flight: FaultFlight) -> None:
        assert isinstance(flight.ends, Terminals)
        flight.let_fly(flight.undisturbed_s)
        flight.ends.unplug_device(which)
        flight.let_fly(seconds)
        flight.ends.plug_device(which)

    return act


def disarm_without_key(signed: bool) -> Act:
    """Somebody without the key asks, a hundred times, to disarm."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        key = passphrase_key("another-key-than-that-of-the-vehicle") if signed else None
        link, end = flight.join_line(*INJECTOR, key)
        asked = {"command": CommandCode.ARM, "param1": 0.0, "target_system": 1, "target_component": 1}
        for _ in range(100):
            link.send(end.pack("COMMAND_LONG", asked))
            flight.pause(0.01)
        link.close()

    return act


def do_nothing(_: FaultFlight) -> None:
    """A flight as it should be."""


BOTH = UP, DOWN
