"""Autopilot of the command `fly`: it controls, in real time, a vehicle at the other end of a link.

One thread connects to the vehicle, runs the control loop (`flight.control_loop`), and disarms the vehicle at the end.
Source: docs pages, Fly and Supervisor.
"""

from collections.abc import Callable
from pathlib import Path

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.errors import InputError, argument_name
from trimtab.core.interfaces import Link
from trimtab.core.time import seconds
from trimtab.flight.autopilot_parts import AutopilotOptions, build_parts
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.control_loop import ControlLoop
from trimtab.flight.flight_log import FlightRecorder, close_flight_log, list_log_problems, open_flight_log
from trimtab.flight.flight_signals import FLIGHT_SIGNALS, LiveFlightSummary
from trimtab.flight.lockstep import START_PATIENCE
from trimtab.flight.machine import SYSTEM_MACHINE, Machine, list_stamp_problems
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.piloting import NoPilot, Piloting
from trimtab.flight.real_time import NS, discard_packets
from trimtab.flight.stick import CompiledStick
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import ENDED

COUNT, HALT = "count", "halt"
OVERRUN_POLICIES = (COUNT, HALT)
"""Policies for an overrun, that is, for a period whose work ends after the next deadline."""
PATIENCE_FACTOR = 3
"""Factor by which the longest wait for a vehicle is multiplied once a frame from the vehicle has been accepted."""
NOTICE_TIME = 3.0
"""Time (s) without any data from the vehicle after which `fly` prints what it waits for."""
DISARM_TIMEOUT = seconds("0.5")
"""Longest time to wait for the answer to a disarm request (100 ns)."""


