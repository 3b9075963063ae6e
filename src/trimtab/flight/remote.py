"""Vehicle as seen from the autopilot's end: presence, arming state, messages and clock.

Source: docs page, Fly; MAVLink's services heartbeat, command and timesync.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, seconds
from trimtab.flight.connection_problem import (
    ConnectionProblem,
    clock_problem,
    key_problem,
    scenario_problem,
    signing_problem,
)
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint, UntimelyMessage
from trimtab.flight.mavlink.protocol import (
    VERSION_MESSAGE,
    CommandCode,
    CommandResult,
    FlightCommand,
    ModeFlag,
    State,
    parse_request,
)
from trimtab.flight.station.arming import CONFIRMATION, RemoteChecks
from trimtab.flight.station.identity import TUNNEL, IdentityComparison
from trimtab.flight.station.standard_services import OWNED_COMMANDS
from trimtab.flight.station.streams import TextAssembly
from trimtab.flight.station.time_sync import TimeSync
from trimtab.vehicles.vehicle_type import VehicleType

NO_AUTOPILOT = 8
HEARTBEAT = {"type": VehicleType.ONBOARD_COMPUTER, "autopilot": NO_AUTOPILOT, "system_status": 4}
"""Heartbeat of a running onboard computer that is not a flight controller."""
MOST_ASKS = 4
"""Number of unanswered questions after which the vehicle counts as one that cannot answer them."""
MOST_REQUESTS = 8
HEARTBEAT_PERIOD, ASK_PERIOD, DISARM_PERIOD = seconds(1), ms(500), ms(100)
SYNC_QUICK, SYNC_SLOW = ms(50), seconds(1)
QUICK_ANSWERS = 8
"""Number of answers after which the vehicle's clock counts as known, and is asked for less often."""
COMMON_END = seconds(1)
"""Longest time between the vehicle's own end and the flight's end at which both count as one end."""
QUICK_ROUND_TRIP = ms(300)
"""Longest round trip of the quickest answer: an answer that waited in a queue says little about a clock."""


