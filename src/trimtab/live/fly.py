"""fly: an autopilot in real time against a vehicle at the far end of a line.

One thread: it waits for packets until the next absolute deadline, makes one compiled step, sends the command, and hands
a row to the log's process. Nothing in it waits for a disk, a console or a network.

What the supervisor is asked in flight goes into the frame, as the sample that it reads; so the flight's log has it, and
a replay repeats it.
Source: docs pages, Fly and Supervisor.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic_ns
from typing import NamedTuple

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity
from trimtab.core.time import SECONDS_PER_UNIT, UNITS_PER_SECOND, ms, seconds, to_seconds
from trimtab.live.autopilot_end import AutopilotEnd, scenario_dialect
from trimtab.live.flight_log import WRITER_DIED, FlightLog, count_frames, frame_signals, open_flight_log
from trimtab.live.real_time import NS, Deadlines, RealTimeGrant, discard_packets, real_time
from trimtab.live.remote import RemoteVehicle
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.pilot_script import add_pilot_sensor
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import ENDED, FLYING, HOLD, REQUESTS
from trimtab.run.blocks import compile_autopilot
from trimtab.wire.dialect import Dialect
from trimtab.wire.mavlink import Endpoint

REQUEST_MODES = {"hold": HOLD, "resume": FLYING, "end": ENDED}
"""Where a request leads: it isn't made again where that is so already, say because its acknowledgement was lost."""
LONGEST_DELAY = seconds("0.5")
"""How far behind the loop may be before it gives up catching up and goes on from now."""
MOST_PACKETS = 64
"""Packets taken in one period, so that a flood can't stop the loop."""
SERVO_FRAME = ms(20)
"""Commands are sent no more often than a servo takes them."""
PATIENCE_FACTOR = 3
"""So many times as long it waits for a vehicle's clock where frames come at all."""
SILENCE = ms(250)
"""After which it is said that nothing comes."""
DISARM_TIMEOUT = seconds("0.5")
"""How long it waits for an answer when it disarms."""
OWN_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "loop.late": ("f8", Quantity("s", "From the deadline to the wake-up.")),
    "loop.step": ("f8", Quantity("s", "The compiled step alone.")),
    "loop.overruns": ("i8", Quantity("1", "Periods so far whose work ended after the next deadline.", kind="count")),
    "loop.skipped": ("i8", Quantity("1", "Periods so far that were passed over.", kind="count")),
    "link.samples": ("i8", Quantity("1", "Samples heard so far.", kind="count")),
    "link.overtaken": ("i8", Quantity("1", "Samples so far that came after a later one.", kind="count")),
    "link.silence": ("f8", Quantity("s", "Time since the vehicle was last heard.")),
    "link.offset": ("f8", Quantity("s", "The vehicle's clock minus this one.")),
    **frame_signals("link"),
    "link.connected": ("?", Quantity("1", "The transport has a connection.", kind="flag")),
    "vehicle.armed": ("?", Quantity("1", "The vehicle says that it is armed.", kind="flag")),
}
"""What a row of a flight's log has besides frame and outputs."""