class LiveAutopilot:
    """Autopilot's end of a link. The method `fly` runs a flight."""

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        endpoint: Callable[[Dialect], Endpoint],
        *,
        seed: int = 0,
        step: CompiledBlock | None = None,
        options: AutopilotOptions | None = None,
        machine: Machine = SYSTEM_MACHINE,
    ) -> None:
        """Compile the autopilot.

        Args:
            scenario: scenario of the autopilot.  link: link to the vehicle.
            endpoint: function that makes the autopilot's endpoint for a MAVLink dialect.
            seed: seed of the random numbers.  step: the compiled autopilot; None: compile it here.
            options: options that the user has chosen; None: the defaults.
            machine: the computer that the autopilot runs on.
        """
        self.seed, self._options, self._machine = seed, options or AutopilotOptions(), machine
        self.parts = parts = build_parts(scenario, link, endpoint, step, seed, self._options, machine)
        self.scenario, self.link, self.endpoint = parts.scenario, link, parts.endpoint
        self.autopilot_end, self.parameters = parts.autopilot_end, parts.parameters
        self.remote, self.preflight = parts.remote, parts.preflight

    def connect(
        self,
        patience: float = 10.0,
        stop: Callable[[], bool] = lambda: False,
        *,
        start_patience: float = START_PATIENCE,
        follows_clock: bool = False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Wait until the vehicle answers and the offset of its clock is known. Raise InputError if it does not answer.

        patience: longest wait (s) after the first packet. Once a frame has been accepted, wait three times as long,
        because the link may lose most heartbeats.
        start_patience: longest wait (s) for the first packet. The vehicle's program may still be compiling.
        follows_clock: True to sign packets with the vehicle's time if this computer's clock differs too much from the
        vehicle's clock.
        tell: function that receives the messages for the user. It must not block.
        """
        clock, remote, name = self._machine.clock, self.remote, self.scenario.name
        self.parts.reporter.begin(None, tell)
        began, longest, is_silent, is_told = clock.monotonic_ns(), start_patience, True, False
        while not remote.is_ready and not stop():
            now = clock.monotonic_ns()
            if is_silent and self.link.statistics.packets_in:
                began, is_silent = now, False
            if not is_silent:
                longest = patience * (PATIENCE_FACTOR if self.endpoint.counts.accepted else 1)
            if remote.clock.untimely is not None and follows_clock:
                remote.clock.follow()
            if now - began > longest * 1e9 or remote.comparison.misfit or remote.clock.untimely is not None:
                problem = remote.find_problem(name)
                raise InputError(argument_name("link"), problem.problem, fix=problem.fix)
            if is_silent and not is_told and now - began > NOTICE_TIME * 1e9:
                problem, is_told = remote.find_problem(name), True
                tell(f"{problem.problem} yet; waiting {start_patience:g} s. To start the vehicle: {problem.fix}")
            remote.due(now // NS)
            self._receive()

    def _receive(self) -> None:
        """Wait at most 20 ms for a packet, and handle the packet."""
        data = self.link.receive(0.02)
        if data is not None:
            self.parts.handle_data(data)

    def fly(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        log_limit: int | None = None,
        wanted_real_time: bool = True,
        overrun: str = COUNT,
        console: ConsoleLine | None = None,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
        lost_lines: Callable[[], int] = lambda: 0,
    ) -> LiveFlightSummary:
        """Arm as soon as all checks pass, fly for `duration` (100 ns) from arming, then disarm.

        Args:
            duration: duration of the flight (100 ns); None: the duration of the scenario.
            log: path of the flight's log.  log_limit: maximum size of the log on the disk (bytes), or None for no
                limit.
            wanted_real_time: True asks the system for real-time scheduling and locked memory.
            overrun: "count" continues after an overrun; "halt" ends an armed flight at the first overrun.
            console: connection to a console, on which `set_rows` has been called, or None for a flight without a
                console. The pilot at the console decides when to arm.
            stop: function called every period. If it returns True, the flight ends.
            tell: function that receives the messages for the user. It must not block.
            lost_lines: function that returns the number of messages to the user that were lost.
        """
        if overrun not in OVERRUN_POLICIES:
            raise InputError(
                "overrun",
                f"{overrun!r} is not a valid policy for overruns",
                choices=OVERRUN_POLICIES,
                fix=f'overrun="{HALT}"',
            )
        length = self.scenario.duration if duration is None else duration
        flight_log, reporter = self._open_log(log, log_limit), self.parts.reporter
        pilot = NoPilot() if console is None else self._start_pilot(console)
        reporter.begin(flight_log, tell, pilot.tell)
        self.preflight.log_folder = None if log is None else log.parent
        if flight_log is not None:
            for remark in self.remote.remarks:
                flight_log.write_event(remark)
        try:
            with self._machine.real_time(wanted_real_time) as grant:
                discard_packets(self.link)  # discard packets that arrived before the start or while memory was locked
                self.endpoint.begin_anew()
                self.autopilot_end.drop_samples()
                takes_over, halts = self._options.takes_over, overrun == HALT
                loop = ControlLoop(self.parts, pilot, flight_log, takes_over=takes_over, halts=halts)
                try:
                    t = loop.run(length, stop)
                finally:
                    cause, stopped = loop.end_reason(), "the flight was aborted by request" if stop() else ""
                    ended = "the supervisor ended the flight" if self.parts.supervised.mode == ENDED else ""
                    problems = [p for p in (cause, stopped, ended, *loop.list_problems()) if p]
                    is_ours = self.remote.arming.has_authority or self.remote.arming.is_asking
                    if is_ours and not self.remote.arming.is_taken:  # another autopilot's vehicle stays armed
                        self._disarm()
        finally:
            reporter.end_log()
            summary = close_flight_log(flight_log, lost_lines())
        lost = list_log_problems(flight_log, summary) + list_stamp_problems(self.endpoint)
        for problem in lost:
            tell(problem)
        facts = grant, loop.deadlines, loop.skipped, summary, cause
        return LiveFlightSummary(t, loop.arming_time, *facts, (*problems, *lost))

    def _open_log(self, path: Path | None, limit: int | None) -> FlightRecorder | None:
        return open_flight_log(
            path,
            self.autopilot_end.log_sources(),
            FLIGHT_SIGNALS,
            self.scenario,
            side="autopilot",
            seed=self.seed,
            log_period=self.scenario.autopilot.period,
            is_live=True,
            limit=limit,
            disk=self._machine.disk,
        )

    def _start_pilot(self, console: ConsoleLine) -> Piloting:
        parts = self.parts
        stick = CompiledStick(self.scenario, self.autopilot_end.step)
        given = parts.supervised, parts.parameters, parts.remote, parts.preflight, parts.reporter.report, parts.clock
        return Piloting(console, stick, *given)

    def _disarm(self) -> None:
        """Ask the vehicle to disarm, and wait at most 0.5 s for the answer.

        If the request is lost, the vehicle's failsafe disarms the vehicle soon after.
        """
        clock = self._machine.clock
        self.remote.arming.disarm()
        deadline = clock.monotonic_ns() + DISARM_TIMEOUT * NS
        while self.remote.arming.is_asking and clock.monotonic_ns() < deadline:
            self._receive()
            self.remote.due(clock.monotonic_ns() // NS)
