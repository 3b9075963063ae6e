"""Control loop of a flight. In each period it receives packets, runs the compiled autopilot once, sends a command and
logs a row.

The periods end at absolute deadlines. The loop never waits for a disk, a console or a network. A request to the
supervisor in flight is written into a sensor sample that the supervisor reads. This sample is logged, so a replay
repeats the request.
Source: docs pages, Fly and Supervisor.
"""

from collections.abc import Callable

from trimtab.core.errors import InputError, argument_name
from trimtab.core.time import UNITS_PER_SECOND, ms, to_seconds
from trimtab.flight.autopilot_parts import AutopilotParts
from trimtab.flight.command_sender import CommandSender
from trimtab.flight.connection_problem import owner_problem
from trimtab.flight.flight_log import FlightRecorder, count_frames
from trimtab.flight.flight_news import FlightNews
from trimtab.flight.mavlink.protocol import Severity
from trimtab.flight.piloting import NoPilot, Piloting
from trimtab.flight.real_time import NS, Deadlines
from trimtab.flight.silence import SilenceWatch
from trimtab.flight.station.streams import pack_text

MOST_PACKETS = 64
"""Maximum number of packets handled in one period, so that a flood of packets cannot stop the loop."""
SERVO_FRAME = ms(20)
"""Shortest time between two sent commands, equal to the period of the servo pulses."""


