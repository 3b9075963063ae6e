"""A vehicle as the autopilot's end sees it: whether it is there, armed, what it says, and what its clock shows.

Source: docs page, Fly; MAVLink's services heartbeat, command and timesync.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, seconds
from trimtab.live.connection_problem import (
    ConnectionProblem,
    clock_problem,
    key_problem,
    scenario_problem,
    signing_problem,
)
from trimtab.wire.arming import CONFIRMATION, RemoteChecks
from trimtab.wire.definitions import Message
from trimtab.wire.identity import TUNNEL, IdentityComparison
from trimtab.wire.mavlink import Endpoint, UntimelyMessage
from trimtab.wire.protocol import (
    VERSION_MESSAGE,
    CommandCode,
    CommandResult,
    FlightCommand,
    ModeFlag,
    State,
    VehicleType,
    parse_request,
)
from trimtab.wire.station import OWNED_COMMANDS
from trimtab.wire.streams import TextAssembly
from trimtab.wire.time_sync import TimeSync

NO_AUTOPILOT = 8
HEARTBEAT = {"type": VehicleType.ONBOARD_COMPUTER, "autopilot": NO_AUTOPILOT, "system_status": 4}
"""Of an onboard computer that is no flight controller, running."""
MOST_ASKS = 4
"""Unanswered questions for it, after which the vehicle is one that doesn't know what it could be asked."""
MOST_REQUESTS = 8
HEARTBEAT_PERIOD, ASK_PERIOD, DISARM_PERIOD = seconds(1), ms(500), ms(100)
SYNC_QUICK, SYNC_SLOW = ms(50), seconds(1)
QUICK_ANSWERS = 8
"""Answers after which the other clock counts as known, and is asked for seldom."""
TOGETHER = seconds(1)
"""A vehicle whose own end came no longer than this before the flight's has ended with it: where both were given one
length, the vehicle counts it from its release, and this end from when it heard of that."""
QUICK_ROUND_TRIP = ms(300)
"""At least one answer must have been as quick as this: what waited in a queue tells little of a clock."""


