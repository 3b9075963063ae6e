"""A virtual vehicle in wall-clock time, behind a real transport, with its firmware's duties.

Source: docs page, Vehicle.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.compiler.compiled_block import compile_block
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity, replace
from trimtab.core.time import ms
from trimtab.links.wire import Wire
from trimtab.live.duties import STATION_MODES, Duties, FlightRequests
from trimtab.live.exchange import GroupSample, command_group
from trimtab.live.flight_log import WRITER_DIED, FlightLog, LogSource, count_frames, frame_signals, open_flight_log
from trimtab.live.instruments import Instruments
from trimtab.live.real_time import NS, Histogram, WallClock, discard_packets, real_time
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import choose_failsafe, compile_world, uplink_block
from trimtab.wire.dialect import Dialect, derive_dialect
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.parameters import Parameters
from trimtab.wire.protocol import ArmRequest, ParameterChange, Severity
from trimtab.wire.station import Station
from trimtab.wire.telemetry import mav_type

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": ("?", Quantity("1", "The vehicle is held: it has not been armed yet.", kind="flag")),
    "firmware.late": ("f8", Quantity("s", "From the instant to its being worked on.")),
    **frame_signals("wire"),
}
"""What a row of the vehicle's log has besides the world's and the failsafe's."""
DISARM_DELAY = ms(50)
"""How long it goes on after it was disarmed at its end: two frames of its servos and a little."""


class VehicleSummary(NamedTuple):
    """What became of a virtual vehicle. release_time: when it was first armed (100 ns), None if never."""

    t: int
    release_time: int | None
    mode: str
    cause: str
    lateness: Histogram
    log: LogFileSummary | None


