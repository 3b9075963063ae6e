"""Vehicle's end of MAVLink's standard services: a state machine without I/O, driven by messages and by the time.

The services are heartbeat, time synchronisation, arming, modes, parameters, versions, status text, and the channels of
a pilot's transmitter. Requests to the vehicle are returned as events. The vehicle's program acts on the events, and
sets the reported `status`.
Source: https://mavlink.io/en/services/ (heartbeat, command, parameter, timesync) and messages/common.html.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from trimtab.core.errors import InputError
from trimtab.core.time import seconds
from trimtab.flight.mavlink.authority import Authority, Sender, parse_session
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import (
    GENERIC_AUTOPILOT,
    SET_MODE_MESSAGE,
    VERSION_MESSAGE,
    ArmRequest,
    CommandCode,
    CommandResult,
    FlightCommand,
    FlightRequest,
    ModeFlag,
    ModeRequest,
    Severity,
    State,
    VehicleEvent,
    parse_channels,
    parse_joystick,
    parse_request,
)
from trimtab.flight.mavlink.time_sync import NS_PER_UNIT
from trimtab.flight.station.arming import CONFIRMATION, ArmingCheck, pack_checks
from trimtab.flight.station.parameters import NO_STORE, ChangedValues, Parameters, ParameterService
from trimtab.flight.station.streams import Streams, TextQueue
from trimtab.flight.station.telemetry import version_fields
from trimtab.vehicles.vehicle_type import VehicleType

HEARTBEAT_PERIOD = seconds(1)
LISTENING_TIME = seconds(10)
"""Time (100 ns) after its last heartbeat for which another system counts as listening."""
VERSION_REQUEST = CommandCode.REQUEST_MESSAGE, VERSION_MESSAGE


WRITE_STORAGE, RESET_STORAGE = 1, 2
"""Values of the first parameter of the command PREFLIGHT_STORAGE: store the parameters, and reset the stored
parameters."""
OWNED_COMMANDS = CommandCode.ARM, CommandCode.REQUEST_CONTROL
"""Commands whose acknowledgements contain the session number of the vehicle's owner."""


class Status(NamedTuple):
    """Status of the vehicle that is reported to ground stations and autopilot.

    arming_problem: reason why the vehicle cannot be armed, or "".  confirmation_problem: reason why the vehicle cannot
    be armed without a confirmation by the user, or "".  closed_modes: reason why a mode cannot be entered now, by the
    mode's number.
    autopilot_problem: reason why the autopilot cannot be asked to hold, resume or end, or "".
    identity: hash of the vehicle's settings as a whole number, see `identity.digest_number`.
    """

    mode: int = 0
    armed: bool = False
    state: State = State.STANDBY
    arming_problem: str = ""
    confirmation_problem: str = ""
    closed_modes: Mapping[int, str] = {}
    autopilot_problem: str = "no autopilot that accepts requests"
    identity: int = 0


class StationResponse(NamedTuple):
    """Result of handling a message: packets to send, and events (requests to the vehicle)."""

    replies: list[bytes]
    events: list[VehicleEvent]


