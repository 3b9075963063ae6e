"""Virtual vehicle in wall-clock time, behind a real link, with the duties of its firmware.

Source: docs page, Vehicle.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trimtab.actuators.failsafe import BREACHES
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity, leaves, replace
from trimtab.core.time import ms
from trimtab.flight.autopilot_parameters import AutopilotRelay
from trimtab.flight.broadcast import Broadcast
from trimtab.flight.clock_refusals import RefusalAnswers
from trimtab.flight.command_gate import AUTHORITY_SIGNALS, CommandGate
from trimtab.flight.duties import STATION_MODES, Duties, FlightRequests
from trimtab.flight.exchange import GroupSample, command_group, slot_indices
from trimtab.flight.flight_log import (
    FlightRecorder,
    LogSource,
    close_flight_log,
    count_frames,
    frame_signals,
    list_log_problems,
    open_flight_log,
)
from trimtab.flight.injector import format_value
from trimtab.flight.instruments import Instruments
from trimtab.flight.machine import SYSTEM_MACHINE, Machine, list_stamp_problems
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import ArmRequest, ParameterChange, Severity
from trimtab.flight.outputs import Outputs
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.prearm import ArmingGuard
from trimtab.flight.real_time import NS, Histogram, WallClock, discard_packets
from trimtab.flight.scenario_identity import identity_path, scenario_identity
from trimtab.flight.station.identity import IdentityService
from trimtab.flight.station.parameter_metadata import component_metadata, metadata_documents
from trimtab.flight.station.parameters import Parameters
from trimtab.flight.station.standard_services import Station, Status
from trimtab.flight.station_options import StationOptions, station_services
from trimtab.flight.virtual_vehicle import VirtualVehicle, check_pace
from trimtab.links.wire import Wire
from trimtab.logs.frames import TRANSFORM_PERIOD
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import choose_failsafe, uplink_block
from trimtab.run.cosimulation import prepare_world
from trimtab.run.kept_blocks import compile_kept
from trimtab.vehicles.vehicle_type import mav_type

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": ("?", Quantity("1", "The vehicle is held in place: it has not been armed yet.", kind="flag")),
    "firmware.late": ("f8", Quantity("s", "Delay of the work at this instant.")),
    **frame_signals("wire"),
    **AUTHORITY_SIGNALS,
}
"""Signals of the vehicle's log besides those of the world and the failsafe."""
DISARM_DELAY = ms(50)
"""Time for which the vehicle keeps running after it was disarmed at its end: two servo frames and a little."""


class VehicleSummary(NamedTuple):
    """Result of a virtual vehicle. release_time, disarm_time: first armed, last disarmed (100 ns), or None."""

    t: int
    release_time: int | None
    disarm_time: int | None
    mode: str
    cause: str
    lateness: Histogram
    log: LogFileSummary | None
    problems: tuple[str, ...]
    """Problems for scripts: failsafes, outputs that went safe on their own, a lost log."""