class ControlLoop:
    """Control loop of one flight."""

    def __init__(
        self,
        parts: AutopilotParts,
        pilot: Piloting | NoPilot,
        log: FlightRecorder | None,
        *,
        takes_over: bool,
        halts: bool,
    ) -> None:
        """Prepare the loop. The method `run` starts the first period.

        Args:
            parts: parts of the autopilot's end.
            pilot: pilot at a console, who decides when to arm; `NoPilot` without a console.
            log: log of the flight.
            takes_over: True to take the vehicle over from another autopilot that flies it.
            halts: True to end an armed flight at the first overrun of a period.
        """
        self._parts, self._pilot, self._log = parts, pilot, log
        self._takes_over, self._halts, self._overrun = takes_over, halts, ""
        self.deadlines = Deadlines(parts.scenario.autopilot.period, parts.clock)
        self.skipped = 0
        self.arming_time: int | None = None
        self.silence = SilenceWatch(parts.endpoint.counts)
        self._news = FlightNews(parts, self.silence)
        self._sender = CommandSender(parts.autopilot_end, parts.endpoint, parts.link, parts.remote.clock.sync)

    def run(self, length: int, stop: Callable[[], bool]) -> int:
        """Fly until `length` (100 ns) after arming, or until stop() returns True. Return the loop's time at the end
        (100 ns)."""
        parts, log, deadlines = self._parts, self._log, self.deadlines
        clock, period = parts.clock, parts.scenario.autopilot.period
        every = -(-max(period, SERVO_FRAME) // period)
        if log is not None:
            log.start_clock(deadlines.start, clock)
        parts.sample_clock.start_loop(deadlines.start)
        self.silence.restart(deadlines.start // NS)
        k = t = 0
        while not stop() and (self.arming_time is None or t - self.arming_time < length):
            if self.end_reason():
                parts.reporter.report(f"ended: {self.end_reason()}")
                break
            t = k * period
            woke = self._receive_until(k)
            now = deadlines.start // NS + t
            ahead = deadlines.start // NS + parts.remote.clock.offset(now)  # vehicle's time minus the loop's time
            self._set_inputs(t)
            began = clock.monotonic_ns()
            parts.autopilot_end.step.step()
            stepped = clock.monotonic_ns()
            if k % every == 0 and deadlines.remaining(k + every) > 0:  # if late, a newer command follows soon
                self._sender.send(t, ahead)
                self._pilot.note_command()
            self._update_line(t, now)
            if news := self.silence.update(now):
                parts.reporter.report(news)
            self._show(t, self._own_signals(now, woke - deadlines.start - t * NS, stepped - began))
            if deadlines.record_period(k, woke, began, stepped) and self._halts and self.arming_time is not None:
                past = -deadlines.remaining(k + 1) * 1e3
                self._overrun = f"an overrun: the work of period {k} ended {past:.2f} ms after the next deadline"
            k = self._next_period(k)
        return t

    def end_reason(self) -> str:
        """Return the reason why the flight must end early, or an empty string."""
        remote = self._parts.remote
        if self.arming_time is not None and remote.arming.is_taken:
            return f"the vehicle was taken over by session {remote.arming.owner:06x}"
        return remote.comparison.misfit or self._parts.preflight.refusal or self._overrun or self._pilot.end_reason

    def list_problems(self) -> list[str]:
        """Return the problems of the vehicle at the end of the flight, for the JSON report."""
        now, was_armed = self._parts.clock.monotonic_ns() // NS, self.arming_time is not None
        return self._parts.remote.arming.list_problems(was_armed, self.silence.is_silent, now, self._pilot.has_stopped)

    def _receive_until(self, k: int) -> int:
        """Handle packets until deadline k. Return the monotonic time afterwards (ns)."""
        packets = 0
        while True:
            left = self.deadlines.remaining(k)
            data = self._parts.link.receive(max(left, 0.0))
            if data is not None:
                self._parts.handle_data(data)
            packets += 1
            if left <= 0 and (data is None or packets > MOST_PACKETS):
                return self._parts.clock.monotonic_ns()

    def _set_inputs(self, t: int) -> None:
        """Set the inputs of the compiled autopilot at integer time t: the pilot's stick, changed parameters, samples,
        requests."""
        self._pilot.update(t)
        for change in self._parts.parameters.apply_changes(t):
            self._parts.reporter.report(str(change))
        self._parts.autopilot_end.set_inputs(t)
        self._parts.supervised.set_inputs(t)

    def _update_line(self, t: int, now: int) -> None:
        """Prepare arming if it is requested, report events of the flight, and send the packets that are due."""
        remote, link = self._parts.remote, self._parts.link
        if remote.arming.has_authority:
            self.arming_time = t if self.arming_time is None else self.arming_time
            self._pilot.wants_arming = False
        elif self.arming_time is None and remote.arming.is_taken and not self._takes_over:
            problem = owner_problem(remote.arming.owner, remote.typed)
            self._parts.reporter.report(problem.problem)
            raise InputError(argument_name("link"), problem.problem, fix=problem.fix)
        elif self._pilot.wants_arming or self._pilot.shows_checks:
            self._prepare_arming(now)
        self._news.report(now, self.arming_time is not None)
        now = self._parts.clock.monotonic_ns() // NS  # measure the round trip from now, not from the deadline
        remote.due(now)
        for packet in self._parts.parameters.due(now):
            link.send(packet)

    def _prepare_arming(self, now: int) -> None:
        """Collect the checks before arming. If all pass, ask the vehicle to arm."""
        parts, preflight = self._parts, self._parts.preflight
        may_arm = preflight.update(now, self.silence.length(now))
        if self._pilot.wants_arming:
            preflight.report(parts.reporter.report)
        may_arm = self._pilot.decide_arming(may_arm)
        if may_arm:
            parts.remote.arming.arm(takes_over=self._takes_over)
        elif preflight.refusal:
            for packet in pack_text(parts.endpoint, Severity.WARNING, preflight.refusal):
                parts.link.send(packet)

    def _show(self, t: int, own: tuple[float, ...]) -> None:
        """Write a row of the log if there is a log, and send a row to the console if there is a console."""
        if self._log is not None:
            self._parts.autopilot_end.pose.fill(self._log.pose)
            self._log.write_row(t, own)
        self._pilot.show(t, own, self.deadlines)

    def _next_period(self, k: int) -> int:
        """Return the number of the next control period. If the loop is far behind, periods are skipped."""
        passed, behind = self.deadlines.count_passed(k + 1)
        if passed:
            self.skipped += passed
            self._parts.reporter.report(f"this end stalled for {to_seconds(behind):.3f} s: {passed} periods skipped")
        return k + 1 + passed

    def _own_signals(self, now: int, late: int, step: int) -> tuple[float, ...]:
        """Return the current values of the signals in FLIGHT_SIGNALS."""
        parts, deadlines, samples = self._parts, self.deadlines, self._parts.autopilot_end.counts
        return (
            late * 1e-9,
            step * 1e-9,
            deadlines.own + deadlines.scheduler,
            self.skipped,
            samples.received,
            samples.overtaken,
            samples.backward,
            samples.implausible,
            self.silence.length(now) / UNITS_PER_SECOND,
            parts.remote.clock.offset(now) / UNITS_PER_SECOND,
            *count_frames(parts.endpoint.counts),
            parts.link.fileno() >= 0,
            parts.remote.arming.has_authority,
            parts.remote.arming.armed,
        )