class Service(Protocol):
    """Interface of a vehicle's service for one kind of request. Times are by the vehicle's clock, in 100 ns."""

    @property
    def names(self) -> Collection[str]:
        """Names of the MAVLink messages that this service answers."""
        ...

    def answer(self, message: Message, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the packets that answer a message, which is one of `names`."""
        ...

    def due(self, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the packets of this service that must be sent now."""
        ...


def _arming_sender(message: Message) -> Sender:
    return Sender(message.system, message.component, parse_session(message.get("param3")), message.link)


class Station:
    """Vehicle's end of MAVLink's standard services. The vehicle's program sets `status` when the status changes.

    Times are by the vehicle's clock, in 100 ns.

    Args:
        endpoint: endpoint that packs the replies. The caller passes the messages accepted by the endpoint to
            `handle_message`.
        parameters: parameters that ground stations can read and change.
        modes: name of each mode for the user, by the mode's number.
        vehicle: MAVLink's type of the vehicle.
        streams: telemetry, sent while another system (e.g. a ground station) is listening.
        authority: record of the vehicle's owner, or None to make a new record without an owner.
        services: services that answer further messages.
        store: function that stores changed parameters for the next start, or removes the stored parameters if it is
            called with None. It returns the reason if storing fails, or "".
        tell: function that receives the messages on arming and control, for the vehicle's own log.
        arming_checks: function that returns the checks before arming.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        parameters: Parameters,
        modes: Mapping[int, str],
        *,
        vehicle: VehicleType = VehicleType.GENERIC,
        streams: Streams | None = None,
        authority: Authority | None = None,
        services: Sequence[Service] = (),
        store: Callable[[ChangedValues | None], str] = lambda _: NO_STORE,
        tell: Callable[[str], None] = lambda _: None,
        arming_checks: Callable[[], Sequence[ArmingCheck]] = lambda: (),
    ) -> None:
        """Start with a disarmed vehicle."""
        if not modes:
            raise InputError("station", "needs at least one mode", fix='give modes={0: "MANUAL", …}')
        self._endpoint, self._modes, self._vehicle = endpoint, dict(modes), vehicle
        self._parameters, self._held = ParameterService(endpoint, parameters), parameters
        self._store, self._tell, self._arming_checks = store, tell, arming_checks
        self.authority = authority or Authority(endpoint.session, endpoint.system)
        self.status = Status(mode=next(iter(self._modes)))
        self.texts = TextQueue(endpoint)
        self._heartbeat_at: int | None = None
        self._last_state = self.status.armed, self.status.state
        self._streams, self._listens_until = streams or Streams(endpoint, {}), 0
        self._answers = self._list_answers()
        self._services = {name: service for service in services for name in service.names}

    def _list_answers(self) -> Mapping[str, Callable[[Message, int, StationResponse], None]]:
        """Return the methods that answer messages, by the message's name."""
        return {
            "HEARTBEAT": self._note_heartbeat,
            "TIMESYNC": self._answer_time_sync,
            "PING": self._answer_ping,
            "COMMAND_LONG": self._handle_command,
            "COMMAND_INT": self._handle_command,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": lambda *_: self._parameters.start_list(),
            "PARAM_REQUEST_READ": lambda m, now, response: response.replies.extend(self._parameters.read(m)),
            "PARAM_SET": self._set_parameter,
            "REQUEST_DATA_STREAM": lambda m, now, response: self._streams.ask(m, now),
            "RC_CHANNELS": lambda m, now, response: response.events.append(parse_channels(m)),
            "RC_CHANNELS_OVERRIDE": lambda m, now, response: response.events.append(parse_channels(m)),
            "MANUAL_CONTROL": lambda m, now, response: response.events.append(parse_joystick(m)),
            "SETUP_SIGNING": self._refuse_key,
        }

    def handle_message(self, message: Message, now: int) -> StationResponse:
        """Handle a message. Unknown messages, and messages for other systems, have no effect."""
        response = StationResponse([], [])
        answer, service = self._answers.get(message.name), self._services.get(message.name)
        if (answer is None and service is None) or not self._is_for_us(message):
            return response
        if answer is not None:
            answer(message, now, response)
        if service is not None:
            response.replies.extend(service.answer(message, now, is_armed=self.status.armed))
        response.replies.extend(self.texts.pack_texts())
        return response

    def due(self, now: int) -> list[bytes]:
        """Return the packets to send now: heartbeats (immediately after a change of state), texts, telemetry streams,
        parameters."""
        packets = self.texts.pack_texts()
        state = self.status.armed, self.status.state
        is_due = self._heartbeat_at is None or not 0 <= now - self._heartbeat_at < HEARTBEAT_PERIOD
        if is_due or state != self._last_state:
            self._heartbeat_at, self._last_state = now, state
            packets.append(self._heartbeat_packet())
        if now < self._listens_until:
            packets += self._streams.due(now)
        for service in dict.fromkeys(self._services.values()):
            packets += service.due(now, is_armed=self.status.armed)
        return packets + self._parameters.due(now)

    def queue_text(self, severity: Severity, text: str) -> None:
        """Queue a line of text for ground stations. If the queue is full, the line is dropped and counted."""
        self.texts.queue_text(severity, text)

    def _warn(self, text: str) -> None:
        self.queue_text(Severity.WARNING, text)
        self._tell(text)

    def _pack_fields(self, name: str, **fields: Any) -> bytes:
        return self._endpoint.pack(name, fields)

    def _is_for_us(self, message: Message) -> bool:
        """Return True if a message is addressed to this system and component, is addressed to all, or has no
        address."""
        where = message.definition.where
        for field, own in (("target_system", self._endpoint.system), ("target_component", self._endpoint.component)):
            if field in where and message.get(field) not in (0, own):
                return False
        return message.name != "MANUAL_CONTROL" or message.get("target") in (0, self._endpoint.system)

    def _heartbeat_packet(self) -> bytes:
        armed = ModeFlag.ARMED if self.status.armed else 0
        return self._pack_fields(
            "HEARTBEAT",
            type=self._vehicle,
            autopilot=GENERIC_AUTOPILOT,
            base_mode=ModeFlag.CUSTOM | armed,
            custom_mode=self.status.mode,
            system_status=self.status.state,
        )

    def _note_heartbeat(self, message: Message, now: int, response: StationResponse) -> None:
        if message.system != self._endpoint.system:
            self._listens_until = now + LISTENING_TIME

    def _answer_time_sync(self, message: Message, now: int, response: StationResponse) -> None:
        if message.get("tc1") == 0:
            response.replies.append(self._pack_fields("TIMESYNC", tc1=now * NS_PER_UNIT or 1, ts1=message.get("ts1")))

    def _answer_ping(self, message: Message, now: int, response: StationResponse) -> None:
        if message.get("target_system") == 0:
            fields = message.fields() | {"target_system": message.system, "target_component": message.component}
            response.replies.append(self._pack_fields("PING", **fields))

    def _handle_command(self, message: Message, now: int, response: StationResponse) -> None:
        command, first, second = (message.get(n) for n in ("command", "param1", "param2"))
        if command == CommandCode.ARM:
            sender, vehicle = _arming_sender(message), parse_session(message.get("param4"))
            if not self.authority.is_addressed(vehicle):
                return
            identity = message.get("param5") if message.name == "COMMAND_LONG" else 0
            if first == 1.0 and self._has_changed(identity):
                self._warn("Arming refused: settings have changed since they were compared")
                result = CommandResult.NOT_NOW
            else:
                result = self._arm(first, sender, response, is_confirmed=second == CONFIRMATION)
        elif command == CommandCode.RUN_CHECKS:
            result = self._run_checks(message, response)
        elif command == CommandCode.TERMINATE and first > 0.5:
            result = self._arm(0.0, _arming_sender(message), response)
        elif command == CommandCode.REQUEST_CONTROL and message.name == "COMMAND_LONG" and second == 1:
            if not self.authority.is_addressed(parse_session(message.get("param6"))):
                return
            asking = Sender(message.system, message.component, parse_session(message.get("param5")), message.link)
            result = self._hand_over(asking)
        elif command == CommandCode.SET_MODE:
            result = self._change_mode(int(first) if 0 <= first < 256 else 0, second, response, message.get("param3"))
        elif (request := parse_request(FlightCommand(command, first, second))) is not None:
            result = self._request_flight(request, response)
        elif command == CommandCode.REQUEST_CAPABILITIES or (command, first) == VERSION_REQUEST:
            response.replies.append(self._pack_fields("AUTOPILOT_VERSION", **version_fields(self._endpoint)))
            result = CommandResult.ACCEPTED
        elif command == CommandCode.STORAGE and first in (WRITE_STORAGE, RESET_STORAGE):
            result = self._store_parameters(first == RESET_STORAGE)
        elif command == CommandCode.REBOOT:
            self.queue_text(Severity.WARNING, "Not rebooted: restart `trimtab vehicle` by hand")
            result = CommandResult.NOT_NOW if self.status.armed else CommandResult.UNSUPPORTED
        elif command == CommandCode.REQUEST_MESSAGE and first == 0:
            response.replies.append(self._heartbeat_packet())
            result = CommandResult.ACCEPTED
        else:
            result, packets = self._streams.handle_command(command, first, second, now)
            response.replies.extend(packets)
        response.replies.append(self._acknowledgement_packet(command, result, message))

    def _acknowledgement_packet(self, command: int, result: CommandResult, message: Message) -> bytes:
        return self._pack_fields(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=message.system,
            target_component=message.component,
            result_param2=self._owner_session if command in OWNED_COMMANDS else 0,
        )

    @property
    def _owner_session(self) -> int:
        return 0 if self.authority.owner is None else self.authority.owner.session

    def owner_packet(self) -> bytes:
        """Return the packet that announces the vehicle's owner to all peers on the link."""
        fields = {"command": CommandCode.REQUEST_CONTROL, "result_param2": self._owner_session}
        return self._pack_fields("COMMAND_ACK", **fields)

    def _hand_over(self, sender: Sender) -> CommandResult:
        if not sender.session:
            return CommandResult.UNSUPPORTED
        before = self.authority.take_over(sender) if self.authority.is_armed else None
        if before is not None and before != sender:
            self._warn(f"Control taken over from {before} by {sender}")
        return CommandResult.ACCEPTED

    def _run_checks(self, message: Message, response: StationResponse) -> CommandResult:
        """Report the results of the checks before arming: all checks to the sender of the request, and failing checks
        to ground stations."""
        if self.status.armed:
            return CommandResult.NOT_NOW
        checks = self._arming_checks()
        response.replies.extend(pack_checks(self._endpoint, message, checks))
        for check in checks if message.system != self._endpoint.system else ():
            if not check.passes:
                self.queue_text(Severity.WARNING, f"PreArm: {check.sentence}")
        return CommandResult.ACCEPTED

    def _has_changed(self, identity: float) -> bool:
        """Return True if the settings have changed since the sender of a request to arm compared them.

        A request that contains no hash of the settings is not checked.
        """
        own = self.status.identity
        return not self.status.armed and own != 0 and math.isfinite(identity) and identity not in (0, own)

    def _arm(
        self, arm: float, sender: Sender, response: StationResponse, *, is_confirmed: bool = False
    ) -> CommandResult:
        if arm not in (0.0, 1.0):
            return CommandResult.DENIED
        problem = self.authority.find_arming_problem(sender) if arm else self.authority.find_disarming_problem(sender)
        if problem:
            self._warn(f"{'Arming' if arm else 'Disarming'} by {sender} refused: {problem}")
            return CommandResult.DENIED
        why = self.status.arming_problem or ("" if is_confirmed else self.status.confirmation_problem)
        if arm and not self.status.armed and why:
            self._warn(f"Arming refused: {why}")
            return CommandResult.NOT_NOW
        if arm:
            self.authority.arm(sender)
        response.events.append(ArmRequest(bool(arm), by_hand=not sender.session))
        return CommandResult.ACCEPTED

    def _change_mode(self, flags: int, mode: float, response: StationResponse, part: float = 0.0) -> CommandResult:
        """Request the mode with this number, if the mode exists. part: sub-mode as in PX4, which must be 0 or NaN
        because this vehicle has no sub-modes."""
        has_parts = part == part and part != 0  # NaN means not given
        if not flags & ModeFlag.CUSTOM or mode not in self._modes or has_parts:
            known = ", ".join(f"{number} {name}" for number, name in self._modes.items())
            asked = f"{mode:g}.{part:g}" if has_parts else f"{mode:g}"
            self.queue_text(Severity.WARNING, f"No mode {asked}; available: {known}")
            return CommandResult.DENIED
        why = self.status.closed_modes.get(int(mode))
        if why:
            self.queue_text(Severity.WARNING, f"Mode {self._modes[int(mode)]} refused: {why}")
            return CommandResult.NOT_NOW
        response.events.append(ModeRequest(int(mode)))
        return CommandResult.ACCEPTED

    def _request_flight(self, request: str, response: StationResponse) -> CommandResult:
        if not request:
            return CommandResult.DENIED
        if self.status.autopilot_problem:
            self.queue_text(Severity.WARNING, f"Cannot {request}: {self.status.autopilot_problem}")
            return CommandResult.NOT_NOW
        response.events.append(FlightRequest(request))
        return CommandResult.ACCEPTED

    def _set_mode(self, message: Message, now: int, response: StationResponse) -> None:
        result = self._change_mode(message.get("base_mode"), message.get("custom_mode"), response)
        response.replies.append(self._acknowledgement_packet(SET_MODE_MESSAGE, result, message))

    def _set_parameter(self, message: Message, now: int, response: StationResponse) -> None:
        replies, events, refusal = self._parameters.change_value(message)
        response.replies.extend(replies)
        response.events.extend(events)
        if refusal:
            self.queue_text(Severity.WARNING, f"Not set: {refusal}")

    def _store_parameters(self, is_reset: bool) -> CommandResult:
        what = "reset" if is_reset else "stored"
        why = (
            "the vehicle is armed"
            if self.status.armed
            else self._store(None if is_reset else self._held.changed_values())
        )
        said = f"Parameters not {what}: {why}" if why else f"Parameters {what} for the next start"
        self.queue_text(Severity.WARNING if why else Severity.NOTICE, said)
        if not why:
            return CommandResult.ACCEPTED
        return CommandResult.NOT_NOW if self.status.armed else CommandResult.FAILED

    def _refuse_key(self, message: Message, now: int, response: StationResponse) -> None:
        self.queue_text(Severity.WARNING, "Keys are not accepted over the link")