class LiveVehicle:
    """World, duties and end of a link. `serve` runs them."""

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        endpoint: Callable[[Dialect], Endpoint],
        *,
        seed: int = 0,
        station_options: StationOptions | None = None,
        machine: Machine = SYSTEM_MACHINE,
    ) -> None:
        """Compile the vehicle.

        Args:
            scenario: scenario of the vehicle.
            link: link to its autopilot and to ground stations.
            endpoint: makes the vehicle's end for a dialect.
            seed: seed of the random numbers.
            station_options: services for ground stations.
            machine: the computer that the vehicle runs on.
        """
        options = station_options or StationOptions()
        self.scenario, self.link, self.seed = scenario, link, seed
        self._machine = machine
        uplink, bare = scenario.world.uplink, replace(scenario, world=replace(scenario.world, uplink=Wire()))
        world, frame, command = prepare_world(bare, seed=seed)
        check_pace(world, bare)
        dialect = derive_dialect(frame, command)
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(bare, dialect, world)
        failsafe = choose_failsafe(scenario, command)
        received = None if isinstance(uplink, Wire) else compile_kept(uplink_block, uplink, command, seed=seed)
        self.duties = Duties(failsafe, command, world, received)
        self.instruments = Instruments(
            self.body, failsafe, self.endpoint, lambda: self.duties.is_commanded, options.origin, machine.clock
        )
        self._command = command_group(dialect, self.duties.slot)
        safe = [(f"command.value.{p}", v) for p, v, _ in leaves(failsafe.safe)]
        self._safe_row = [float(x) for _, v in safe for x in np.ravel(np.asarray(v, float))]
        self._row_slots = slot_indices(self.body.world.reads, [p for p, _ in safe], len(self.body.world.inputs))
        self._failsafe, self._problems = failsafe, list[str]()
        heard, radio_silence = self.endpoint.counts, self.duties.radio_silence
        self.guard = ArmingGuard(self.body, scenario.limits, failsafe, heard, radio_silence, machine.disk)
        self._outputs: Outputs | None = None
        parameters = Parameters(scenario.world, "world")
        self._declared = {p.path: p.declaration for p in parameters.listed}
        kind, streams = mav_type(scenario.world.vehicle), self.instruments.telemetry_streams()
        documents = metadata_documents(parameters)
        streams.add_on_request("COMPONENT_METADATA", lambda now: component_metadata(now // ms(1), documents))
        store = options.store or ParameterStore()
        services = [self.instruments.globe, *station_services(self.endpoint, options, documents)]
        self.station = Station(
            self.endpoint,
            parameters,
            STATION_MODES,
            vehicle=kind,
            streams=streams,
            services=services,
            store=store.write,
        )
        self.requests = FlightRequests(self.endpoint, lambda text: self._announce(Severity.NOTICE, text))
        self.station.tell = self._report
        self.station.arming_checks = lambda: self.guard.checks
        self.instruments.may_be_armed = lambda: not (self.guard.problem or self.guard.confirmation_problem)
        self.identity = IdentityService(self.endpoint, scenario_identity(scenario, dialect))
        self.broadcast = Broadcast(self.endpoint, link, self._command.names)
        self.relay = AutopilotRelay(self.endpoint, self.broadcast)
        self.gate = CommandGate(self.station, self.broadcast, lambda text: self._announce(Severity.WARNING, text))
        self.refusals = RefusalAnswers(self.endpoint, link, self._report)
        self.station.status = self._find_status()  # a request in the first packet finds that nothing was checked
        self.clock, self.lateness = WallClock(machine.clock), Histogram()
        self.release_time: int | None = None
        self.disarm_time: int | None = None
        self._newest_command: GroupSample | None = None
        self._pose_time = 0
        self._flight_log: FlightRecorder | None = None
        self._tell: Callable[[str], None] = lambda _: None

    def _handle_data(self, data: bytes) -> None:
        now, messages = self.clock.now(), self.endpoint.feed(data)
        self.refusals.handle_refusals(now)
        self.broadcast.accept_sender(messages, now)
        for message in messages:
            if message.name in self._command.names:
                if not self.gate.admits(message, now):
                    continue
                command = self._command.assemble(message)
                if command is not None and (self._newest_command is None or command.t >= self._newest_command.t):
                    self._newest_command = command
                continue
            self.requests.handle_message(message, now)
            self.relay.pass_on(message)
            for packet in self.identity.answer(message):
                self.broadcast.send(packet)
            handled = self.station.handle_message(message, now)
            for packet in handled.replies:
                self.broadcast.send(packet)
            for event in handled.events:
                if isinstance(event, ParameterChange):
                    self._set_parameter(event)
                else:
                    self.duties.handle_event(event, now)
                    if isinstance(event, ArmRequest):
                        self._note_request(event)
                    self.requests.handle_event(event, now)
                    self.instruments.handle_event(event, now)

    def _note_request(self, request: ArmRequest) -> None:
        """Log the checks when the vehicle is armed. Note a confirmation when the user disarms it."""
        if request.by_hand and not request.arm:
            self.guard.confirm()
        if request.arm and not self.duties.is_commanded and self._flight_log is not None:
            for check in self.guard.checks:
                self._flight_log.write_event(check.record)

    def _set_parameter(self, event: ParameterChange) -> None:
        uplink, path = self.duties.uplink, event.path.removeprefix("world.")
        step = self.body.world if uplink is None or path not in uplink.parameters else uplink
        values = step.parameters[event.path if step is self.body.world else path]
        values.flat[event.slot] = event.value
        self.identity.change(identity_path(event.path), values)
        self.station.status = self.station.status._replace(identity=self.identity.number)
        self._report(f"{event.path} = {format_value(self._declared[event.path], event.value)}")

    def _report(self, text: str) -> None:
        """Report a line to the log and to the user."""
        now = self.clock.now()
        self._tell(f"{now * 1e-7:9.3f} s  {text}")
        if self._flight_log is not None:
            self._flight_log.write_event(text)

    def serve(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        log_limit: int | None = None,
        log_period: int = 10_000,
        watchdog: int | None = None,
        confirmed: frozenset[str] = frozenset(),
        outputs_folder: Path | None = None,
        wanted_real_time: bool = False,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
        lost_lines: Callable[[], int] = lambda: 0,
    ) -> VehicleSummary:
        """Run until `duration` (100 ns) after the release, or until stop() returns True. Disarm before the end.

        Args:
            duration: time after the release (100 ns); None: no end.
            log_limit: maximum size of the log on the disk (bytes); None: no limit.
            log: path of the vehicle's own log, with the truth.
            log_period: time between rows (100 ns).
            watchdog: silence (100 ns) after which the outputs, in a separate process, go safe; None: no such process.
            confirmed: safety settings beyond their limits that the user has confirmed, see `safety_settings`.
            outputs_folder: folder for the port and the log of the outputs' process.
            wanted_real_time: ask the system for real-time scheduling and locked memory.
            stop: called at every instant; True ends the run.
            tell: receives the messages for the user. It must not wait.
            lost_lines: number of these messages that were lost.
        """
        self._tell = tell
        failsafe = self.duties.step
        decisions = LogSource(failsafe.outputs, failsafe.text.outputs, lambda p: f"firmware.{p}")
        sources = [*self.body.log_sources(), decisions]
        flight_log = self._flight_log = open_flight_log(
            log,
            sources,
            OWN_SIGNALS,
            self.scenario,
            side="vehicle",
            seed=self.seed,
            log_period=log_period,
            is_live=True,
            limit=log_limit,
            disk=self._machine.disk,
        )
        self._problems.clear()
        self.duties.is_ending = False
        self.guard.log_folder = None if log is None else log.parent
        self.guard.watchdog, self.guard.confirmed = watchdog, confirmed
        try:
            if watchdog is not None:
                self._outputs = self._start_outputs(watchdog, outputs_folder, wanted_real_time)
            discard_packets(self.link)
            self.endpoint.begin_anew()
            with self._machine.real_time(wanted_real_time):
                try:
                    self._run_loop(duration, log_period, stop)
                finally:  # before leaving real time, which takes longer than the watchdog allows
                    if self._outputs is not None:
                        self._outputs.close()
        finally:
            self._flight_log = self._outputs = None
            summary = close_flight_log(flight_log, lost_lines(), self.body.final_truth())
        lost = ([] if flight_log is None else list_log_problems(summary)) + list_stamp_problems(self.endpoint)
        for problem in lost:
            tell(problem)
        self._problems += lost
        times, problems = (self.release_time, self.disarm_time), tuple(dict.fromkeys(self._problems))
        return VehicleSummary(self.body.t, *times, *self.duties.mode, self.lateness, summary, problems)

    def _start_outputs(self, watchdog: int, folder: Path | None, wanted_real_time: bool) -> Outputs:
        rules = self._failsafe
        latch, lift_delay = int(rules.timeout) * NS, int(rules.lift_delay) * NS
        return Outputs(
            self._safe_row,
            timeout=watchdog * NS,
            lift_delay=lift_delay,
            latch=max(latch, watchdog * NS),
            folder=folder,
            wanted_real_time=wanted_real_time,
            clock=self._machine.clock,
            start=self._machine.start_outputs,
        )

    def _hand_over(self, t: int) -> None:
        """Hand the current row to the outputs' process, and report its state."""
        outputs = self._outputs
        if outputs is None or not outputs.is_alive:
            return
        lift = bool(self.duties.step.result("lift"))
        silence = outputs.hand_over(self.duties.is_commanded, lift, self.body.world.inputs[self._row_slots].tolist())
        if silence:
            self._problems.append("the outputs went safe on their own")
            self._announce(Severity.CRITICAL, f"outputs went safe: no data for {silence * 1e-6:.0f} ms")
            if silence >= int(self._failsafe.timeout) * NS:
                self.duties.handle_event(ArmRequest(False), t)
        if not outputs.is_alive:
            self._problems.append(outputs.problem)
            self._announce(Severity.CRITICAL, outputs.problem)

    def _run_loop(self, duration: int | None, log_period: int, stop: Callable[[], bool]) -> None:
        self.clock, last = WallClock(self._machine.clock), None
        if self._flight_log is not None:
            self._flight_log.start_clock(self.clock.start, self._machine.clock)
        for t in self.body.instants():
            why = self._end_reason(t, duration, stop) if last is None else ""
            if why:
                self._report(why)
                self.duties.is_ending = True
                last = t + (DISARM_DELAY if self.duties.is_commanded else 0)
                self.duties.handle_event(ArmRequest(False), t)
            if last is not None and t >= last:
                break
            try:
                self._run_instant(t, log_period)
            except InputError as error:  # raised by an FMU that refuses a step
                self._problems.append(error.problem)
                self._report(f"ended: {error.problem}")
                break

    def _end_reason(self, t: int, duration: int | None, stop: Callable[[], bool]) -> str:
        """Return why the run must end now; empty: it continues."""
        if stop():
            return "ended by request"
        if self._outputs is not None and not self._outputs.is_alive:
            return f"ended: {self._outputs.problem}"
        over = duration is not None and self.release_time is not None and t - self.release_time >= duration
        return "ended: duration reached" if over else ""

    def _run_instant(self, t: int, log_period: int) -> None:
        flight_log = self._flight_log
        woke = self.clock.wait(t, self.link, self._handle_data)
        late = woke - self.clock.start - t * NS
        self.lateness.add(late)
        self.body.advance(t, fresh=True, is_held=self.release_time is None)
        if self.broadcast.has_autopilot(t):
            self.broadcast.send_private(self.body.sample_packets(self.endpoint, self.body.changed_sensors()))
        if flight_log is not None and t >= self._pose_time:
            self._pose_time = t + TRANSFORM_PERIOD
            flight_log.pose[:] = self.instruments.pose()
        if flight_log is not None and t and self.body.row_t % log_period == 0:
            own = (self.release_time is None, late * 1e-9, *count_frames(self.endpoint.counts), *self.gate.counts)
            flight_log.write_row(self.body.row_t, own)
        command, self._newest_command = self._newest_command, None
        breach = self.guard.find_breach(t)
        self.duties.breach = BREACHES[0] if breach is None else breach.kind
        if self.duties.act(t, command):
            self._announce_mode(t, "" if breach is None else breach.text)
        self.guard.follow(t, self.duties.mode.mode)
        self._hand_over(t)
        self.gate.follow(self.duties.is_commanded)
        self.station.status = self.requests.status(self._find_status(), t)
        for packet in self.station.due(t):
            self.broadcast.send(packet)
        self.broadcast.send_private(self.requests.due(t))

    def _find_status(self) -> Status:
        """Return the vehicle's status, with the reasons why it cannot be armed."""
        guard = self.guard
        return self.duties.status._replace(
            arming_problem=guard.problem,
            confirmation_problem=guard.confirmation_problem,
            identity=self.identity.number,
        )

    def _announce_mode(self, t: int, breach: str) -> None:
        """Announce the current mode. breach: the limit that is violated, as text."""
        if self.duties.is_commanded:
            self.release_time, self.disarm_time = t if self.release_time is None else self.release_time, None
        elif self.duties.mode.mode == "disarmed":
            self.disarm_time = t
        text = f"{self.duties.mode.mode}: {self.duties.mode.cause}"
        text += f": {breach}" if self.duties.mode.cause in BREACHES else ""
        severity = Severity.CRITICAL if self.duties.mode.mode == "failsafe" else Severity.NOTICE
        if self.duties.mode.mode == "failsafe":
            self._problems.append(text)
        self._announce(severity, text)

    def _announce(self, severity: Severity, text: str) -> None:
        """Report a line to ground stations, the log and the user."""
        self.station.queue_text(severity, text)
        self._report(text)