class LiveVehicle:
    """A world, its duties and its end of a line; `serve` runs it."""

    def __init__(
        self, scenario: Scenario, link: Link, endpoint: Callable[[Dialect], Endpoint], *, seed: int = 0
    ) -> None:
        """Compile it. endpoint: makes the vehicle's end for a dialect."""
        self.scenario, self.link, self.seed = scenario, link, seed
        uplink, bare = scenario.world.uplink, replace(scenario, world=replace(scenario.world, uplink=Wire()))
        world, frame, command = compile_world(bare, seed=seed)
        dialect = derive_dialect(frame, command)
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(bare, dialect, world)
        failsafe = choose_failsafe(scenario, command)
        received = None if isinstance(uplink, Wire) else compile_block(uplink_block(uplink, command, seed=seed))
        self.duties = Duties(failsafe, command, world, received)
        self.instruments = Instruments(self.body, failsafe, self.endpoint, lambda: self.duties.is_commanded)
        self._command = command_group(dialect, self.duties.slot)
        parameters = Parameters(scenario.world, "world")
        self._declared = {p.path: p.declaration for p in parameters.listed}
        kind, streams = mav_type(scenario.world.vehicle), self.instruments.telemetry_streams()
        self.station = Station(self.endpoint, parameters, STATION_MODES, vehicle=kind, streams=streams)
        self.requests = FlightRequests(self.endpoint, lambda text: self._announce(Severity.NOTICE, text))
        self.clock = WallClock()
        self.lateness = Histogram()
        self.release_time: int | None = None
        self._newest_command: GroupSample | None = None
        self._flight_log: FlightLog | None = None
        self._tell: Callable[[str], None] = lambda _: None

    def _handle_data(self, data: bytes) -> None:
        now, messages = self.clock.now(), self.endpoint.feed(data)
        if messages:
            self.link.accept_sender()
        for message in messages:
            if message.name in self._command.names:
                command = self._command.assemble(message)
                if command is not None and (self._newest_command is None or command.t >= self._newest_command.t):
                    self._newest_command = command
                continue
            self.requests.handle_message(message, now)
            handled = self.station.handle_message(message, now)
            for packet in handled.replies:
                self.link.send(packet)
            for event in handled.events:
                if isinstance(event, ParameterChange):
                    self._set_parameter(event)
                else:
                    self.duties.handle_event(event, now)
                    self.requests.handle_event(event, now)
                    self.instruments.handle_event(event, now)

    def _set_parameter(self, event: ParameterChange) -> None:
        uplink, path = self.duties.uplink, event.path.removeprefix("world.")
        step = self.body.world if uplink is None or path not in uplink.parameters else uplink
        step.parameters[event.path if step is self.body.world else path].flat[event.slot] = event.value
        self._report(f"{event.path} = {format_value(self._declared[event.path], event.value)}")

    def _report(self, text: str) -> None:
        """A line into the log and to people."""
        now = self.clock.now()
        self._tell(f"{now * 1e-7:9.3f} s  {text}")
        if self._flight_log is not None:
            self._flight_log.write_event(text)

    def serve(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        log_period: int = 10_000,
        wanted_real_time: bool = False,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> VehicleSummary:
        """Run until `duration` (100 ns) after its release, or until stop() says so; it disarms first.

        Args:
            duration: None runs on without end.
            log: file of the vehicle's own log, with the truth.
            log_period: how often a row is written.
            wanted_real_time: ask the system for real-time scheduling and locked memory.
            stop: asked at every instant.
            tell: is given lines for people.
        """
        self._tell = tell
        failsafe = self.duties.step
        decisions = LogSource(failsafe.outputs, failsafe.text.outputs, lambda p: f"firmware.{p}")
        sources = [*self.body.log_sources(), decisions]
        flight_log = self._flight_log = open_flight_log(
            log, sources, OWN_SIGNALS, self.scenario, side="vehicle", seed=self.seed, log_period=log_period
        )
        discard_packets(self.link)
        try:
            with real_time(wanted_real_time):
                self._run_loop(duration, log_period, stop)
        finally:
            self._flight_log = None
            summary = flight_log.close(self.body.final_truth()) if flight_log else None
        if flight_log is not None and summary is None:
            tell(WRITER_DIED)
        return VehicleSummary(self.body.t, self.release_time, *self.duties.mode, self.lateness, summary)

    def _run_loop(self, duration: int | None, log_period: int, stop: Callable[[], bool]) -> None:
        self.clock, last = WallClock(), None
        for t in self.body.instants():
            why = self._end_reason(t, duration, stop) if last is None else ""
            if why:
                self._report(why)
                last = t + (DISARM_DELAY if self.duties.is_commanded else 0)
                self.duties.handle_event(ArmRequest(False), t)
            if last is not None and t >= last:
                break
            self._run_instant(t, log_period)

    def _end_reason(self, t: int, duration: int | None, stop: Callable[[], bool]) -> str:
        """Why it is to end now; empty: it isn't."""
        if stop():
            return "ended by request"
        over = duration is not None and self.release_time is not None and t - self.release_time >= duration
        return "ended, its time is over" if over else ""

    def _run_instant(self, t: int, log_period: int) -> None:
        flight_log = self._flight_log
        woke = self.clock.wait(t, self.link, self._handle_data)
        late = woke - self.clock.start - t * NS
        self.lateness.add(late)
        self.body.advance(t, fresh=True, is_held=self.release_time is None)
        for packet in self.body.sample_packets(self.endpoint, self.body.changed_sensors()):
            self.link.send(packet)
        if flight_log is not None and t and self.body.row_t % log_period == 0:
            own = (self.release_time is None, late * 1e-9, *count_frames(self.endpoint.counts))
            flight_log.write_row(self.body.row_t, own)
        command, self._newest_command = self._newest_command, None
        if self.duties.act(t, command):
            self._announce_mode(t)
        self.station.status = self.requests.status(self.duties.status, t)
        for packet in self.station.due(t) + self.requests.due(t):
            self.link.send(packet)

    def _announce_mode(self, t: int) -> None:
        if self.release_time is None and self.duties.is_commanded:
            self.release_time = t
        text = f"{self.duties.mode.mode}: {self.duties.mode.cause}"
        severity = Severity.CRITICAL if self.duties.mode.mode == "failsafe" else Severity.NOTICE
        self._announce(severity, text)

    def _announce(self, severity: Severity, text: str) -> None:
        """A line to ground stations, into the log and to people."""
        self.station.queue_text(severity, text)
        self._report(text)


def format_value(declared: Quantity, value: float) -> str:
    """A number as people read it: a mode by its name."""
    return declared.modes[int(value)] if declared.modes else f"{value:g}"
