"""fly: run an autopilot in real time against a vehicle at the far end of a link.

One thread waits for packets until the next absolute deadline, makes one compiled step, sends the command, and hands
a row to the process of the log. The thread never waits for a disk, a console or a network.

Requests to the supervisor in flight are written into the sensor sample that it reads, so a replay repeats them.
Source: docs pages, Fly and Supervisor.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.errors import InputError, argument_name
from trimtab.core.interfaces import Link
from trimtab.core.time import UNITS_PER_SECOND, ms, seconds, to_seconds
from trimtab.flight.autopilot_end import LONGEST_SAMPLE_AGE, MOST_SAMPLE_LEAD, AutopilotEnd, scenario_dialect
from trimtab.flight.autopilot_parameters import AutopilotParameters
from trimtab.flight.connection_problem import owner_problem
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.flight_log import FlightRecorder, close_flight_log, count_frames, list_log_problems, open_flight_log
from trimtab.flight.flight_signals import FLIGHT_SIGNALS, LiveFlightSummary
from trimtab.flight.machine import SYSTEM_MACHINE, Machine, list_stamp_problems
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import Severity
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.piloting import NoPilot, Piloting
from trimtab.flight.preflight import Preflight
from trimtab.flight.real_time import NS, Deadlines, discard_packets
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.scenario_identity import scenario_identity
from trimtab.flight.silence import SilenceWatch
from trimtab.flight.station.identity import IdentityComparison
from trimtab.flight.station.streams import pack_text
from trimtab.flight.stick import CompiledStick
from trimtab.flight.supervised import CompiledSupervisor, explain_change
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import add_stick_sensor
from trimtab.loop.supervisor import ENDED
from trimtab.run.blocks import compile_autopilot

COUNT, HALT = "count", "halt"
OVERRUN_POLICIES = (COUNT, HALT)
"""Policies for an overrun, that is, for a period whose work ends after the next deadline."""
MOST_PACKETS = 64
"""Maximum number of packets taken in one period, so that a flood cannot stop the loop."""
SERVO_FRAME = ms(20)
"""Shortest time between two commands: a servo takes no more."""
PATIENCE_FACTOR = 3
"""Factor on the patience for the vehicle's clock, where frames do arrive."""
SAMPLE_REPORT_PERIOD = seconds(10)
"""Shortest time between two reports of rejected samples."""
DISARM_TIMEOUT = seconds("0.5")
"""Time to wait for the answer to a disarm request."""


