"""A vehicle as the autopilot's end sees it: whether it is there, armed, what it says, and what its clock shows.

Source: docs page, Fly; MAVLink's services heartbeat, command and timesync.
"""

from collections import deque
from collections.abc import Callable

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, seconds
from trimtab.wire.definitions import Message
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.protocol import (
    VERSION_MESSAGE,
    CommandCode,
    CommandResult,
    FlightCommand,
    ModeFlag,
    VehicleType,
    parse_request,
)
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
QUICK_ROUND_TRIP = ms(300)
"""At least one answer must have been as quick as this: what waited in a queue tells little of a clock."""


class RemoteVehicle:
    """Keeps the line to a vehicle: heartbeats, time synchronisation, arming. Times `now` are this end's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, link: Link) -> None:
        self._endpoint, self._link = endpoint, link
        self.sync = TimeSync()
        self.tell: Callable[[str], None] = lambda _: None
        self.armed = False
        self.system = self.component = 0
        self.heartbeat_time: int | None = None
        """When the vehicle's last heartbeat came."""
        self.misfit = ""
        """Why its messages can't be understood; empty while nothing speaks against it."""
        self.mode: int | None = None
        """What this end's supervisor does, told in heartbeats; None: there is none that could be asked."""
        self.requests: deque[str] = deque(maxlen=MOST_REQUESTS)
        """What a ground station wants of the supervisor, as the vehicle passed it on."""
        self._last_mode: int | None = None
        self._next = dict.fromkeys(("heartbeat", "sync", "ask", "version"), 0)
        self._arming_request: float | None = None
        self._clock_answers = self._jumps = 0
        self._version_asks, self._compared = 0, False

    @property
    def is_ready(self) -> bool:
        """Whether there is a vehicle whose clock is known."""
        return self.heartbeat_time is not None and self._is_clock_known and self._compared and not self.misfit

    @property
    def _is_clock_known(self) -> bool:
        return self._clock_answers >= QUICK_ANSWERS and self.sync.shortest <= QUICK_ROUND_TRIP

    def reason_not_ready(self) -> str:
        """Why it is not ready, for people."""
        counts, traffic = self._endpoint.counts, self._link.statistics
        if self.misfit:
            return self.misfit
        if not traffic.packets_in:
            return "no vehicle answers" + ("" if traffic.connected else ": there is no connection")
        if counts.wrong_signature or counts.unsigned:
            return f"{counts.wrong_signature + counts.unsigned} frames came unsigned or signed with another key"
        if counts.checksum or counts.unknown:
            return f"{counts.checksum + counts.unknown} frames don't fit: the vehicle flies another scenario"
        return "a vehicle answers, but its clock is not known yet"

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
            self.tell("vehicle: " + "".join(c if c.isprintable() else "?" for c in message.get("text")))
        elif message.name == "COMMAND_ACK":
            self._handle_acknowledgement(message)
        elif message.name == "COMMAND_LONG":
            self._handle_request(message)
        elif message.name == "AUTOPILOT_VERSION":
            self._compare_dialects(bytes(message.get("flight_custom_version")))

    def _handle_heartbeat(self, message: Message, now: int) -> None:
        if self.heartbeat_time is None:
            self.system, self.component = message.system, message.component
        if (message.system, message.component) != (self.system, self.component):
            return
        armed = bool(message.get("base_mode") & ModeFlag.ARMED)
        if self.armed and not armed:
            self.tell("the vehicle is not armed any more")
        self.heartbeat_time, self.armed = now, armed

    def _handle_time_sync(self, message: Message, now: int) -> None:
        if not self.sync.handle_answer(message.get("tc1"), message.get("ts1"), now):
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
        if command == CommandCode.ARM and accepted and self._arming_request is not None:
            self.armed, self._arming_request = bool(self._arming_request), None
        elif command == CommandCode.REQUEST_MESSAGE and not accepted:
            self._compared = True

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
            self.misfit = f"the vehicle has other sensors, or takes other commands: {both}"

    def due(self, now: int) -> None:
        """Send what is to be sent by now."""
        if now >= self._next["heartbeat"] or self.mode != self._last_mode:
            self._next["heartbeat"], self._last_mode = now + HEARTBEAT_PERIOD, self.mode
            mode = {} if self.mode is None else {"base_mode": ModeFlag.CUSTOM, "custom_mode": self.mode}
            self._link.send(self._endpoint.pack("HEARTBEAT", HEARTBEAT | mode))
        if now >= self._next["sync"]:
            self._next["sync"] = now + (SYNC_SLOW if self._is_clock_known else SYNC_QUICK)
            self._link.send(self._endpoint.pack("TIMESYNC", self.sync.ask(now)))
        if self._arming_request is not None and now >= self._next["ask"]:
            self._next["ask"] = now + (ASK_PERIOD if self._arming_request else DISARM_PERIOD)
            self._send_command(CommandCode.ARM, self._arming_request)
        if self.heartbeat_time is not None and not self._compared and now >= self._next["version"]:
            self._next["version"] = now + ASK_PERIOD
            self._version_asks += 1
            self._compared = self._version_asks > MOST_ASKS
            self._send_command(CommandCode.REQUEST_MESSAGE, VERSION_MESSAGE)

    @property
    def is_asking(self) -> bool:
        """Whether it has been asked to arm or disarm and has not answered yet."""
        return self._arming_request is not None

    def arm(self) -> None:
        """Ask the vehicle to arm, again and again until it has answered."""
        if self._arming_request is None and not self.armed:
            self._arming_request, self._next["ask"] = 1.0, 0

    def disarm(self) -> None:
        """Ask the vehicle to disarm, again and again until it has answered."""
        self._arming_request, self._next["ask"] = 0.0, 0

    def _send_command(self, command: CommandCode, first: float) -> None:
        fields = {"command": command, "param1": first, "target_system": self.system, "target_component": 0}
        self._link.send(self._endpoint.pack("COMMAND_LONG", fields))
