"""Acts on a flight: on its link, on its processes, and by attackers."""

import random
import signal
from collections.abc import Callable

from studies.live_faults.flight import INJECTOR, FaultFlight
from studies.live_faults.relay import DOWN, UP, Bend, Terminals
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.mavlink.protocol import CommandCode

TICK_S = 0.01
DATAGRAM = 1000
RESTART_S = 0.5
"""Time from the end of a killed vehicle to its next start (s). In virtual time a program starts at once."""
Act = Callable[[FaultFlight], None]
Prepare = Callable[[FaultFlight], dict[str, dict[str, str]]]
"""Function that prepares a flight and returns environment variables by process, "vehicle" or "autopilot"."""


def inject_fault(text: str) -> Act:
    """Return an act that injects a fault of a given kind in flight."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.inject_fault(text)

    return act


def cut_line(seconds: float) -> Act:
    """Return an act that blocks the link both ways."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.relay.cut_line(seconds)

    return act


def bend_packets(direction: int, make: Callable[[random.Random], Bend], seconds: float = 1.5) -> Act:
    """Return an act that changes each packet of one direction for a while."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        bend = make(random.Random(1))
        flight.relay.bends[direction].append(bend)
        flight.let_fly(seconds)
        flight.relay.bends[direction].remove(bend)

    return act


def bend_both_ways(make: Callable[[random.Random], Bend], seconds: float) -> Act:
    """Return an act that changes each packet of both directions for a while."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        bends = {direction: make(random.Random(direction)) for direction in (UP, DOWN)}
        for direction, bend in bends.items():
            flight.relay.bends[direction].append(bend)
        flight.let_fly(seconds)
        for direction, bend in bends.items():
            flight.relay.bends[direction].remove(bend)

    return act


def spoil_packets(loss: float, late: float) -> Callable[[random.Random], Bend]:
    """Return a packet change that loses packets, repeats one in twenty, and delays each by up to `late` seconds."""

    def make(draw: random.Random) -> Bend:
        def bend(data: bytes) -> list[tuple[float, bytes]]:
            if draw.random() < loss:
                return []
            return [(draw.uniform(0.0, late), data) for _ in range(2 if draw.random() < 0.05 else 1)]

        return bend

    return make


def truncate_packets(draw: random.Random) -> Bend:
    """Return a packet change that cuts three in four packets short."""
    return lambda data: [(0.0, data[: draw.randrange(len(data))] if draw.random() < 0.75 else data)]


def flip_bits(draw: random.Random) -> Bend:
    """Return a packet change that flips one bit in three of four packets."""

    def bend(data: bytes) -> list[tuple[float, bytes]]:
        if draw.random() < 0.75:
            bit = draw.randrange(8 * len(data))
            data = data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
        return [(0.0, data)]

    return bend


def drop_half(draw: random.Random) -> Bend:
    """Return a packet change that loses half of the packets."""
    return lambda data: [(0.0, data)] if draw.random() < 0.5 else []


def shuffle_packets(draw: random.Random) -> Bend:
    """Return a packet change that delays each packet by up to 100 ms, so that packets overtake each other."""
    return lambda data: [(draw.uniform(0.0, 0.1), data)]


def delay_packets(seconds: float) -> Callable[[random.Random], Bend]:
    """Return a packet change that delays each packet by this time."""
    return lambda _: lambda data: [(seconds, data)]


def repeat_packets(_: random.Random) -> Bend:
    """Return a packet change that sends each packet three times."""
    return lambda data: [(0.0, data), (0.0, data), (0.03, data)]


def replay_packets(flight: FaultFlight) -> None:
    """Replay everything that the autopilot has sent so far, ten times as fast, in flight."""
    flight.let_fly(flight.undisturbed_s)
    for packet in list(flight.relay.recent_packets[UP]):
        flight.relay.send_bytes(UP, packet)
        flight.pause(0.002)


def replay_after_cut(flight: FaultFlight) -> None:
    """Cut the link for good, then replay twice everything that the autopilot had sent, with the request to arm."""
    flight.let_fly(flight.undisturbed_s)
    recorded = list(flight.relay.recent_packets[UP])
    flight.relay.cut_line(60.0)
    flight.let_fly(0.6)
    for packet in recorded * 2:
        flight.relay.send_bytes(UP, packet)
        flight.pause(0.005)


