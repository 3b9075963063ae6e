"""What a pilot at a console wants of a flight, and what the flight tells the console.

Wishes are taken once a period and go where they go without a console: requests to the supervisor, numbers to the
parameters, the stick into the frame, as the sample that the law reads. So the flight's log has them, and a replay
repeats them. A stick that falls silent is the dead man's: hold, then the end.
Source: docs page, Console.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.live.autopilot_parameters import AutopilotParameters
from trimtab.live.console_line import ConsoleLine
from trimtab.live.console_packets import END_SILENCE, ROW_PERIOD
from trimtab.live.preflight import Preflight
from trimtab.live.real_time import Deadlines
from trimtab.live.remote import RemoteVehicle
from trimtab.live.stick import CompiledStick
from trimtab.live.supervised import REQUEST_MODES, CompiledSupervisor
from trimtab.loop.supervisor import ENDED, HOLD

HOLD_SILENCE = ms(500)
"""Of a stick that somebody has, after which the supervisor is asked to hold; after END_SILENCE the flight is ended."""
CHECK_PERIOD, TIMING_PERIOD = ms(500), seconds(1)


class NoPilot:
    """A flight without a console: it arms when it may, and nobody is told."""

    wants_arming, shows_checks, has_stopped = True, False, False
    end_reason = ""

    def update(self, t: int) -> None:
        """Nobody wishes anything."""

    def decide_arming(self, may_arm: bool) -> bool:
        """Arm as soon as nothing speaks against it."""
        return may_arm

    def note_command(self) -> None:
        """Nobody measures."""

    def show(self, t: int, own: Sequence[float], deadlines: Deadlines) -> None:
        """Nobody looks."""

    def tell(self, text: str) -> None:
        """Nobody listens."""


class Piloting:
    """A flight's pilot. Times `t` are the loop's, in 100 ns."""

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
        """report: takes lines for the user and for the log.  clock: clock of this process."""
        self._clock = clock
        self._line, self._stick, self._supervised, self._parameters = line, stick, supervised, parameters
        self._remote, self._preflight, self._report = remote, preflight, report
        self.wants_arming, self.shows_checks, self.has_stopped = False, True, False
        """A pilot has asked to arm, and it is not armed yet; checks are shown also before; the flight was ended."""
        self.end_reason = ""
        """Why the loop has to end: it was stopped, and there is no supervisor that could hold it ended."""
        self._t = 0
        self._pilot: int | None = None
        self._stick_time = 0
        self._is_held = False
        self._next = {"row": 0, "checks": 0, "timing": 0}
        self._stick_clocks: list[float] = []
        self._latencies: list[float] = []

    def update(self, t: int) -> None:
        """Take what has come, before the step at integer time t."""
        self._t = t
        for wish in self._line.receive():
            self._follow(wish, t)
        self._watch_stick(t)
        if self.has_stopped and self._supervised.mode not in (None, ENDED):
            self._supervised.request("end")
        self._stick.set_inputs(t)

    def decide_arming(self, may_arm: bool) -> bool:
        """Whether the vehicle is asked to arm now: when a pilot wants it, and nothing speaks against it."""
        refusal = self._preflight.refusal
        if refusal:
            self._preflight.restart()
            if self.wants_arming:
                self.wants_arming = False
                self._remote.disarm()
                self._report(refusal)
        return may_arm and self.wants_arming and not refusal

    def note_command(self) -> None:
        """A command was sent: so long it took from the console's server to the wire."""
        now = self._clock.monotonic_ns() / NS_PER_SECOND
        self._latencies += [now - clock for clock in self._stick_clocks]
        self._stick_clocks.clear()

    def show(self, t: int, own: Sequence[float], deadlines: Deadlines) -> None:
        """A row where one is due, and with some of them the checks before arming, or how deadlines are kept."""
        if t < self._next["row"]:
            return
        self._next["row"] = max(self._next["row"] + ROW_PERIOD, t)
        self._line.send_row(to_seconds(t), own)
        if t >= self._next["checks"] and not self._remote.has_authority:
            self._next["checks"] = t + CHECK_PERIOD
            self._line.send("checks", checks=[_describe_check(c) for c in self._preflight.describe_checks()])
        elif t >= self._next["timing"]:
            self._next["timing"] = t + TIMING_PERIOD
            self._send_timing(deadlines)

    def tell(self, text: str) -> None:
        """A line for people."""
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
            self._release(t, "the stick was given back")
        elif kind == "request":
            is_late = self._supervised.is_asked and wish["request"] != "end"
            if is_late:
                self._answer(wish, "another request is being taken: ask again", "")
            else:
                self._answer(wish, "", self._ask(wish["request"]))
        elif kind == "stop":
            self._stop("stopped from the console")
        elif kind == "set":
            refusal = self._parameters.change(wish["path"], wish["slot"], wish["value"])
            self._answer(wish, refusal, "set from the next step on")
            value = self._parameters.value(wish["path"], wish["slot"])
            self._line.send("value", path=wish["path"], slot=wish["slot"], value=value)
        elif kind == "save":
            self._answer(wish, self._parameters.ask_storage(), "stored when the flight ends")
        elif kind == "note":
            self._report(wish["text"])

    def _answer(self, wish: Mapping[str, Any], refusal: str, done: str) -> None:
        self._line.send("answer", id=wish.get("id"), client=wish["client"], ok=not refusal, text=refusal or done)

    def _ask(self, request: str) -> str:
        """What a pilot asks of the supervisor, and to arm of the vehicle; who is asked."""
        asks_vehicle = request == "arm" and not self._remote.has_authority
        if asks_vehicle:
            self._remote.confirms |= self.has_stopped
            self.wants_arming = True
            self._preflight.restart()
        if request == "clear":
            self.has_stopped = self._is_held = False
        if request in REQUEST_MODES and self._supervised.mode is not None:
            self._supervised.request(request)
        elif request == "end":
            self._stop("ended from the console")
        return f"the {'vehicle' if asks_vehicle else 'supervisor'} is asked"

    def _stop(self, why: str) -> None:
        """End the flight at once: no valid command from the next step on, and the vehicle disarmed."""
        if not self.has_stopped:
            self._report(why)
        self.has_stopped, self.wants_arming = True, False
        if self._remote.has_authority or self._remote.is_asking:
            self._remote.disarm()
        if self._supervised.mode is None:
            self.end_reason = why

    def _release(self, t: int, why: str) -> None:
        self._pilot = None
        self._stick.move(0.0, 0.0, self._stick.mode, t)
        self._report(f"{why}: hold")
        self._supervised.request("hold")

    def _watch_stick(self, t: int) -> None:
        """The dead man's rule."""
        silence = t - self._stick_time
        if self._pilot is None or silence < HOLD_SILENCE:
            return
        if silence >= END_SILENCE:
            self._pilot = None
            if self._remote.has_authority:
                self._stop(f"nothing from the stick for {to_seconds(END_SILENCE):g} s: the flight is ended")
        elif not self._is_held and self._remote.has_authority:
            self._is_held = self._supervised.mode in (None, HOLD)
            if not self._is_held:
                self._supervised.request("hold")

    def _send_timing(self, deadlines: Deadlines) -> None:
        edges, late = deadlines.late.count_doublings()
        _, work = deadlines.work.count_doublings()
        taken, self._latencies = sorted(self._latencies), []
        trip = to_seconds(self._remote.sync.shortest)
        self._line.send(
            "timing",
            deadlines={"period": to_seconds(deadlines.period), "edges": edges, "late": late, "work": work},
            overruns=deadlines.own + deadlines.scheduler,
            round_trip=trip if math.isfinite(trip) else None,
            stick_latency=taken[len(taken) // 2] if taken else None,
            longest_stick_latency=taken[-1] if taken else None,
        )


def _describe_check(check: Mapping[str, Any]) -> dict[str, Any]:
    """A check as the page shows it; a number that is not finite, so not measured or without a limit, is null."""
    numbers = {n: check[n] if math.isfinite(check[n]) else None for n in ("value", "limit")}
    texts = {"name": f"{check['of']}: {check['name']}", "unit": check["unit"]}
    return {**texts, **numbers, "ok": check["passes"], "reason": "" if check["passes"] else check["advice"]}
