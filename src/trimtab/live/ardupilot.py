"""A virtual vehicle as the physics of ArduPilot's SITL: it moves by ArduPilot's frames, and answers with its motion.

Virtual time stands still between two frames, so that neither side waits for a clock. A frame that comes again is
answered as before; frames that were lost are flown under the pulses of before; a count that begins anew begins another
flight.
Source: docs page, ArduPilot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.record import Quantity
from trimtab.core.time import UNITS_PER_SECOND, ms, to_seconds
from trimtab.links.udp import UdpLink
from trimtab.live.physics_log import PhysicsFlights, PhysicsSummary
from trimtab.live.pulsed_vehicle import PulsedVehicle
from trimtab.loop.scenario import Scenario
from trimtab.wire.ardupilot_json import COUNTS, PulsePacket, format_state, parse_servos

LISTEN_S = 0.1
"""How long a packet is waited for before somebody may ask it to end."""
SILENCE_S = 2.0
"""Without a frame for so long, another sender may take its place: ArduPilot started again has another port."""
LATE_FRAMES, FIRST_COUNTS = 16, 2
"""A count that goes back by no more is a packet that came late; by more, or to the first ones, it begins anew."""

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": ("?", Quantity("1", "The vehicle is held: its pulses have not left their rest yet.", kind="flag")),
    "ardupilot.frame": ("i8", Quantity("1", "Count of ArduPilot's frame that acts.", kind="count")),
    "ardupilot.missed": ("i8", Quantity("1", "Frames so far that never came, by their counts.", kind="count")),
    "ardupilot.repeated": ("i8", Quantity("1", "Frames so far that came again.", kind="count")),
    "ardupilot.refused": ("i8", Quantity("1", "Packets so far that were no frame of its autopilot's.", kind="count")),
}
"""What a row of its log has besides the world's."""


@dataclass
class FrameTally:
    """How many packets came, and what they were. foreign: of another sender.  late: older than one that was flown."""

    frames: int = 0
    repeated: int = 0
    missed: int = 0
    late: int = 0
    malformed: int = 0
    foreign: int = 0


class ArduPilotPhysics:
    """A vehicle that answers ArduPilot's frames; `serve` runs it."""

    def __init__(
        self, scenario: Scenario, vehicle: PulsedVehicle, link: UdpLink, *, seed: int = 0, clock: Clock = SYSTEM_CLOCK
    ) -> None:
        """Prepare one `serve`.

        Args:
            scenario: of the vehicle, for its log.
            vehicle: the vehicle.
            link: that ArduPilot sends to.
            seed: of the vehicle, for its log.
            clock: clock of this process.
        """
        self.scenario, self.vehicle, self.link, self.seed, self._clock = scenario, vehicle, link, seed, clock
        self.tally = FrameTally()
        self._flights = PhysicsFlights(scenario, vehicle, OWN_SIGNALS, seed=seed)
        self._owner, self._heard = None, 0.0
        self._last: PulsePacket | None = None
        self._answer = b""

    def serve(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        log_period: int = ms(1),
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> PhysicsSummary:
        """Answer until `duration` (100 ns) after it was let go, or until stop() says so.

        Args:
            duration: None runs on without end.
            log: file of its log; that of a second flight is called NAME-2, and so on.
            log_period: how often a row is written.
            stop: asked at every packet, and ten times a second.
            tell: is given lines for people.
        """
        flights = self._flights
        flights.file, flights.period, flights.tell = log, log_period, tell
        try:
            while not (stop() or flights.problems or self._is_over(duration)):
                packet = self.link.receive(LISTEN_S)
                if packet is not None:
                    self._handle_packet(packet)
        finally:
            flights.close()
        return flights.summarise(self.tally)

    def _is_over(self, duration: int | None) -> bool:
        release = self.vehicle.release_time
        return duration is not None and release is not None and self.vehicle.body.t - release >= duration

    def _handle_packet(self, packet: bytes) -> None:
        frame, now, sender = parse_servos(packet), self._clock.monotonic_ns() / NS_PER_SECOND, self.link.sender
        if isinstance(frame, str):
            self.tally.malformed += 1
            self._flights.report_once(f"refused a packet: {frame}")
            return
        if sender != self._owner:
            if self._owner is not None and now - self._heard < SILENCE_S:
                self.tally.foreign += 1
                self._flights.report_once(
                    f"refused frames from {_name(sender)}: {_name(self._owner)} flies the vehicle"
                )
                return
            self._owner, self._last = sender, None
        self._heard = now
        self.link.accept_sender()
        if self._follow(frame) and not self._flights.problems:
            self.link.reply(self._answer)

    def _follow(self, frame: PulsePacket) -> bool:
        """Move by what a frame says; whether it is to be answered, which a frame that comes too late isn't."""
        ahead = 0 if self._last is None else (frame.number - self._last.number) % COUNTS
        if self._last is not None and ahead == 0:
            self.tally.repeated += 1
            return True
        if ahead > COUNTS // 2 and COUNTS - ahead <= LATE_FRAMES and frame.number >= FIRST_COUNTS:
            self.tally.late += 1
            return False
        if self._last is None or ahead > COUNTS // 2:
            self._begin_flight(frame)
            ahead = 0
        self._move(frame, ahead)
        return True

    def _move(self, frame: PulsePacket, ahead: int) -> None:
        """On by so many frames, of which only the last has come; a gap longer than a second is flown for one."""
        vehicle, step, lost = self.vehicle, UNITS_PER_SECOND // frame.rate, max(ahead - 1, 0)
        self.tally.frames += 1
        self.tally.missed += lost
        if lost:
            self._flights.report_once("frames of ArduPilot's were lost: they are flown under the pulses before them")
        for _ in range(min(lost, frame.rate)):
            vehicle.advance(vehicle.body.t + step, self._write_row)
        self._last = frame
        vehicle.set_pulses(frame.pulses)
        vehicle.advance(vehicle.body.t + (step if ahead else 0), self._write_row)
        state = vehicle.state()
        if not state.is_finite:
            problem = f"its motion is no number any more, {to_seconds(vehicle.body.t):g} s into the flight"
            self._flights.add_problem(problem)
        self._answer = format_state(to_seconds(vehicle.body.t), state)

    def _begin_flight(self, frame: PulsePacket) -> None:
        """The vehicle back at its first state, and another log."""
        self._flights.begin(f"ArduPilot at {_name(self._owner)}, from frame {frame.number} on, {frame.rate} Hz")

    def _write_row(self, t: int) -> None:
        """The row of the instant before t."""
        tally, count = self.tally, 0 if self._last is None else self._last.number
        is_held, refused = self.vehicle.release_time is None, tally.malformed + tally.foreign
        self._flights.write_row(t, (is_held, count, tally.missed, tally.repeated, refused))


def _name(place: Any) -> str:
    """Host and port of an address."""
    return f"{place[0]}:{place[1]}"