def pour_garbage(direction: int, total: int, seconds: float) -> Act:
    """Return an act that sends random bytes, evenly over a time."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s / 2)
        send_stream(flight, direction, total, seconds)

    return act


def send_stream(flight: FaultFlight, direction: int, total: int, seconds: float, real: tuple[bytes, ...] = ()) -> int:
    """Send random bytes, or recorded packets, in datagrams. Return the number of bytes."""
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
    """Return an act that sends recorded frames at a multiple of the link's usual load."""

    def act(flight: FaultFlight) -> None:
        before, began = flight.relay.byte_counts[direction], flight.now()
        flight.let_fly(flight.undisturbed_s)
        rate = (flight.relay.byte_counts[direction] - before) / (flight.now() - began)
        send_stream(
            flight, direction, int(times * rate * seconds), seconds, tuple(flight.relay.recent_packets[direction])
        )

    return act


def send_signal(who: str, number: int, then: int | None = None, after: float = 1.0) -> Act:
    """Return an act that sends a signal to a process, and optionally another one later."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        process = flight.vehicle if who == "vehicle" else flight.autopilot
        process.send(number)
        if then is not None:
            flight.let_fly(after)
            process.send(then)

    return act


def restart_autopilot(flight: FaultFlight) -> None:
    """Kill the autopilot. Once the vehicle is in failsafe, start another autopilot without a confirmation."""
    flight.let_fly(flight.undisturbed_s)
    flight.autopilot.kill()
    flight.vehicle.wait_for("failsafe: no command")
    flight.start_autopilot(1.5)
    flight.vehicle.wait_for("arming refused: confirmation")
    flight.let_fly(1.0)
    flight.vehicle.send(signal.SIGINT)


def restart_vehicle(flight: FaultFlight) -> None:
    """Kill the vehicle and start it again. Its clock starts at zero, and it has not been armed."""
    flight.let_fly(flight.undisturbed_s)
    flight.vehicle.kill()
    flight.let_fly(RESTART_S)
    flight.start_vehicle(1.0)
    flight.autopilot.wait_for("from the vehicle again")
    flight.let_fly(1.0)
    for one in (flight.autopilot, flight.vehicle):
        one.send(signal.SIGINT)


def kill_child(who: str, word: str) -> Act:
    """Return an act that kills a child process of the vehicle or autopilot. word: text in the child's command line."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        process = flight.vehicle if who == "vehicle" else flight.autopilot
        process.send_child(word, signal.SIGKILL)

    return act


def freeze_child(who: str, word: str, seconds: float) -> Act:
    """Return an act that stops a child process of the vehicle or autopilot for a while.

    word: text in its command line.
    """

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        process = flight.vehicle if who == "vehicle" else flight.autopilot
        process.send_child(word, signal.SIGSTOP)
        flight.let_fly(seconds)
        process.send_child(word, signal.SIGCONT)

    return act


def kill_writer(who: str) -> Act:
    """Return an act that kills the process that writes a log."""
    return kill_child(who, "stream_writer")


def prepare_clock(who: str, seconds: int) -> Prepare:
    """Return a function that prepares a process for a jump of its wall clock at `step_clocks`."""
    return lambda flight: {who: flight.prepare_clock(seconds)}


def step_clocks(flight: FaultFlight) -> None:
    """Make the wall clock jump, and keep the offset."""
    flight.let_fly(flight.undisturbed_s)
    flight.step_clocks()


def prepare_disk(name: str) -> Prepare:
    """Return a function that prepares a small disk for the log of a process."""

    def prepare(flight: FaultFlight) -> dict[str, dict[str, str]]:
        flight.prepare_disk(name)
        return {}

    return prepare


def fill_disk(name: str, free_after: float | None) -> Act:
    """Return an act that fills the small disk, and optionally frees it again."""

    def act(flight: FaultFlight) -> None:
        flight.let_fly(flight.undisturbed_s)
        flight.fill_disk(name)
        if free_after is not None:
            flight.let_fly(free_after)
            flight.free_disk(name)

    return act


def unplug_device(which: int, seconds: float) -> Act:
    """Return an act that removes a serial device for a while."""

    def act(flight: FaultFlight) -> None:
        assert isinstance(flight.ends, Terminals)
        flight.let_fly(flight.undisturbed_s)
        flight.ends.unplug_device(which)
        flight.let_fly(seconds)
        flight.ends.plug_device(which)

    return act


def disarm_without_key(signed: bool) -> Act:
    """Return an act that asks to disarm a hundred times without the key."""

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
    """Do nothing: an undisturbed flight."""


BOTH = UP, DOWN