class CompiledSupervisor:
    """The supervisor of a compiled step; where there is none, it decides nothing and takes no requests."""

    def __init__(self, scenario: Scenario, step: CompiledBlock) -> None:
        """step: the compiled autopilot of this scenario."""
        self._step = step
        declared = {m.path: m.declaration for m in step.text.outputs}
        paths = ("supervisor.mode", "supervisor.cause")
        self._codes = [(step.writes[p], d.modes) for p in paths if (d := declared.get(p)) is not None]
        self._last_codes: tuple[int, ...] = ()
        supervisor = scenario.autopilot.supervisor
        sample = "" if supervisor is None else f"samples.{supervisor.pilot}"
        fields = ("value.request", "t", "age", "fresh", "valid")
        slots = {f: step.reads[path] for f in fields if (path := f"{sample}.{f}") in step.reads}
        self._slots = slots if len(slots) == len(fields) and self._codes else None
        self._request: str | None = None

    @property
    def mode(self) -> int | None:
        """The supervisor's, by its number; None where there is none, or it can't be asked."""
        return None if self._slots is None else int(self._step.outputs[self._codes[0][0]])

    def request(self, request: str) -> None:
        """Make a request in the next step, unless it would change nothing."""
        self._request = None if self.mode in (None, REQUEST_MODES[request]) else request

    def set_inputs(self, t: int) -> None:
        """What the step at integer time t reads of requests."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["fresh"]] = self._request is not None
        if self._request is not None:
            inputs[at["value.request"]], inputs[at["t"]], inputs[at["valid"]] = REQUESTS.index(self._request), t, True
            self._request = None
        inputs[at["age"]] = (t - inputs[at["t"]]) * SECONDS_PER_UNIT

    def describe_changes(self) -> str:
        """What it has decided since this was last asked, for people; empty for nothing."""
        codes = tuple(int(self._step.outputs[at]) for at, _ in self._codes)
        if codes == self._last_codes:
            return ""
        self._last_codes = codes
        return "supervisor: " + ": ".join(names[k] for (_, names), k in zip(self._codes, codes, strict=True))


class LiveFlightSummary(NamedTuple):
    """What became of a flight. arming_time: when the vehicle first said that it is armed (100 ns), None if never."""

    t: int
    arming_time: int | None
    grant: RealTimeGrant
    deadlines: Deadlines
    log: LogFileSummary | None


class LiveAutopilot:
    """The autopilot's end of a line; `fly` runs it."""

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        endpoint: Callable[[Dialect], Endpoint],
        *,
        seed: int = 0,
        step: CompiledBlock | None = None,
    ) -> None:
        """Compile it. endpoint: makes the autopilot's end for a dialect; step: the compiled autopilot, if there is."""
        scenario.check()
        dialect = scenario_dialect(scenario)
        self.scenario, self.link, self.seed = add_pilot_sensor(scenario), link, seed
        self.endpoint = endpoint(dialect)
        self.autopilot_end = AutopilotEnd(scenario, dialect, step or compile_autopilot(self.scenario, seed=seed))
        self.supervised = CompiledSupervisor(self.scenario, self.autopilot_end.step)
        self.remote = RemoteVehicle(self.endpoint, link)
        self.deadlines = Deadlines(scenario.autopilot.period)
        self.skipped = 0
        self.arming_time: int | None = None
        self._sent = self._jumps = self._accepted = self._receive_time = 0
        self._silent = False
        self._flight_log: FlightLog | None = None
        self._tell: Callable[[str], None] = lambda _: None

    def connect(self, patience: float = 10.0, stop: Callable[[], bool] = lambda: False) -> None:
        """Wait for the vehicle, and for its clock; refused where nobody answers in `patience` seconds.

        A line over which frames do come may be a bad one, that loses most heartbeats: it has three times as long.
        """
        began = monotonic_ns()
        while not self.remote.is_ready and not stop():
            now = monotonic_ns()
            waits = patience * (PATIENCE_FACTOR if self.endpoint.counts.accepted else 1)
            if now - began > waits * 1e9 or self.remote.misfit:
                fix = f"trimtab vehicle {self.scenario.name} --listen …, with the same --set on both ends"
                raise InputError("--link", self.remote.reason_not_ready(), fix=fix)
            self.remote.due(now // NS)
            data = self.link.receive(0.02)
            if data is not None:
                self._handle_data(data)

    def _handle_data(self, data: bytes) -> None:
        now = monotonic_ns() // NS
        for message in self.endpoint.feed(data):
            if not self.autopilot_end.handle_message(message):
                self.remote.handle_message(message, now)

    def fly(
        self,
        *,
        duration: int | None = None,
        log: Path | None = None,
        wanted_real_time: bool = True,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> LiveFlightSummary:
        """Arm as soon as there is an estimate, fly for `duration` (100 ns) from then on, disarm.

        Args:
            duration: the scenario's when None.
            log: file of the flight's log.
            wanted_real_time: ask the system for real-time scheduling and locked memory.
            stop: asked every period.
            tell: is given lines for people.
        """
        length = self.scenario.duration if duration is None else duration
        sources, log_period = self.autopilot_end.log_sources(), self.scenario.autopilot.period
        flight_log = self._flight_log = open_flight_log(
            log, sources, OWN_SIGNALS, self.scenario, side="autopilot", seed=self.seed, log_period=log_period
        )
        self._tell, self.remote.tell = tell, self._report
        discard_packets(self.link)
        self.autopilot_end.drop_samples()
        try:
            with real_time(wanted_real_time) as grant:
                try:
                    t = self._run_loop(length, stop)
                finally:
                    if self.arming_time is not None or self.remote.is_asking:  # else it is none of this end's business
                        self._disarm()
        finally:
            self._flight_log = None
            summary = flight_log.close() if flight_log else None
        if flight_log is not None and summary is None:
            tell(WRITER_DIED)
        return LiveFlightSummary(t, self.arming_time, grant, self.deadlines, summary)

    def _run_loop(self, length: int, stop: Callable[[], bool]) -> int:
        flight_log, period = self._flight_log, self.scenario.autopilot.period
        every = -(-max(period, SERVO_FRAME) // period)
        deadlines = self.deadlines = Deadlines(period)
        self._receive_time = deadlines.start // NS
        k = t = 0
        while not stop() and (self.arming_time is None or t - self.arming_time < length):
            t = k * period
            woke = self._receive_until(k)
            now = deadlines.start // NS + t
            ahead = deadlines.start // NS + self.remote.offset(now)  # from the loop's time to the vehicle's
            self.autopilot_end.set_inputs(t, self._to_local)
            self.supervised.set_inputs(t)
            began = monotonic_ns()
            self.autopilot_end.step.step()
            stepped = monotonic_ns()
            if k % every == 0 and deadlines.remaining(k + every) > 0:  # else there are newer ones soon
                self._send_command(t, ahead)
            self._update_line(t)
            self._report_silence(now)
            if flight_log is not None:
                flight_log.write_row(t, self._own_signals(now, woke - deadlines.start - t * NS, stepped - began))
            deadlines.record_period(k, woke, began, stepped)
            k = self._next_period(k)
        return t

    def _send_command(self, t: int, ahead: int) -> None:
        """The command of now, on the vehicle's clock; its times rise, also where that clock turns out to be earlier."""
        if t + ahead <= self._sent and self.remote.sync.jumps == self._jumps:
            ahead = self._sent + 1 - t
        self._sent, self._jumps = t + ahead, self.remote.sync.jumps
        for packet in self.autopilot_end.command_packets(self.endpoint, ahead):
            self.link.send(packet)

    def _disarm(self) -> None:
        """Ask until it is acknowledged, for half a second: soon after the vehicle's failsafe does it by itself."""
        self.remote.disarm()
        deadline = monotonic_ns() + DISARM_TIMEOUT * NS
        while self.remote.is_asking and monotonic_ns() < deadline:
            data = self.link.receive(0.02)
            if data is not None:
                self._handle_data(data)
            self.remote.due(monotonic_ns() // NS)

    def _to_local(self, t: int) -> int:
        """The vehicle's time as the loop's."""
        return self.remote.sync.to_local(t) - self.deadlines.start // NS

    def _receive_until(self, k: int) -> int:
        """Take what comes until deadline k; returns when that was (ns)."""
        packets = 0
        while True:
            left = self.deadlines.remaining(k)
            data = self.link.receive(max(left, 0.0))
            if data is not None:
                self._handle_data(data)
            packets += 1
            if left <= 0 and (data is None or packets > MOST_PACKETS):
                return monotonic_ns()

    def _next_period(self, k: int) -> int:
        """The period after k: the next one, or, far behind, the one that is due now."""
        behind = -round(self.deadlines.remaining(k + 1) * UNITS_PER_SECOND)
        if behind < LONGEST_DELAY:
            return k + 1
        passed = behind // self.deadlines.period
        self.skipped += passed
        return k + 1 + passed

    def _update_line(self, t: int) -> None:
        """Arm when there is something to fly with; keep the line."""
        if self.arming_time is None and self.remote.armed:
            self.arming_time = t
        elif self.arming_time is None and self.autopilot_end.has_command:
            self.remote.arm()
        self._report_supervisor()
        self.remote.due(monotonic_ns() // NS)  # not the deadline, which may be long past: its answer is timed

    def _report_supervisor(self) -> None:
        """Say what the supervisor has decided, and pass it what it is asked."""
        self.remote.mode = self.supervised.mode
        if self.remote.requests:
            self.supervised.request(self.remote.requests.popleft())
        news = self.supervised.describe_changes()
        if news:
            self.remote.tell(news)

    def _report_silence(self, now: int) -> None:
        """Say when nothing comes any more, and when it does again."""
        accepted, silence = self.endpoint.counts.accepted, now - self._receive_time
        if accepted != self._accepted:
            if self._silent:
                self._report(f"the vehicle is heard again, after {to_seconds(silence):.3f} s")
            self._accepted, self._receive_time, self._silent = accepted, now, False
        elif silence >= SILENCE and not self._silent:
            self._silent = True
            self._report(f"nothing from the vehicle for {to_seconds(silence):.3f} s")

    def _own_signals(self, now: int, late: int, step: int) -> tuple[float, ...]:
        remote, deadlines = self.remote, self.deadlines
        return (
            late * 1e-9,
            step * 1e-9,
            deadlines.own + deadlines.scheduler,
            self.skipped,
            self.autopilot_end.received_samples,
            self.autopilot_end.overtaken_samples,
            (now - self._receive_time) / UNITS_PER_SECOND,
            remote.offset(now) / UNITS_PER_SECOND,
            *count_frames(self.endpoint.counts),
            self.link.fileno() >= 0,
            remote.armed,
        )

    def _report(self, text: str) -> None:
        """A line to people and into the log."""
        self._tell(text)
        if self._flight_log is not None:
            self._flight_log.write_event(text)