class RemoteVehicle:
    """Link to a vehicle: heartbeats, time synchronisation, arming. Times `now` are this end's, in 100 ns."""

    def __init__(
        self,
        endpoint: Endpoint,
        link: Link,
        typed: str = "trimtab fly SCENARIO --link URI",
        identity: IdentityComparison | None = None,
        accepts: Sequence[str] = (),
    ) -> None:
        """Start without a vehicle.

        Args:
            endpoint: this end of the link.
            link: link to the vehicle.
            typed: the command that messages tell the user to type again, with what was missing.
            identity: comparison of the two scenarios; None: only their messages are compared.
            accepts: settings in which the two may differ, by path; a path includes everything below it.
        """
        self._identity, self._accepts = identity, tuple(accepts)
        self._dialect_problem = ""
        self._endpoint, self._link, self.typed = endpoint, link, typed
        self.sync = TimeSync()
        self.tell: Callable[[str], None] = lambda _: None
        self.armed = self.has_failed_safe = False
        """armed: the vehicle reports that it is armed.  has_failed_safe: it was in failsafe while this end owned it."""
        self.is_in_failsafe = False
        self.system = self.component = 0
        self.heartbeat_time: int | None = None
        """Time of the vehicle's last heartbeat."""
        self._end_time: int | None = None
        """Time at which the vehicle reported that it is disarmed because of its own end."""
        self.misfit = ""
        """Reason why the vehicle's messages cannot be understood; empty if there is none."""
        self.remarks: list[str] = []
        """Differences that the user accepted before the flight. They are also logged."""
        self.untimely: UntimelyMessage | None = None
        """The vehicle's answer to a current question, rejected for its time stamp: the two clocks differ."""
        self.owner = 0
        """Session of the autopilot that flies the vehicle, as last reported; 0: none, or not reported."""
        self.has_authority = False
        """True while the vehicle accepts this end as its owner."""
        self.mode: int | None = None
        """Mode of this end's supervisor, sent in heartbeats; None: no supervisor that takes requests."""
        self.checks = RemoteChecks()
        """The vehicle's checks before arming. They are requested while `wants_checks`."""
        self.wants_checks = self.confirms = False
        """confirms: the user confirms that the vehicle may be armed again after a failsafe."""
        self._texts = TextAssembly()
        self.requests: deque[str] = deque(maxlen=MOST_REQUESTS)
        """Requests of ground stations to the supervisor, as the vehicle forwarded them."""
        self._last_mode: int | None = None
        self._next = dict.fromkeys(("heartbeat", "sync", "ask", "version"), 0)
        self._arming_request: float | None = None
        self._clock_answers = self._jumps = 0
        self._version_asks, self._compared, self._is_identity_told = 0, False, False
        self._vehicle_session = 0
        self._takes_over = False

    def is_of_vehicle(self, message: Message) -> bool:
        """Return whether a message comes from the vehicle that was received first."""
        return self.heartbeat_time is not None and (message.system, message.component) == (self.system, self.component)

    @property
    def is_ready(self) -> bool:
        """True if there is a vehicle whose clock is known."""
        is_compared = self._compared and (self._identity is None or self._is_identity_told)
        return self.heartbeat_time is not None and self._is_clock_known and is_compared and not self.misfit

    @property
    def _is_clock_known(self) -> bool:
        return self._clock_answers >= QUICK_ANSWERS and self.sync.shortest <= QUICK_ROUND_TRIP

    def find_problem(self, scenario: str) -> ConnectionProblem:
        """Return why the vehicle is not ready, as a message for the user."""
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
            problem = f"wrong scenario: {counts.checksum + counts.unknown} frames do not match its messages"
            return ConnectionProblem(problem, start)
        return ConnectionProblem("a vehicle answers, but its clock is not known yet", start)

    def accepts(self, path: str) -> bool:
        """Return whether the two ends may differ in a setting."""
        return path != "messages" and any(path == own or path.startswith(f"{own}.") for own in self._accepts)

    def _compare_identities(self) -> None:
        """Compare the vehicle's identity once it is complete, and report accepted differences."""
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
                self.remarks.append("the vehicle does not report its scenario: only its messages were compared")
            for remark in self.remarks:
                self.tell(remark)

    def count_differences(self) -> float:
        """Return the number of settings in which the vehicle differs from this end without being accepted.

        It is infinite while a setting has changed and the new ones are not all known.
        """
        identity = self._identity
        if identity is None or not self._is_identity_told or identity.is_unanswered:
            return 0
        return len(identity.differences(self.accepts)) if identity.is_known else math.inf

    def first_difference(self) -> str:
        """Return the path of the first setting that differs; "PATH" if none is known to differ."""
        differences = [] if self._identity is None else self._identity.differences(self.accepts)
        return differences[0].path if differences else "PATH"

    def handle_untimely(self, untimely: Sequence[UntimelyMessage]) -> None:
        """Note that the clocks differ, if a frame that was rejected for its time answers a question of this end."""
        for refused in untimely:
            message = refused.message
            if message.name == "TIMESYNC" and message.get("tc1") > 0 and self.sync.is_open(message.get("ts1")):
                if self.untimely is None:
                    which = "ahead of" if refused.lead > 0 else "behind"
                    self.tell(f"the vehicle's time stamps are {abs(refused.lead):.1f} s {which} this end's: rejected")
                self.untimely = refused

    def follow_clock(self) -> None:
        """Sign by the clock of the answering vehicle from now on."""
        if self.untimely is not None and self._endpoint.stamps is not None:
            self._endpoint.stamps.follow(self.untimely.stamp)
            self.remarks.append(f"signing by the vehicle's clock, {self.untimely.lead:+.1f} s from this computer's")
            self.tell(self.remarks[-1])
        self.untimely = None

    def offset(self, now: int) -> int:
        """Return the vehicle's clock minus this end's (100 ns), as applied now. It changes smoothly, without jumps."""
        return self.sync.to_remote(now) - now

    def handle_message(self, message: Message, now: int) -> None:
        """Handle a message that is not part of a sample."""
        if message.name == "HEARTBEAT" and message.get("autopilot") != NO_AUTOPILOT:
            self._handle_heartbeat(message, now)
        elif (message.system, message.component) != (self.system, self.component):
            return  # from a ground station, or of another vehicle, passed on by a router
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
            self.tell("the vehicle is no longer armed")
        self.is_in_failsafe = message.get("system_status") == State.CRITICAL
        self.has_failed_safe |= self.has_authority and self.is_in_failsafe
        if not armed:
            self.owner = 0
        self.heartbeat_time, self.armed = now, armed

    def _handle_time_sync(self, message: Message, now: int) -> None:
        if not self.sync.handle_answer(message.get("tc1"), message.get("ts1"), now):
            if self.sync.doubles:
                self._note_second_vehicle("two answers to one time request")
            return
        if self.sync.is_doubtful:
            self._next["sync"] = now
            return
        if self.sync.jumps != self._jumps:  # for example, because it was restarted
            self._jumps, self._clock_answers = self.sync.jumps, 0
            self.tell("the vehicle's clock has changed")
        self._clock_answers = min(self._clock_answers + 1, QUICK_ANSWERS)

    def _handle_acknowledgement(self, message: Message) -> None:
        ours = ("target_system", self._endpoint.system), ("target_component", self._endpoint.component)
        if any(message.get(field) not in (0, own) for field, own in ours):
            return
        command, accepted = message.get("command"), message.get("result") == CommandResult.ACCEPTED
        owner = message.get("result_param2")
        if command in OWNED_COMMANDS:
            self._follow_owner(owner)
        is_ours = owner in (
            0,
            self._endpoint.session,
        )  # else it answers another end of the same number
        if command == CommandCode.ARM and accepted and is_ours and self._arming_request is not None:
            self.armed = self.has_authority = bool(self._arming_request)
            self._arming_request = None
        elif command == CommandCode.ARM and not is_ours and self._arming_request == 0.0:
            self._arming_request = None  # it belongs to another autopilot, which ends its own flight
        elif command == CommandCode.RUN_CHECKS and not accepted:
            self.checks.handle_refusal()
        elif command == CommandCode.REQUEST_MESSAGE and not accepted:
            self._compared = True

    def _follow_owner(self, owner: int) -> None:
        """Note the owner of the vehicle. Give up authority if the owner is another autopilot."""
        self.owner = owner
        if self.has_authority and owner not in (0, self._endpoint.session):
            self.has_authority = False
            self.tell(f"the vehicle belongs to another autopilot now, session {owner:06x}")
        elif owner == self._endpoint.session:
            self._takes_over = False
            if self._arming_request:  # the owner is broadcast, so a lost acknowledgement does no harm
                self.armed = self.has_authority = True
                self._arming_request = None

    @property
    def is_taken(self) -> bool:
        """True if the vehicle belongs to another autopilot and this end does not ask to take over."""
        return self.owner not in (0, self._endpoint.session) and not self._takes_over

    def _handle_request(self, message: Message) -> None:
        """Handle a ground station's request that the vehicle forwards. Commands to other components are ignored."""
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
        """Compare the two dialects. A vehicle without a fingerprint is accepted, since checksums differ too."""
        ours = self._endpoint.dialect.fingerprint
        self._compared = True
        if any(theirs) and theirs != ours:
            both = f"its dialect is {theirs.hex()}, this scenario's {ours.hex()}"
            self._dialect_problem = f"wrong scenario: the vehicle has different sensors or commands: {both}"
            if self._identity is None:
                self.misfit = self._dialect_problem

    def _compare_sessions(self, session: int) -> None:
        """Compare sessions: a vehicle keeps one session while it runs."""
        if self._vehicle_session not in (0, session):
            self._note_second_vehicle(f"sessions {self._vehicle_session:06x} and {session:06x}")
        self._vehicle_session = session

    def _note_second_vehicle(self, by: str) -> None:
        self.misfit = f"two vehicles answer on this link as {self.system}/{self.component}: {by}"

    def list_problems(self, was_armed: bool, is_silent: bool, now: int, is_stopped: bool = False) -> list[str]:
        """Return the problems of the vehicle at the end of its flight, before it is disarmed, for scripts.

        is_stopped: a pilot has disarmed the vehicle.
        """
        ends_with_it = self._end_time is not None and now - self._end_time <= COMMON_END
        is_disarmed = not (self.armed or ends_with_it or self.is_taken)
        problems = {
            "the vehicle was never armed": not was_armed,
            "the vehicle's failsafe acted": self.has_failed_safe,
            "the vehicle was not armed at the end": was_armed and is_disarmed and not is_stopped,
            "no data from the vehicle at the end": was_armed and is_silent,
        }
        return [text for text, holds in problems.items() if holds]

    def due(self, now: int) -> None:
        """Send the packets that are due now."""
        if now >= self._next["heartbeat"] or self.mode != self._last_mode:
            self._next["heartbeat"], self._last_mode = now + HEARTBEAT_PERIOD, self.mode
            mode = {} if self.mode is None else {"base_mode": ModeFlag.CUSTOM, "custom_mode": self.mode}
            self._link.send(self._endpoint.pack("HEARTBEAT", HEARTBEAT | mode))
        if now >= self._next["sync"]:
            is_settled = self._is_clock_known and not self.sync.is_doubtful
            self._next["sync"] = now + (SYNC_SLOW if is_settled else SYNC_QUICK)
            self._link.send(self._endpoint.pack("TIMESYNC", self.sync.ask(now)))
        if self._arming_request and not self.armed and self.count_differences():
            self._arming_request = None  # the settings have changed since: the checks come first
        if self._arming_request is not None and now >= self._next["ask"]:
            self._next["ask"] = now + (ASK_PERIOD if self._arming_request else DISARM_PERIOD)
            sessions = {"param3": self._endpoint.session, "param4": self._vehicle_session}
            sessions["param5"] = 0 if self._identity is None else self._identity.number
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
        if self.heartbeat_time is not None and self._identity and not (self.armed and self._is_identity_told):
            for packet in self._identity.due(now, self.system, self.component):
                self._link.send(packet)
            if not self._is_identity_told:
                self._compare_identities()

    @property
    def is_asking(self) -> bool:
        """True while a request to arm or disarm is unanswered."""
        return self._arming_request is not None

    def arm(self, *, takes_over: bool = False) -> None:
        """Ask the vehicle to arm, repeatedly until it answers. A vehicle that is armed is asked for its owner.

        takes_over: take the vehicle over from the autopilot that flies it.
        """
        if self._arming_request is None and not self.has_authority:
            self._takes_over = takes_over
            self._arming_request, self._next["ask"] = 1.0, 0

    def disarm(self) -> None:
        """Ask the vehicle to disarm, repeatedly until it answers."""
        self._arming_request, self._next["ask"] = 0.0, 0

    def _send_command(self, command: CommandCode, first: float, others: Mapping[str, float] | None = None) -> None:
        fields = {"command": command, "param1": first, "target_system": self.system, "target_component": 0}
        self._link.send(self._endpoint.pack("COMMAND_LONG", fields | dict(others or {})))