class RemoteVehicle:
    """Keeps the line to a vehicle: heartbeats, time synchronisation, arming. Times `now` are this end's, in 100 ns."""

    def __init__(
        self,
        endpoint: Endpoint,
        link: Link,
        typed: str = "trimtab fly SCENARIO --link URI",
        identity: IdentityComparison | None = None,
        accepts: Sequence[str] = (),
    ) -> None:
        """Nothing known yet.

        Args:
            endpoint: this end of the line.
            link: to the vehicle.
            typed: the command that people are told to type again, with what was missing.
            identity: compares the two scenarios; None compares their messages alone.
            accepts: paths at or below which the two may differ.
        """
        self._identity, self._accepts = identity, tuple(accepts)
        self._dialect_problem = ""
        self._endpoint, self._link, self.typed = endpoint, link, typed
        self.sync = TimeSync()
        self.tell: Callable[[str], None] = lambda _: None
        self.armed = self.has_failed_safe = False
        """It says that it is armed; it has stood in failsafe while it was this end's."""
        self.is_in_failsafe = False
        self.system = self.component = 0
        self.heartbeat_time: int | None = None
        """When the vehicle's last heartbeat came."""
        self._end_time: int | None = None
        """When it was heard that it is not armed any more, for its own end has come."""
        self.misfit = ""
        """Why its messages can't be understood; empty while nothing speaks against it."""
        self.remarks: list[str] = []
        """What people have accepted before the flight; its log has it, too."""
        self.untimely: UntimelyMessage | None = None
        """The vehicle's answer to a question of now, refused for its stamp: the two clocks differ."""
        self.owner = 0
        """Session of who flies it, as it said last; 0: nobody, or it doesn't say."""
        self.has_authority = False
        """Whether it has taken this end for its owner."""
        self.mode: int | None = None
        """What this end's supervisor does, told in heartbeats; None: there is none that could be asked."""
        self.checks = RemoteChecks()
        """What the vehicle looks at before it is armed; asked for while `wants_checks`."""
        self.wants_checks = self.confirms = False
        """confirms: that it may be armed again after a failsafe."""
        self._texts = TextAssembly()
        self.requests: deque[str] = deque(maxlen=MOST_REQUESTS)
        """What a ground station wants of the supervisor, as the vehicle passed it on."""
        self._last_mode: int | None = None
        self._next = dict.fromkeys(("heartbeat", "sync", "ask", "version"), 0)
        self._arming_request: float | None = None
        self._clock_answers = self._jumps = 0
        self._version_asks, self._compared, self._is_identity_told = 0, False, False
        self._vehicle_session = 0
        self._takes_over = False

    def is_of_vehicle(self, message: Message) -> bool:
        """Whether a message is of the vehicle that was heard first."""
        return self.heartbeat_time is not None and (message.system, message.component) == (self.system, self.component)

    @property
    def is_ready(self) -> bool:
        """Whether there is a vehicle whose clock is known."""
        is_compared = self._compared and (self._identity is None or self._is_identity_told)
        return self.heartbeat_time is not None and self._is_clock_known and is_compared and not self.misfit

    @property
    def _is_clock_known(self) -> bool:
        return self._clock_answers >= QUICK_ANSWERS and self.sync.shortest <= QUICK_ROUND_TRIP

    def find_problem(self, scenario: str) -> ConnectionProblem:
        """Why it is not ready, for people."""
        counts, traffic, stamps = self._endpoint.counts, self._link.statistics, self._endpoint.stamps
        start = f"trimtab vehicle {scenario} --listen …, with the same --set on both ends"
        differences = [] if self._identity is None else self._identity.differences(self.accepts)
        if differences:
            return scenario_problem(differences, self.typed)
        if self.misfit or self._dialect_problem:
            return ConnectionProblem(self.misfit or self._dialect_problem, start)
        if self.untimely is not None and stamps is not None:
            return clock_problem(self.untimely.lead, stamps.stored_lead, self.typed)
        if counts.wrong_signature:
            return key_problem(counts.wrong_signature, self.typed)
        if counts.unsigned or (counts.unchecked and self.heartbeat_time is None):
            return signing_problem(stamps is not None, self.typed)
        if not traffic.packets_in:
            lost = "" if traffic.connected else ": there is no connection"
            return ConnectionProblem(f"no vehicle answers{lost}", start)
        if counts.checksum or counts.unknown:
            problem = f"wrong scenario: {counts.checksum + counts.unknown} frames don't fit"
            return ConnectionProblem(problem, start)
        return ConnectionProblem("a vehicle answers, but its clock is not known yet", start)

    def accepts(self, path: str) -> bool:
        """Whether the two ends may differ in a setting."""
        return path != "messages" and any(path == own or path.startswith(f"{own}.") for own in self._accepts)

    def _compare_identities(self) -> None:
        """What the vehicle has said of itself, once it is whole; what is accepted is told."""
        identity = self._identity
        if identity is None or self.misfit or not (identity.is_known or identity.is_unanswered):
            return
        if identity.differences(self.accepts):
            self.misfit = "wrong scenario"
        elif self._dialect_problem:
            self.misfit = self._dialect_problem
        elif not self._is_identity_told:
            self._is_identity_told = True
            self.remarks += [f"accepted: {difference}" for difference in identity.differences()]
            if identity.is_unanswered:
                self.remarks.append("the vehicle can't say which scenario it flies: only its messages were compared")
            for remark in self.remarks:
                self.tell(remark)

    def count_differences(self) -> int:
        """Settings in which the vehicle differs from this end, and that nobody has accepted."""
        return 0 if self._identity is None else len(self._identity.differences(self.accepts))

    def handle_untimely(self, untimely: Sequence[UntimelyMessage]) -> None:
        """Note that the vehicle's clock is another, where a refused frame answers a question of this end."""
        for refused in untimely:
            message = refused.message
            if message.name == "TIMESYNC" and message.get("tc1") > 0 and self.sync.is_open(message.get("ts1")):
                if self.untimely is None:
                    which = "ahead of" if refused.lead > 0 else "behind"
                    self.tell(f"the vehicle's time stamps are {abs(refused.lead):.1f} s {which} this end's: refused")
                self.untimely = refused

    def follow_clock(self) -> None:
        """Sign from now on by the clock of the vehicle that has answered."""
        if self.untimely is not None and self._endpoint.stamps is not None:
            self._endpoint.stamps.follow(self.untimely.stamp)
            self.remarks.append(f"goes by the vehicle's clock, {self.untimely.lead:+.1f} s from this computer's")
            self.tell(self.remarks[-1])
        self.untimely = None

    def offset(self, now: int) -> int:
        """The vehicle's clock minus this end's (100 ns), as it is applied now: it turns, and does not jump."""
        return self.sync.to_remote(now) - now

    def handle_message(self, message: Message, now: int) -> None:
        """Follow a message that is no sample."""
        if message.name == "HEARTBEAT" and message.get("autopilot") != NO_AUTOPILOT:
            self._handle_heartbeat(message, now)
        elif (message.system, message.component) != (self.system, self.component):
            return  # of a ground station, or of another vehicle, passed on by a router
        elif message.name == "TIMESYNC":
            self._handle_time_sync(message, now)
        elif message.name == "STATUSTEXT":
            text = self._texts.join(message)
            if text:
                self.tell(f"vehicle: {text}")
        elif message.name == "COMMAND_ACK":
            self._handle_acknowledgement(message)
        elif message.name == "COMMAND_LONG":
            self._handle_request(message)
        elif message.name == TUNNEL:
            self.checks.handle_message(message, now)
            if self._identity is not None:
                self._identity.handle_message(message)
        elif message.name == "AUTOPILOT_VERSION":
            self._compare_dialects(bytes(message.get("flight_custom_version")))
            self._compare_sessions(message.get("uid") >> 8)

    def _handle_heartbeat(self, message: Message, now: int) -> None:
        if self.heartbeat_time is None:
            self.system, self.component = message.system, message.component
        if (message.system, message.component) != (self.system, self.component):
            return
        armed = bool(message.get("base_mode") & ModeFlag.ARMED)
        if self.armed and not armed:
            self._end_time = now if message.get("system_status") == State.POWEROFF else None
            self.tell("the vehicle is not armed any more")
        self.is_in_failsafe = message.get("system_status") == State.CRITICAL
        self.has_failed_safe |= self.has_authority and self.is_in_failsafe
        if not armed:
            self.owner = 0
        self.heartbeat_time, self.armed = now, armed

    def _handle_time_sync(self, message: Message, now: int) -> None:
        if not self.sync.handle_answer(message.get("tc1"), message.get("ts1"), now):
            if self.sync.doubles:
                self._note_second_vehicle("one question for the time had two answers")
            return
        if self.sync.is_doubtful:
            self._next["sync"] = now
            return
        if self.sync.jumps != self._jumps:  # it was started anew, say
            self._jumps, self._clock_answers = self.sync.jumps, 0
            self.tell("the vehicle's clock is another now")
        self._clock_answers = min(self._clock_answers + 1, QUICK_ANSWERS)

    def _handle_acknowledgement(self, message: Message) -> None:
        ours = ("target_system", self._endpoint.system), ("target_component", self._endpoint.component)
        if any(message.get(field) not in (0, own) for field, own in ours):
            return
        command, accepted = message.get("command"), message.get("result") == CommandResult.ACCEPTED
        owner = message.get("result_param2")
        if command in OWNED_COMMANDS:
            self._follow_owner(owner)
        is_ours = owner in (0, self._endpoint.session)  # else another end of this system and component was answered
        if command == CommandCode.ARM and accepted and is_ours and self._arming_request is not None:
            self.armed = self.has_authority = bool(self._arming_request)
            self._arming_request = None
        elif command == CommandCode.ARM and not is_ours and self._arming_request == 0.0:
            self._arming_request = None  # it is another's, and so is its end
        elif command == CommandCode.RUN_CHECKS and not accepted:
            self.checks.handle_refusal()
        elif command == CommandCode.REQUEST_MESSAGE and not accepted:
            self._compared = True

    def _follow_owner(self, owner: int) -> None:
        """Whose the vehicle is; not this end's any more where it has become another's."""
        self.owner = owner
        if self.has_authority and owner not in (0, self._endpoint.session):
            self.has_authority = False
            self.tell(f"the vehicle belongs to another autopilot now, session {owner:06x}")
        elif owner == self._endpoint.session:
            self._takes_over = False
            if self._arming_request:  # it tells all on the line, also where its acknowledgement was lost
                self.armed = self.has_authority = True
                self._arming_request = None

    @property
    def is_taken(self) -> bool:
        """Whether it is another's, and this end does not ask for it."""
        return self.owner not in (0, self._endpoint.session) and not self._takes_over

    def _handle_request(self, message: Message) -> None:
        """The vehicle passes on what a ground station wants; its own commands to others are none of this end's."""
        own = self._endpoint.system, self._endpoint.component
        if (message.get("target_system"), message.get("target_component")) != own:
            return
        request = parse_request(FlightCommand(*(message.get(n) for n in ("command", "param1", "param2"))))
        result = CommandResult.ACCEPTED if request and self.mode is not None else CommandResult.UNSUPPORTED
        if request and self.mode is not None:
            self.requests.append(request)
        answer = {"command": message.get("command"), "result": result}
        to = {"target_system": message.system, "target_component": message.component}
        self._link.send(self._endpoint.pack("COMMAND_ACK", answer | to))

    def _compare_dialects(self, theirs: bytes) -> None:
        """Whether the vehicle has the same messages; one that doesn't say so is believed, for checksums tell too."""
        ours = self._endpoint.dialect.fingerprint
        self._compared = True
        if any(theirs) and theirs != ours:
            both = f"its dialect is {theirs.hex()}, this scenario's {ours.hex()}"
            self._dialect_problem = f"wrong scenario: the vehicle has other sensors, or takes other commands: {both}"
            if self._identity is None:
                self.misfit = self._dialect_problem

    def _compare_sessions(self, session: int) -> None:
        """One vehicle has one session as long as it runs."""
        if self._vehicle_session not in (0, session):
            self._note_second_vehicle(f"sessions {self._vehicle_session:06x} and {session:06x}")
        self._vehicle_session = session

    def _note_second_vehicle(self, by: str) -> None:
        self.misfit = f"two vehicles answer on this line as {self.system}/{self.component}: {by}"

    def list_problems(self, was_armed: bool, is_silent: bool, now: int, is_stopped: bool = False) -> list[str]:
        """What a script should know of a vehicle at the end of its flight, before it is disarmed.

        is_stopped: a pilot has disarmed it.
        """
        ends_with_it = self._end_time is not None and now - self._end_time <= TOGETHER
        is_disarmed = not (self.armed or ends_with_it or self.is_taken)
        problems = {
            "the vehicle was never armed": not was_armed,
            "the vehicle's failsafe acted": self.has_failed_safe,
            "the vehicle was not armed at the end": was_armed and is_disarmed and not is_stopped,
            "nothing was heard from the vehicle at the end": was_armed and is_silent,
        }
        return [text for text, holds in problems.items() if holds]

    def due(self, now: int) -> None:
        """Send what is to be sent by now."""
        if now >= self._next["heartbeat"] or self.mode != self._last_mode:
            self._next["heartbeat"], self._last_mode = now + HEARTBEAT_PERIOD, self.mode
            mode = {} if self.mode is None else {"base_mode": ModeFlag.CUSTOM, "custom_mode": self.mode}
            self._link.send(self._endpoint.pack("HEARTBEAT", HEARTBEAT | mode))
        if now >= self._next["sync"]:
            is_settled = self._is_clock_known and not self.sync.is_doubtful
            self._next["sync"] = now + (SYNC_SLOW if is_settled else SYNC_QUICK)
            self._link.send(self._endpoint.pack("TIMESYNC", self.sync.ask(now)))
        if self._arming_request is not None and now >= self._next["ask"]:
            self._next["ask"] = now + (ASK_PERIOD if self._arming_request else DISARM_PERIOD)
            sessions = {"param3": self._endpoint.session, "param4": self._vehicle_session}
            if self._takes_over:
                control = {"param2": 1, "param5": self._endpoint.session, "param6": self._vehicle_session}
                self._send_command(CommandCode.REQUEST_CONTROL, self._endpoint.system, control)
            confirmation = {"param2": float(CONFIRMATION)} if self.confirms and self._arming_request else {}
            self._send_command(CommandCode.ARM, self._arming_request, sessions | confirmation)
        if self.wants_checks and self.checks.is_due(now):
            self._send_command(CommandCode.RUN_CHECKS, 0)
        if self.heartbeat_time is not None and not self._compared and now >= self._next["version"]:
            self._next["version"] = now + ASK_PERIOD
            self._version_asks += 1
            self._compared = self._version_asks > MOST_ASKS
            self._send_command(CommandCode.REQUEST_MESSAGE, VERSION_MESSAGE)
        if self.heartbeat_time is not None and self._identity is not None and not self._is_identity_told:
            for packet in self._identity.due(now, self.system, self.component):
                self._link.send(packet)
            self._compare_identities()

    @property
    def is_asking(self) -> bool:
        """Whether it has been asked to arm or disarm and has not answered yet."""
        return self._arming_request is not None

    def arm(self, *, takes_over: bool = False) -> None:
        """Ask the vehicle to arm, again and again until it has answered; armed already, it is asked whose it is.

        takes_over: have it handed over by whoever flies it.
        """
        if self._arming_request is None and not self.has_authority:
            self._takes_over = takes_over
            self._arming_request, self._next["ask"] = 1.0, 0

    def disarm(self) -> None:
        """Ask the vehicle to disarm, again and again until it has answered."""
        self._arming_request, self._next["ask"] = 0.0, 0

    def _send_command(self, command: CommandCode, first: float, others: Mapping[str, float] | None = None) -> None:
        fields = {"command": command, "param1": first, "target_system": self.system, "target_component": 0}
        self._link.send(self._endpoint.pack("COMMAND_LONG", fields | dict(others or {})))