class LiveAutopilot:
    """The autopilot's end of a link. `fly` runs it."""

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        endpoint: Callable[[Dialect], Endpoint],
        *,
        seed: int = 0,
        step: CompiledBlock | None = None,
        typed: str | None = None,
        takes_over: bool = False,
        confirms: bool = False,
        accepts: Sequence[str] = (),
        store: ParameterStore | None = None,
        machine: Machine = SYSTEM_MACHINE,
    ) -> None:
        """Compile the autopilot.

        Args:
            scenario: scenario of the autopilot.  link: link to the vehicle.
            endpoint: makes the autopilot's end for a dialect.
            seed: seed of the random numbers.  step: the compiled autopilot, if there is one.
            typed: the command that the user typed, for the commands that messages suggest.
            accepts: paths at or below which the vehicle may differ from this end.
            store: where parameters are stored when a ground station asks for it; None: they are not stored.
            confirms: True confirms that the vehicle may be armed again after a failsafe.
            takes_over: True takes the vehicle over from another autopilot that flies it; False refuses such a vehicle.
            machine: the computer that the autopilot runs on.
        """
        self._takes_over, self._machine, self._clock = takes_over, machine, machine.clock
        scenario.check()
        dialect = scenario_dialect(scenario)
        self.scenario, self.link, self.seed = add_stick_sensor(add_pilot_sensor(scenario)), link, seed
        self.endpoint = endpoint(dialect)
        self.autopilot_end = AutopilotEnd(scenario, dialect, step or compile_autopilot(self.scenario, seed=seed))
        self.parameters = AutopilotParameters(
            self.scenario, self.autopilot_end.step, self.endpoint, store or ParameterStore()
        )
        self.supervised = CompiledSupervisor(self.scenario, self.autopilot_end.step)
        self.autopilot_end.is_believable = self._is_believable
        identity = IdentityComparison(self.endpoint, scenario_identity(scenario, dialect))
        typed = typed or f"trimtab fly {scenario.name} --link URI"
        self.remote = RemoteVehicle(self.endpoint, link, typed, identity, accepts)
        self.remote.confirms = confirms
        self.preflight = Preflight(self.scenario, self.autopilot_end, self.remote, self.endpoint.counts, machine.disk)
        self.deadlines = Deadlines(scenario.autopilot.period, machine.clock)
        self.skipped = 0
        self.arming_time: int | None = None
        self._sent = self._jumps = self._sample_report_time = 0
        self._silence = SilenceWatch(self.endpoint.counts)
        self._pilot: Piloting | NoPilot = NoPilot()
        self._halts, self._overrun = False, ""
        self._backward_sensors: list[str] = []
        self._flight_log: FlightRecorder | None = None
        self._tell: Callable[[str], None] = lambda _: None

    def connect(
        self, patience: float = 10.0, stop: Callable[[], bool] = lambda: False, *, follows_clock: bool = False
    ) -> None:
        """Wait for the vehicle and for its clock. Raise InputError if no vehicle answers within `patience` seconds.

        If frames do arrive, the link may be one that loses most heartbeats: the patience is then three times as long.
        follows_clock: sign by the vehicle's clock where the two clocks differ by too much.
        """
        began = self._clock.monotonic_ns()
        while not self.remote.is_ready and not stop():
            now = self._clock.monotonic_ns()
            waits = patience * (PATIENCE_FACTOR if self.endpoint.counts.accepted else 1)
            if self.remote.untimely is not None and follows_clock:
                self.remote.follow_clock()
            if now - began > waits * 1e9 or self.remote.misfit or self.remote.untimely is not None:
                problem = self.remote.find_problem(self.scenario.name)
                raise InputError(argument_name("link"), problem.problem, fix=problem.fix)
            self.remote.due(now // NS)
            data = self.link.receive(0.02)
            if data is not None:
                self._handle_data(data)

    def _handle_data(self, data: bytes) -> None:
        now = self._clock.monotonic_ns() // NS
        for message in self.endpoint.feed(data):
            is_sample = self.remote.is_of_vehicle(message) and self.autopilot_end.handle_message(message)
            if not is_sample and not self.parameters.handle_message(message):
                self.remote.handle_message(message, now)
        self.remote.handle_untimely(self.endpoint.untimely)

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
        """Arm as soon as there is an estimate, fly for `duration` (100 ns) from arming, then disarm.

        Args:
            duration: duration of the flight; None: the scenario's.
            log: path of the flight's log.  log_limit: its maximum size on the disk (bytes); None: no limit.
            wanted_real_time: ask the system for real-time scheduling and locked memory.
            overrun: "count" continues after an overrun; "halt" ends an armed flight at the first one.
            console: console of the pilot, who then decides when to arm; its rows have been set.
            stop: called every period; True ends the flight.
            tell: receives the messages for the user. It must not wait.
            lost_lines: number of these messages that were lost.
        """
        if overrun not in OVERRUN_POLICIES:
            raise InputError(
                "overrun", f"{overrun!r}is not a policy", choices=OVERRUN_POLICIES, fix=f'overrun="{HALT}"'
            )
        self._halts, self._overrun = overrun == HALT, ""
        length = self.scenario.duration if duration is None else duration
        flight_log = self._flight_log = open_flight_log(
            log,
            self.autopilot_end.log_sources(),
            FLIGHT_SIGNALS,
            self.scenario,
            side="autopilot",
            seed=self.seed,
            log_period=self.scenario.autopilot.period,
            is_live=True,
            limit=log_limit,
            disk=self._machine.disk,
        )
        self._tell, self.remote.tell = tell, self._report
        if console is not None:
            stick, parts = CompiledStick(self.scenario, self.autopilot_end.step), (self.supervised, self.parameters)
            self._pilot = Piloting(console, stick, *parts, self.remote, self.preflight, self._report, self._clock)
        self.preflight.log_folder = None if log is None else log.parent
        if flight_log is not None:
            for remark in self.remote.remarks:
                flight_log.write_event(remark)
        try:
            with self._machine.real_time(wanted_real_time) as grant:
                discard_packets(self.link)  # packets that came until now, and while memory was locked
                self.endpoint.begin_anew()
                self.autopilot_end.drop_samples()
                try:
                    t = self._run_loop(length, stop)
                finally:
                    cause, stopped = self._end_reason(), "the flight was aborted by request" if stop() else ""
                    ended = "the supervisor ended the flight" if self.supervised.mode == ENDED else ""
                    was_armed = self.arming_time is not None
                    is_silent, has_stopped = self._silence.is_silent, self._pilot.has_stopped
                    remote = self.remote.list_problems(
                        was_armed, is_silent, self._clock.monotonic_ns() // NS, has_stopped
                    )
                    problems = [p for p in (cause, stopped, ended, *remote) if p]
                    is_ours = self.remote.has_authority or self.remote.is_asking
                    if is_ours and not self.remote.is_taken:  # another autopilot's vehicle is left alone
                        self._disarm()
        finally:
            self._flight_log = None
            summary = close_flight_log(flight_log, lost_lines())
        lost = ([] if flight_log is None else list_log_problems(summary)) + list_stamp_problems(self.endpoint)
        for problem in lost:
            tell(problem)
        return LiveFlightSummary(t, self.arming_time, grant, self.deadlines, summary, cause, (*problems, *lost))

    def _run_loop(self, length: int, stop: Callable[[], bool]) -> int:
        flight_log, period = self._flight_log, self.scenario.autopilot.period
        every = -(-max(period, SERVO_FRAME) // period)
        deadlines = self.deadlines = Deadlines(period, self._clock)
        if flight_log is not None:
            flight_log.start_clock(deadlines.start, self._clock)
        self._silence.restart(deadlines.start // NS)
        k = t = 0
        while not stop() and (self.arming_time is None or t - self.arming_time < length):
            if self._end_reason():
                self._report(f"ended: {self._end_reason()}")
                break
            t = k * period
            woke = self._receive_until(k)
            now = deadlines.start // NS + t
            ahead = deadlines.start // NS + self.remote.offset(now)  # from the loop's time to the vehicle's
            self._pilot.update(t)
            for change in self.parameters.apply_changes(t):
                self._report(str(change))
            self.autopilot_end.set_inputs(t, self._to_local)
            self.supervised.set_inputs(t)
            began = self._clock.monotonic_ns()
            self.autopilot_end.step.step()
            stepped = self._clock.monotonic_ns()
            if k % every == 0 and deadlines.remaining(k + every) > 0:  # else there are newer ones soon
                self._send_command(t, ahead)
            self._update_line(t, now)
            if news := self._silence.update(now):
                self._report(news)
            own = self._own_signals(now, woke - deadlines.start - t * NS, stepped - began)
            if flight_log is not None:
                self.autopilot_end.fill_pose(flight_log.pose)
                flight_log.write_row(t, own)
            self._pilot.show(t, own, deadlines)
            if deadlines.record_period(k, woke, began, stepped) and self._halts and self.arming_time is not None:
                past = -deadlines.remaining(k + 1) * 1e3
                self._overrun = f"an overrun: the work of period {k} ended {past:.2f} ms after the next deadline"
            k = self._next_period(k)
        return t

    def _end_reason(self) -> str:
        """Return why the flight must end before its time, or an empty string."""
        if self.arming_time is not None and self.remote.is_taken:
            return f"the vehicle was taken over by session {self.remote.owner:06x}"
        return self.remote.misfit or self.preflight.refusal or self._overrun or self._pilot.end_reason

    def _send_command(self, t: int, ahead: int) -> None:
        """Send the current command with the vehicle's time. Times increase even if that clock turns out earlier."""
        if t + ahead <= self._sent and self.remote.sync.jumps == self._jumps:
            ahead = self._sent + 1 - t
        self._sent, self._jumps = t + ahead, self.remote.sync.jumps
        for packet in self.autopilot_end.command_packets(self.endpoint, ahead):
            self.link.send(packet)
        self._pilot.note_command()

    def _disarm(self) -> None:
        """Ask to disarm for up to half a second. Soon after that the vehicle's failsafe disarms anyway."""
        self.remote.disarm()
        deadline = self._clock.monotonic_ns() + DISARM_TIMEOUT * NS
        while self.remote.is_asking and self._clock.monotonic_ns() < deadline:
            data = self.link.receive(0.02)
            if data is not None:
                self._handle_data(data)
            self.remote.due(self._clock.monotonic_ns() // NS)

    def _to_local(self, t: int) -> int:
        """Return a time of the vehicle's clock as a time of the loop."""
        return self.remote.sync.to_local(t) - self.deadlines.start // NS

    def _is_believable(self, t: int) -> bool:
        """Return whether a sample with this vehicle time is recent enough to be accepted."""
        now = self._clock.monotonic_ns() // NS
        lead = self.remote.sync.show_local(t) - now
        is_believable = -LONGEST_SAMPLE_AGE <= lead <= MOST_SAMPLE_LEAD
        if self._flight_log is not None and not is_believable and now >= self._sample_report_time:
            self._sample_report_time = now + SAMPLE_REPORT_PERIOD
            why = "the clocks differ" if lead > 0 else "the clocks differ, or it was delayed that long"
            self._report(f"sample rejected: its time is {to_seconds(lead):+.3f} s from now, {why}")
        return is_believable

    def _receive_until(self, k: int) -> int:
        """Handle packets until deadline k. Return the time when that ended (ns)."""
        packets = 0
        while True:
            left = self.deadlines.remaining(k)
            data = self.link.receive(max(left, 0.0))
            if data is not None:
                self._handle_data(data)
            packets += 1
            if left <= 0 and (data is None or packets > MOST_PACKETS):
                return self._clock.monotonic_ns()

    def _next_period(self, k: int) -> int:
        """Return the next period. Periods are skipped if the loop is far behind."""
        passed, behind = self.deadlines.count_passed(k + 1)
        if passed:
            self.skipped += passed
            self._report(f"this end stalled for {to_seconds(behind):.3f} s: {passed} periods skipped")
        return k + 1 + passed

    def _update_line(self, t: int, now: int) -> None:
        """Arm when there is a valid estimate, report news, and send what is due."""
        if self.remote.has_authority:
            self.arming_time = t if self.arming_time is None else self.arming_time
            self._pilot.wants_arming = False
        elif self.arming_time is None and self.remote.is_taken and not self._takes_over:
            problem = owner_problem(self.remote.owner, self.remote.typed)
            self._report(problem.problem)
            raise InputError(argument_name("link"), problem.problem, fix=problem.fix)
        elif self._pilot.wants_arming or self._pilot.shows_checks:
            self._prepare_arming(now)
        self._report_backward_sensors()
        self._report_supervisor(now)
        for news in self.autopilot_end.monitored.describe_changes():
            self._report(news)
        now = self._clock.monotonic_ns() // NS  # not the deadline, which may be long past: its answer is timed
        self.remote.due(now)
        for packet in self.parameters.due(now):
            self.link.send(packet)

    def _prepare_arming(self, now: int) -> None:
        """Collect the checks before arming. If all pass, ask the vehicle to arm."""
        preflight = self.preflight
        may_arm = preflight.update(now, self._silence.length(now))
        if self._pilot.wants_arming:
            preflight.report(self._report)
        may_arm = self._pilot.decide_arming(may_arm)
        if may_arm:
            self.remote.arm(takes_over=self._takes_over)
        elif preflight.refusal:
            for packet in pack_text(self.endpoint, Severity.WARNING, preflight.refusal):
                self.link.send(packet)

    def _report_backward_sensors(self) -> None:
        """Report each sensor whose samples are rejected because their time stamps decrease."""
        sensors = self.autopilot_end.backward_sensors
        for sensor in sensors if sensors != self._backward_sensors else ():
            self._report(f"{sensor}: time stamps run backwards, samples rejected")
        self._backward_sensors = sensors

    def _report_supervisor(self, now: int) -> None:
        """Report the supervisor's decisions, and pass requests on to it."""
        self.remote.mode = self.supervised.mode
        if self.remote.requests:
            self.supervised.request(self.remote.requests.popleft())
        news = self.supervised.describe_changes()
        if news:
            silent = self._backward_sensors if self._silence.is_heard(now) else None
            why = explain_change(self.supervised, self.remote, silent, self.arming_time is not None)
            self.remote.tell(f"{news}{why}")

    def _own_signals(self, now: int, late: int, step: int) -> tuple[float, ...]:
        remote, deadlines = self.remote, self.deadlines
        return (
            late * 1e-9,
            step * 1e-9,
            deadlines.own + deadlines.scheduler,
            self.skipped,
            self.autopilot_end.received_samples,
            self.autopilot_end.overtaken_samples,
            self.autopilot_end.backward_samples,
            self.autopilot_end.implausible_samples,
            self._silence.length(now) / UNITS_PER_SECOND,
            remote.offset(now) / UNITS_PER_SECOND,
            *count_frames(self.endpoint.counts),
            self.link.fileno() >= 0,
            remote.has_authority,
            remote.armed,
        )

    def _report(self, text: str) -> None:
        """Report a line to the user and to the log."""
        self._tell(text)
        self._pilot.tell(text)
        if self._flight_log is not None:
            self._flight_log.write_event(text)
