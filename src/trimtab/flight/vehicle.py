"""Virtual vehicle that runs in real time on a real link, and performs the duties of a vehicle's firmware.

Source: docs page, Vehicle.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.actuators.failsafe import BREACHES
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity
from trimtab.core.time import ms
from trimtab.flight.command_gate import AUTHORITY_SIGNALS
from trimtab.flight.flight_log import (
    FlightRecorder,
    LogSource,
    close_flight_log,
    count_frames,
    frame_signals,
    list_log_problems,
    open_flight_log,
)
from trimtab.flight.machine import SYSTEM_MACHINE, Machine, list_stamp_problems
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import ArmRequest, Severity
from trimtab.flight.real_time import NS, Histogram, WallClock, discard_packets
from trimtab.flight.station_options import StationOptions
from trimtab.flight.vehicle_outputs import VehicleOutputs
from trimtab.flight.vehicle_parts import VehicleParts, build_vehicle_parts
from trimtab.flight.vehicle_receiver import VehicleReceiver
from trimtab.logs.frames import TRANSFORM_PERIOD
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario

OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.held": (
        "?",
        Quantity("1", "True while the vehicle is held in place because it has not been armed yet.", kind="flag"),
    ),
    "firmware.late": ("f8", Quantity("s", "Delay of the simulation behind real time at this instant.")),
    **frame_signals("wire"),
    **AUTHORITY_SIGNALS,
}
"""Signals of the vehicle's log, in addition to the signals of the world and the failsafe."""
DISARM_DELAY = ms(50)
"""Time (100 ns) for which the vehicle's program continues after it has disarmed the vehicle at the end. It is longer
than two servo frames."""


class VehicleSummary(NamedTuple):
    """Result of a run of a virtual vehicle.

    release_time: time of the first arming (100 ns), or None.  disarm_time: time of the last disarming (100 ns), or
    None.
    """

    t: int
    release_time: int | None
    disarm_time: int | None
    mode: str
    cause: str
    lateness: Histogram
    log: LogFileSummary | None
    problems: tuple[str, ...]
    """Problems listed in the JSON report: failsafes, outputs that became safe without a command of the vehicle, a lost
    log."""


class VehicleRows:
    """Writer of the rows of a vehicle's log. Each row contains the vehicle's pose."""

    def __init__(self, parts: VehicleParts, log: FlightRecorder, period: int) -> None:
        """period: time between log rows (100 ns)."""
        self._parts, self._log, self._period = parts, log, period
        self._pose_time = 0

    def write(self, t: int, is_held: bool, late: int) -> None:
        """Write a log row at integer time t if a row is due. late: delay (ns) of the work at this instant."""
        parts, log = self._parts, self._log
        if t >= self._pose_time:
            self._pose_time = t + TRANSFORM_PERIOD
            log.pose[:] = parts.instruments.pose()
        if t and parts.body.row_t % self._period == 0:
            own = (is_held, late * 1e-9, *count_frames(parts.endpoint.counts), *parts.gate.counts)
            log.write_row(parts.body.row_t, own)


