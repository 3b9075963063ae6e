"""Virtual vehicle that replaces the physics of ArduPilot's SITL. The servo pulses in ArduPilot's frames move the
vehicle, and each frame is answered with the vehicle's motion.

Virtual time advances only when a frame arrives, so neither ArduPilot nor the vehicle waits for a clock. A repeated
frame gets the same answer again. If frames are missing, the vehicle flies with the last received pulses. If the frame
count restarts, a new flight begins. Source: docs page, ArduPilot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.record import Quantity
from trimtab.core.time import UNITS_PER_SECOND, ms, to_seconds
from trimtab.flight.stacks.ardupilot_json import COUNTS, PulsePacket, format_state, parse_servos
from trimtab.flight.stacks.physics_log import PhysicsFlights, PhysicsSummary
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.flight.transports.udp import UdpLink
from trimtab.loop.scenario import Scenario

LISTEN_S = 0.1
"""Longest time (s) to wait for a packet before `stop` is called again."""
SILENCE_S = 2.0
"""Time (s) without a frame after which another sender is accepted, because ArduPilot uses a new port after a
restart."""
LATE_FRAMES, FIRST_COUNTS = 16, 2
"""Limits of the frame count of a packet. If the count decreases by at most LATE_FRAMES, the packet is late. If it
decreases by more, or to a count below FIRST_COUNTS, ArduPilot has restarted.
"""

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": (
        "?",
        Quantity(
            "1",
            "True while the vehicle is held in place, until its servo pulses leave their rest position.",
            kind="flag",
        ),
    ),
    "ardupilot.frame": ("i8", Quantity("1", "Frame count of ArduPilot's newest frame.", kind="count")),
    "ardupilot.missed": (
        "i8",
        Quantity("1", "Number of frames missed so far, counted from gaps in the frame counts.", kind="count"),
    ),
    "ardupilot.repeated": ("i8", Quantity("1", "Number of repeated frames so far.", kind="count")),
    "ardupilot.refused": (
        "i8",
        Quantity(
            "1", "Number of packets refused so far because they are invalid or from another sender.", kind="count"
        ),
    ),
}
"""Signals of the vehicle's log, in addition to the signals of the simulated world."""


@dataclass
class FrameTally:
    """Counts of received packets of each kind. foreign: packets from another sender.  late: packets older than a frame
    that was already used."""

    frames: int = 0
    repeated: int = 0
    missed: int = 0
    late: int = 0
    malformed: int = 0
    foreign: int = 0


class ArduPilotPhysics:
    """Virtual vehicle that answers ArduPilot's frames. The method `serve` runs the vehicle."""

    def __init__(
        self, scenario: Scenario, vehicle: PulsedVehicle, link: UdpLink, *, seed: int = 0, clock: Clock = SYSTEM_CLOCK
    ) -> None:
        """Prepare one run of `serve`.

        Args:
            scenario: scenario of the vehicle, for its log.
            vehicle: vehicle that ArduPilot flies.
            link: listening end of the link to ArduPilot.
            seed: seed of the vehicle, for its log.
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
        lost_lines: Callable[[], int] = lambda: 0,
    ) -> PhysicsSummary:
        """Answer ArduPilot's frames until `duration` (100 ns) after the release, or until stop() returns True.

        Args:
            duration: time (100 ns) from the vehicle's release to the end, or None to run until stop() returns True.
            log: path of the log. The log of a second flight is called NAME-2, and so on.
            log_period: time between rows (100 ns).
            stop: function called at every packet, and ten times a second. If it returns True, the run ends.
            tell: function that receives the messages for the user.
            lost_lines: function that returns the number of messages to the user that were lost. It is called at the
                end.
        """
        flights = self._flights
        flights.prepare(log, tell, log_period)
        try:
            while not (stop() or flights.problems or self._is_over(duration)):
                packet = self.link.receive(LISTEN_S)
                if packet is not None:
                    self._handle_packet(packet)
        finally:
            flights.close(lost_lines())
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
        """Advance the vehicle by a frame. Return True if the frame must be answered. A late frame is not answered."""
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
        """Advance the vehicle by `ahead` frames, of which only the last frame has arrived.

        If frames are missing, time advances by at most one second.
        """
        vehicle, step, lost = self.vehicle, UNITS_PER_SECOND // frame.rate, max(ahead - 1, 0)
        self.tally.frames += 1
        self.tally.missed += lost
        if lost:
            self._flights.report_once("frames of ArduPilot were lost: the vehicle kept the last pulses")
        for _ in range(min(lost, frame.rate)):
            vehicle.advance(vehicle.body.t + step, self._write_row)
        self._last = frame
        vehicle.set_pulses(frame.pulses)
        vehicle.advance(vehicle.body.t + (step if ahead else 0), self._write_row)
        state = vehicle.state()
        if not state.is_finite:
            problem = f"the motion is not finite, {to_seconds(vehicle.body.t):g} s into the flight"
            self._flights.add_problem(problem)
        self._answer = format_state(to_seconds(vehicle.body.t), state)

    def _begin_flight(self, frame: PulsePacket) -> None:
        """Reset the vehicle to its initial state, and start a new log."""
        self._flights.begin(f"ArduPilot at {_name(self._owner)}, from frame {frame.number} on, {frame.rate} Hz")

    def _write_row(self, t: int) -> None:
        """Write the log row of the last instant before t."""
        tally, count = self.tally, 0 if self._last is None else self._last.number
        is_held, refused = self.vehicle.release_time is None, tally.malformed + tally.foreign
        self._flights.write_row(t, (is_held, count, tally.missed, tally.repeated, refused))


def _name(place: Any) -> str:
    """Return the host and the port of an address as text."""
    return f"{place[0]}:{place[1]}"
