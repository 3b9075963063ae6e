"""Pilot of a flight at a console: requests to the flight, and data for the console.

The console's messages are read once per control period. Requests are passed to the supervisor, values to the
parameters, and stick positions to the sensor sample that the law reads. So the flight's log contains them, and a replay
repeats them. If the data from the stick stop, the supervisor is asked to hold, and later the flight ends (dead man's
switch).
Source: docs page, Console.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.flight.autopilot_parameters import AutopilotParameters
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.console_packets import END_SILENCE, ROW_PERIOD
from trimtab.flight.preflight import Preflight
from trimtab.flight.real_time import Deadlines
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.stick import CompiledStick
from trimtab.flight.supervised import REQUEST_MODES, CompiledSupervisor
from trimtab.loop.supervisor import ENDED, HOLD

HOLD_SILENCE = ms(500)
"""Time (100 ns) without data from the stick in use after which the supervisor is asked to hold. After END_SILENCE the
flight ends.
"""
CHECK_PERIOD, TIMING_PERIOD = ms(500), seconds(1)
MOST_DROPPED = seconds(1) // ROW_PERIOD
"""Number of consecutive packets dropped by a console after which the console is reported: the rows of one second."""


class NoPilot:
    """Substitute for a pilot in a flight without a console. The vehicle is armed as soon as all checks pass."""

    wants_arming, shows_checks, has_stopped = True, False, False
    end_reason = ""

    def update(self, t: int) -> None:
        """Do nothing, because this flight has no pilot."""

    def decide_arming(self, may_arm: bool) -> bool:
        """Return True if all checks pass. Without a pilot, the vehicle is then armed."""
        return may_arm

    def note_command(self) -> None:
        """Do nothing, because no latency is measured without a console."""

    def show(self, t: int, own: Sequence[float], deadlines: Deadlines) -> None:
        """Do nothing, because this flight has no console."""

    def tell(self, text: str) -> None:
        """Do nothing, because this flight has no console."""


class Piloting:
    """Pilot at the console of a flight. Times `t` are those of the control loop, in 100 ns."""

    def __init__(
        self,
        line: ConsoleLine,
        stick: CompiledStick,
        supervised: CompiledSupervisor,
        parameters: AutopilotParameters,
        remote: RemoteVehicle,
        preflight: Preflight,
        report: Callable[[str], None],
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """report: function that receives the messages for the user and for the log.  clock: clock of this process."""
        self._clock = clock
        self._line, self._stick, self._supervised, self._parameters = line, stick, supervised, parameters
        self._remote, self._preflight, self._report = remote, preflight, report
        self.wants_arming, self.shows_checks, self.has_stopped = False, True, False
        """wants_arming: True if a pilot has asked to arm.  shows_checks: True to show the checks before arming.
        has_stopped: True if a pilot has ended the flight.
        """
        self.end_reason = ""
        """Reason to end the control loop, or "". A stop by the pilot ends the loop only if the autopilot has no
        supervisor. Otherwise the supervisor ends the flight."""
        self._t = 0
        self._pilot: int | None = None
        self._stick_time = 0
        self._is_held = False
        self._next = {"row": 0, "checks": 0, "timing": 0}
        self._console_problem = ""
        self._stick_clocks: list[float] = []
        self._latencies: list[float] = []

    def update(self, t: int) -> None:
        """Handle the messages received from the console, before the control period at integer time t."""
        self._t = t
        for wish in self._line.receive():
            self._follow(wish, t)
        self._watch_console()
        self._watch_stick(t)
        if self.has_stopped and self._supervised.mode not in (None, ENDED):
            self._supervised.request("end")
        self._stick.set_inputs(t)

    def decide_arming(self, may_arm: bool) -> bool:
        """Return True if a pilot has asked to arm and all checks pass."""
        refusal = self._preflight.refusal
        if refusal:
            self._preflight.restart()
            if self.wants_arming:
                self.wants_arming = False
                self._remote.arming.disarm()
                self._report(refusal)
        return may_arm and self.wants_arming and not refusal

    def note_command(self) -> None:
        """Record that a command was sent, to measure the latency of a stick position from the console's server to the
        link."""
        now = self._clock.monotonic_ns() / NS_PER_SECOND
        self._latencies += [now - clock for clock in self._stick_clocks]
        self._stick_clocks.clear()

    def show(self, t: int, own: Sequence[float], deadlines: Deadlines) -> None:
        """Send a log row to the console if a row is due. At a lower rate, also send the checks before arming, or the
        timing of the control loop."""
        if t < self._next["row"]:
            return
        self._next["row"] = max(self._next["row"] + ROW_PERIOD, t)
        self._line.send_row(to_seconds(t), own)
        if t >= self._next["checks"] and not self._remote.arming.has_authority:
            self._next["checks"] = t + CHECK_PERIOD
            self._line.send("checks", checks=[_describe_check(c) for c in self._preflight.describe_checks()])
        elif t >= self._next["timing"]:
            self._next["timing"] = t + TIMING_PERIOD
            self._send_timing(deadlines)

    def tell(self, text: str) -> None:
        """Send a message for the user to the console."""
        self._line.send("event", t=to_seconds(self._t), text=text)

    def _follow(self, wish: Mapping[str, Any], t: int) -> None:
        kind = wish.get("type")
        if kind == "stick" and self._pilot == wish["pilot"]:
            self._stick.move(wish["forward"], wish["turn"], wish["mode"], t)
            self._stick_time = t
            self._stick_clocks.append(wish["clock"])
        elif kind == "take":
            self._pilot, self._stick_time, self._is_held = wish["pilot"], t, False
            self._report(f"page {wish['pilot']} has the stick")
        elif kind == "release" and self._pilot == wish["pilot"]:
            self._release(t, "the pilot released the stick")
        elif kind == "request":
            is_late = self._supervised.is_asked and wish["request"] != "end"
            if is_late:
                self._answer(wish, "another request is pending: try again", "")
            else:
                self._answer(wish, "", self._ask(wish["request"]))
        elif kind == "stop":
            self._stop("stopped from the console")
        elif kind == "set":
            refusal = self._parameters.change(wish["path"], wish["slot"], wish["value"])
            self._answer(wish, refusal, "set, effective from the next control period")
            value = self._parameters.value(wish["path"], wish["slot"])
            self._line.send("value", path=wish["path"], slot=wish["slot"], value=value)
        elif kind == "save":
            self._answer(wish, self._parameters.ask_storage(), "will be stored when the flight ends")
        elif kind == "note":
            self._report(wish["text"])

    def _answer(self, wish: Mapping[str, Any], refusal: str, done: str) -> None:
        self._line.send("answer", id=wish.get("id"), client=wish["client"], ok=not refusal, text=refusal or done)

    def _ask(self, request: str) -> str:
        """Pass a pilot's request to the supervisor, or a request to arm to the vehicle.

        Return a text for the pilot that names the receiver of the request (supervisor or vehicle).
        """
        asks_vehicle = request == "arm" and not self._remote.arming.has_authority
        if asks_vehicle:
            self._remote.arming.confirms |= self.has_stopped
            self.wants_arming = True
            self._preflight.restart()
        if request == "clear":
            self.has_stopped = self._is_held = False
        if request in REQUEST_MODES and self._supervised.mode is not None:
            self._supervised.request(request)
        elif request == "end":
            self._stop("ended from the console")
        return f"sent to the {'vehicle' if asks_vehicle else 'supervisor'}"

    def _stop(self, why: str) -> None:
        """End the flight immediately: disarm the vehicle, and make all commands invalid from the next control period
        on."""
        if not self.has_stopped:
            self._report(why)
        self.has_stopped, self.wants_arming = True, False
        if self._remote.arming.has_authority or self._remote.arming.is_asking:
            self._remote.arming.disarm()
        if self._supervised.mode is None:
            self.end_reason = why

    def _release(self, t: int, why: str) -> None:
        self._pilot = None
        self._stick.move(0.0, 0.0, self._stick.mode, t)
        self._report(f"{why}: hold")
        self._supervised.request("hold")

    def _watch_console(self) -> None:
        """Report a console that has ended or accepts no data. Its pages then cannot stop the flight."""
        line, problem = self._line, ""
        if line.has_ended:
            problem = "the console has ended"
        elif line.dropped_in_a_row >= MOST_DROPPED:
            problem = "the console accepts no data"
        if problem == self._console_problem:
            return
        self._console_problem = problem
        rest = "its pages cannot stop the flight, use Ctrl-C" if problem else "the console accepts data again"
        self._report(f"{problem}: {rest}" if problem else rest)

    def _watch_stick(self, t: int) -> None:
        """If no data arrive from the stick in use, request the supervisor to hold, and later end the flight (dead man's
        switch)."""
        silence = t - self._stick_time
        if self._pilot is None or silence < HOLD_SILENCE:
            return
        if silence >= END_SILENCE:
            self._pilot = None
            if self._remote.arming.has_authority:
                self._stop(f"no data from the stick for {to_seconds(END_SILENCE):g} s: flight ended")
        elif not self._is_held and self._remote.arming.has_authority:
            self._is_held = self._supervised.mode in (None, HOLD)
            if not self._is_held:
                self._supervised.request("hold")

    def _send_timing(self, deadlines: Deadlines) -> None:
        edges, late = deadlines.late.count_doublings()
        _, work = deadlines.work.count_doublings()
        taken, self._latencies = sorted(self._latencies), []
        trip = to_seconds(self._remote.clock.sync.shortest)
        self._line.send(
            "timing",
            deadlines={"period": to_seconds(deadlines.period), "edges": edges, "late": late, "work": work},
            overruns=deadlines.own + deadlines.scheduler,
            round_trip=trip if math.isfinite(trip) else None,
            stick_latency=taken[len(taken) // 2] if taken else None,
            longest_stick_latency=taken[-1] if taken else None,
        )


def _describe_check(check: Mapping[str, Any]) -> dict[str, Any]:
    """Return a check as a dictionary for the page. A number that is not finite (not measured, or no limit) becomes
    None."""
    numbers = {n: check[n] if math.isfinite(check[n]) else None for n in ("value", "limit")}
    texts = {"name": f"{check['of']}: {check['name']}", "unit": check["unit"]}
    return {**texts, **numbers, "ok": check["passes"], "reason": "" if check["passes"] else check["advice"]}