class LiveVehicle:
    """Virtual vehicle on a real link: simulated world, duties of the firmware, and the vehicle's end of the link. The
    method `serve` runs the vehicle."""

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
            scenario: scenario of the vehicle.  link: link to its autopilot and to ground stations.
            endpoint: function that makes the vehicle's endpoint for a MAVLink dialect.
            seed: seed of the random numbers.
            station_options: services for ground stations.
            machine: the computer that the vehicle runs on.
        """
        self.scenario, self.seed = scenario, seed
        options = station_options or StationOptions()
        self.parts = parts = build_vehicle_parts(scenario, link, endpoint, seed, options, machine)
        self.endpoint, self.body, self.duties = parts.endpoint, parts.body, parts.duties
        parts.station.status = parts.find_status()  # until a check has run, refuse requests to arm
        self.clock, self.lateness = WallClock(machine.clock), Histogram()
        self._receiver = VehicleReceiver(parts, self.clock)
        self.release_time: int | None = None
        self.disarm_time: int | None = None
        self._problems = list[str]()
        self._outputs: VehicleOutputs | None = None

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
        """Run until `duration` (100 ns) after the first arming, or until stop() returns True. Disarm before the end.

        Args:
            duration: time (100 ns) from the first arming to the end, or None to run until stop() returns True.
            log_limit: maximum size of the log on the disk (bytes), or None for no limit.
            log: path of the vehicle's log, which contains the true state.
            log_period: time between log rows (100 ns).
            watchdog: time (100 ns) without output rows after which the process of the outputs makes them safe, or None
                to run without this process.
            confirmed: names of safety settings beyond their limits that the user has confirmed, see `safety_settings`.
            outputs_folder: folder for the port and the log of the process of the outputs.
            wanted_real_time: True asks the system for real-time scheduling and locked memory.
            stop: function called at every instant. If it returns True, the run ends.
            tell: function that receives the messages for the user. It must not block.
            lost_lines: function that returns the number of messages to the user that were lost.
        """
        parts, reporter = self.parts, self.parts.reporter
        flight_log = self._open_log(log, log_limit, log_period)
        reporter.begin(flight_log, lambda text: tell(f"{self.clock.now() * 1e-7:9.3f} s  {text}"))
        self._problems.clear()
        self.duties.is_ending = False
        parts.guard.log_folder = None if log is None else log.parent
        parts.guard.watchdog, parts.guard.confirmed = watchdog, confirmed
        try:
            if watchdog is not None:
                self._outputs = VehicleOutputs(parts, self._problems, watchdog, outputs_folder, wanted_real_time)
            discard_packets(parts.link)
            self.endpoint.begin_anew()
            with parts.machine.real_time(wanted_real_time):
                try:
                    self._run_loop(duration, flight_log, log_period, stop)
                finally:  # close first: leaving real time takes longer than the watchdog allows
                    if self._outputs is not None:
                        self._outputs.close()
        finally:
            self._outputs = None
            reporter.end_log()
            summary = close_flight_log(flight_log, lost_lines(), self.body.final_truth())
        lost = list_log_problems(flight_log, summary) + list_stamp_problems(self.endpoint)
        for problem in lost:
            tell(problem)
        self._problems += lost
        times, problems = (self.release_time, self.disarm_time), tuple(dict.fromkeys(self._problems))
        return VehicleSummary(self.body.t, *times, *self.duties.mode, self.lateness, summary, problems)

    def _open_log(self, path: Path | None, limit: int | None, period: int) -> FlightRecorder | None:
        failsafe = self.duties.step
        decisions = LogSource(failsafe.outputs, failsafe.text.outputs, lambda p: f"firmware.{p}")
        return open_flight_log(
            path,
            [*self.body.log_sources(), decisions],
            OWN_SIGNALS,
            self.scenario,
            side="vehicle",
            seed=self.seed,
            log_period=period,
            is_live=True,
            limit=limit,
            disk=self.parts.machine.disk,
        )

    def _run_loop(
        self, duration: int | None, log: FlightRecorder | None, log_period: int, stop: Callable[[], bool]
    ) -> None:
        self.clock.restart()
        last, row_log = None, None if log is None else VehicleRows(self.parts, log, log_period)
        if log is not None:
            log.start_clock(self.clock.start, self.parts.machine.clock)
        for t in self.body.instants():
            why = self._end_reason(t, duration, stop) if last is None else ""
            if why:
                self.parts.reporter.report(why)
                self.duties.is_ending = True
                last = t + (DISARM_DELAY if self.duties.is_commanded else 0)
                self.duties.handle_event(ArmRequest(False), t)
            if last is not None and t >= last:
                break
            try:
                self._run_instant(t, row_log)
            except InputError as error:  # the vehicle is an FMU that refuses a step
                self._problems.append(error.problem)
                self.parts.reporter.report(f"ended: {error.problem}")
                break

    def _end_reason(self, t: int, duration: int | None, stop: Callable[[], bool]) -> str:
        """Return the reason why the run must end now, or "" if the run continues."""
        if stop():
            return "ended by request"
        if self._outputs is not None and self._outputs.problem:
            return f"ended: {self._outputs.problem}"
        over = duration is not None and self.release_time is not None and t - self.release_time >= duration
        return "ended: duration reached" if over else ""

    def _run_instant(self, t: int, row_log: VehicleRows | None) -> None:
        parts, duties = self.parts, self.duties
        woke = self.clock.wait(t, parts.link, self._receiver.handle_data)
        late = woke - self.clock.start - t * NS
        self.lateness.add(late)
        self.body.advance(t, fresh=True, is_held=self.release_time is None)
        if parts.broadcast.has_autopilot(t):
            parts.broadcast.send_private(self.body.sample_packets(self.endpoint, self.body.changed_sensors()))
        if row_log is not None:
            row_log.write(t, self.release_time is None, late)
        breach = parts.guard.find_breach(t)
        duties.breach = BREACHES[0] if breach is None else breach.kind
        if duties.act(t, self._receiver.take_command()):
            self._announce_mode(t, "" if breach is None else breach.text)
        parts.guard.follow(t, duties.mode.mode)
        if self._outputs is not None:
            self._outputs.hand_over(t)
        parts.gate.follow(duties.is_commanded)
        parts.station.status = parts.requests.status(parts.find_status(), t)
        for packet in parts.station.due(t):
            parts.broadcast.send(packet)
        parts.broadcast.send_private(parts.requests.due(t))

    def _announce_mode(self, t: int, breach: str) -> None:
        """Announce the current mode. breach: description of the violated limit."""
        mode, cause = self.duties.mode
        if self.duties.is_commanded:
            self.release_time, self.disarm_time = t if self.release_time is None else self.release_time, None
        elif mode == "disarmed":
            self.disarm_time = t
        text = f"{mode}: {cause}" + (f": {breach}" if cause in BREACHES else "")
        if mode == "failsafe":
            self._problems.append(text)
        self.parts.announcer.announce(Severity.CRITICAL if mode == "failsafe" else Severity.NOTICE, text)
