"""The vehicle's end of the standard protocol: a state machine without I/O, driven by messages and by the time.

Heartbeat, time synchronisation, arming, modes, parameters, versions, status text, a pilot's channels. What is asked of
the vehicle comes out as events; the vehicle acts, and tells by `status` what it is.
Source: https://mavlink.io/en/services/ (heartbeat, command, parameter, timesync) and messages/common.html.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.time import seconds
from trimtab.wire.definitions import Message
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.parameters import Parameters, ParameterService
from trimtab.wire.protocol import (
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
    VehicleType,
    parse_channels,
    parse_joystick,
    parse_request,
)
from trimtab.wire.streams import Streams, TextQueue
from trimtab.wire.telemetry import version_fields
from trimtab.wire.time_sync import NS_PER_UNIT

HEARTBEAT_PERIOD = seconds(1)
LISTENING_TIME = seconds(10)
"""How long after its last heartbeat another system counts as one that listens."""
VERSION_REQUEST = CommandCode.REQUEST_MESSAGE, VERSION_MESSAGE


class Status(NamedTuple):
    """What the vehicle is, as it tells others.

    arming_problem: why it can't be armed, empty if it can.  closed_modes: mode -> why it can't be entered now.
    autopilot_problem: why its autopilot can't be asked to hold, resume or end; empty if it can.
    """

    mode: int = 0
    armed: bool = False
    state: State = State.STANDBY
    arming_problem: str = ""
    closed_modes: Mapping[int, str] = {}
    autopilot_problem: str = "there is no autopilot that could be asked"


class StationResponse(NamedTuple):
    """What a message leads to: packets to send, and what is asked of the vehicle."""

    replies: list[bytes]
    events: list[VehicleEvent]


class Station:
    """The vehicle's end. Set `status` whenever it changes; all times `now` are the vehicle's, in 100 ns."""

    def __init__(
        self,
        endpoint: Endpoint,
        parameters: Parameters,
        modes: Mapping[int, str],
        *,
        vehicle: VehicleType = VehicleType.GENERIC,
        streams: Streams | None = None,
    ) -> None:
        """A vehicle at rest.

        Args:
            endpoint: packs the replies; give what it has accepted to `handle_message`.
            parameters: what ground stations can read and change.
            modes: number of a mode -> its name for people.
            vehicle: what it says it is.
            streams: what is told again and again while another system (a ground station) is there.
        """
        if not modes:
            raise InputError("station", "there are no modes", fix='give modes={0: "MANUAL", …}')
        self._endpoint, self._modes = endpoint, dict(modes)
        self._parameters = ParameterService(endpoint, parameters)
        self._vehicle = vehicle
        self.status = Status(mode=next(iter(self._modes)))
        self.texts = TextQueue(endpoint)
        self._heartbeat_at: int | None = None
        self._streams, self._listens_until = streams or Streams(endpoint, {}), 0
        self._answers = {
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
        """What a message leads to; those for others, and those that nothing is known of, lead to nothing."""
        response = StationResponse([], [])
        answer = self._answers.get(message.name)
        if answer is not None and self._is_for_us(message):
            answer(message, now, response)
            response.replies.extend(self.texts.pack_texts())
        return response

    def due(self, now: int) -> list[bytes]:
        """What is to be sent by now: heartbeats, texts, streams, the parameters that were asked for, paced."""
        packets = self.texts.pack_texts()
        if self._heartbeat_at is None or not 0 <= now - self._heartbeat_at < HEARTBEAT_PERIOD:
            self._heartbeat_at = now
            packets.append(self._heartbeat_packet())
        if now < self._listens_until:
            packets += self._streams.due(now)
        return packets + self._parameters.due(now)

    def queue_text(self, severity: Severity, text: str) -> None:
        """A line for people, sent with what is due next; what is too much is dropped and counted."""
        self.texts.queue_text(severity, text)

    def _pack_fields(self, name: str, **fields: Any) -> bytes:
        return self._endpoint.pack(name, fields)

    def _is_for_us(self, message: Message) -> bool:
        """Whether a message names this system and component, or all, or none."""
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
            result = self._arm(first, response)
        elif command == CommandCode.TERMINATE and first > 0.5:
            result = self._arm(0.0, response)
        elif command == CommandCode.SET_MODE:
            result = self._change_mode(int(first) if 0 <= first < 256 else 0, second, response)
        elif (request := parse_request(FlightCommand(command, first, second))) is not None:
            result = self._request_flight(request, response)
        elif command == CommandCode.REQUEST_CAPABILITIES or (command, first) == VERSION_REQUEST:
            response.replies.append(self._pack_fields("AUTOPILOT_VERSION", **version_fields(self._endpoint)))
            result = CommandResult.ACCEPTED
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
        )

    def _arm(self, arm: float, response: StationResponse) -> CommandResult:
        if arm not in (0.0, 1.0):
            return CommandResult.DENIED
        if arm and not self.status.armed and self.status.arming_problem:
            self.queue_text(Severity.WARNING, f"Arming refused: {self.status.arming_problem}")
            return CommandResult.NOT_NOW
        response.events.append(ArmRequest(bool(arm)))
        return CommandResult.ACCEPTED

    def _change_mode(self, flags: int, mode: float, response: StationResponse) -> CommandResult:
        if not flags & ModeFlag.CUSTOM or mode not in self._modes:
            known = ", ".join(f"{number} {name}" for number, name in self._modes.items())
            self.queue_text(Severity.WARNING, f"No mode {mode:g}; there are {known}")
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
            self.queue_text(Severity.WARNING, f"Not asked to {request}: {self.status.autopilot_problem}")
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

    def _refuse_key(self, message: Message, now: int, response: StationResponse) -> None:
        self.queue_text(Severity.WARNING, "Keys are not taken over the link")
