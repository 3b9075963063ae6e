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
    ArmAsked,
    Event,
    FlightAsked,
    ModeAsked,
    ModeFlag,
    Order,
    Result,
    Severity,
    State,
    VehicleType,
    Wanted,
    Who,
    channels,
    requested,
    sticks,
)
from trimtab.wire.streams import Streams, Texts
from trimtab.wire.telemetry import version_fields

HEARTBEAT_PERIOD = seconds(1)
LISTENS_FOR = seconds(10)
"""How long after its last heartbeat another system counts as one that listens."""
NS_PER_UNIT = 100


class Status(NamedTuple):
    """What the vehicle is, as it tells others.

    not_ready: why it can't be armed, empty if it can.  closed: mode -> why it can't be entered now.
    deaf: why its autopilot can't be asked to hold, resume or end; empty if it can.
    """

    mode: int = 0
    armed: bool = False
    state: State = State.STANDBY
    not_ready: str = ""
    closed: Mapping[int, str] = {}
    deaf: str = "there is no autopilot that could be asked"


class Handled(NamedTuple):
    """What a message leads to: packets to send, and what is asked of the vehicle."""

    replies: list[bytes]
    events: list[Event]


class Station:
    """The vehicle's end. Set `status` whenever it changes; all times `now` are the vehicle's, in 100 ns."""

    def __init__(
        self,
        endpoint: Endpoint,
        parameters: Parameters,
        modes: Mapping[int, str],
        *,
        vehicle: VehicleType = VehicleType.GENERIC,
        live: bool = True,
        streams: Streams | None = None,
    ) -> None:
        """A vehicle at rest.

        Args:
            endpoint: packs the replies; give it what it has heard by `handle`.
            parameters: what ground stations can read and change.
            modes: number of a mode -> its name for people.
            vehicle: what it says it is.
            live: whether parameters may be changed while armed.
            streams: what is told again and again while another system (a ground station) is there.
        """
        if not modes:
            raise InputError("station", "there are no modes", fix='give modes={0: "MANUAL", …}')
        self._endpoint, self._modes = endpoint, dict(modes)
        self._parameters = ParameterService(endpoint, parameters)
        self._vehicle, self._live = vehicle, live
        self.status = Status(mode=next(iter(self._modes)))
        self.heard: dict[Who, int] = {}
        """When the last heartbeat of each (system, component) came."""
        self.texts = Texts(endpoint)
        self._heartbeat_at: int | None = None
        self._streams, self._listens_until = streams or Streams(endpoint, {}), 0
        self._answers = {
            "HEARTBEAT": self._hear,
            "TIMESYNC": self._synchronise,
            "PING": self._ping,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": lambda *_: self._parameters.list_all(),
            "PARAM_REQUEST_READ": lambda message, now, done: done.replies.extend(self._parameters.read(message)),
            "PARAM_SET": self._set_parameter,
            "REQUEST_DATA_STREAM": lambda message, now, done: self._streams.ask(message, now),
            "RC_CHANNELS": lambda message, now, done: done.events.append(channels(message)),
            "RC_CHANNELS_OVERRIDE": lambda message, now, done: done.events.append(channels(message)),
            "MANUAL_CONTROL": lambda message, now, done: done.events.append(sticks(message)),
            "SETUP_SIGNING": self._refuse_key,
        }

    def handle(self, message: Message, now: int) -> Handled:
        """What a message leads to; those for others, and those that nothing is known of, lead to nothing."""
        done = Handled([], [])
        answer = self._answers.get(message.name)
        if answer is not None and self._is_for_us(message):
            answer(message, now, done)
            done.replies.extend(self.texts.take())
        return done

    def due(self, now: int) -> list[bytes]:
        """What is to be sent by now: heartbeats, texts, streams, the parameters that were asked for, paced."""
        found = self.texts.take()
        if self._heartbeat_at is None or not 0 <= now - self._heartbeat_at < HEARTBEAT_PERIOD:
            self._heartbeat_at = now
            found.append(self._heartbeat())
        if now < self._listens_until:
            found += self._streams.due(now)
        return found + self._parameters.due(now)

    def say(self, severity: Severity, text: str) -> None:
        """A line for people, sent with what is due next; what is too much is dropped and counted."""
        self.texts.say(severity, text)

    def _pack(self, name: str, **fields: Any) -> bytes:
        return self._endpoint.pack(name, fields)

    def _is_for_us(self, message: Message) -> bool:
        """Whether a message names this system and component, or all, or none."""
        where = message.definition.where
        for field, own in (("target_system", self._endpoint.system), ("target_component", self._endpoint.component)):
            if field in where and message.get(field) not in (0, own):
                return False
        return message.name != "MANUAL_CONTROL" or message.get("target") in (0, self._endpoint.system)

    def _heartbeat(self) -> bytes:
        armed = ModeFlag.ARMED if self.status.armed else 0
        return self._pack(
            "HEARTBEAT",
            type=self._vehicle,
            autopilot=GENERIC_AUTOPILOT,
            base_mode=ModeFlag.CUSTOM | armed,
            custom_mode=self.status.mode,
            system_status=self.status.state,
        )

    def _hear(self, message: Message, now: int, done: Handled) -> None:
        self.heard[_who(message)] = now
        if message.system != self._endpoint.system:
            self._listens_until = now + LISTENS_FOR

    def _synchronise(self, message: Message, now: int, done: Handled) -> None:
        if message.get("tc1") == 0:
            done.replies.append(self._pack("TIMESYNC", tc1=now * NS_PER_UNIT or 1, ts1=message.get("ts1")))

    def _ping(self, message: Message, now: int, done: Handled) -> None:
        if message.get("target_system") == 0:
            fields = message.fields() | {"target_system": message.system, "target_component": message.component}
            done.replies.append(self._pack("PING", **fields))

    def _command(self, message: Message, now: int, done: Handled) -> None:
        command, first, second = (message.get(n) for n in ("command", "param1", "param2"))
        if command == Order.ARM:
            result = self._arm(first, _who(message), done)
        elif command == Order.TERMINATE and first > 0.5:
            result = self._arm(0.0, _who(message), done)
        elif command == Order.SET_MODE:
            result = self._change_mode(int(first) if 0 <= first < 256 else 0, second, _who(message), done)
        elif (request := requested(Wanted(command, first, second))) is not None:
            result = self._ask_pilot(request, _who(message), done)
        elif command == Order.REQUEST_CAPABILITIES or (command == Order.REQUEST_MESSAGE and first == 148):
            done.replies.append(self._pack("AUTOPILOT_VERSION", **version_fields(self._endpoint)))
            result = Result.ACCEPTED
        elif command == Order.REQUEST_MESSAGE and first == 0:
            done.replies.append(self._heartbeat())
            result = Result.ACCEPTED
        else:
            result, packets = self._streams.order(command, first, second, now)
            done.replies.extend(packets)
        done.replies.append(self._acknowledge(command, result, message))

    def _acknowledge(self, command: int, result: Result, message: Message) -> bytes:
        return self._pack(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=message.system,
            target_component=message.component,
        )

    def _arm(self, wanted: float, who: Who, done: Handled) -> Result:
        if wanted not in (0.0, 1.0):
            return Result.DENIED
        if wanted and not self.status.armed and self.status.not_ready:
            self.say(Severity.WARNING, f"Arming refused: {self.status.not_ready}")
            return Result.NOT_NOW
        done.events.append(ArmAsked(bool(wanted), who))
        return Result.ACCEPTED

    def _change_mode(self, flags: int, mode: float, who: Who, done: Handled) -> Result:
        if not flags & ModeFlag.CUSTOM or mode not in self._modes:
            known = ", ".join(f"{number} {name}" for number, name in self._modes.items())
            self.say(Severity.WARNING, f"No mode {mode:g}; there are {known}")
            return Result.DENIED
        why = self.status.closed.get(int(mode))
        if why:
            self.say(Severity.WARNING, f"Mode {self._modes[int(mode)]} refused: {why}")
            return Result.NOT_NOW
        done.events.append(ModeAsked(int(mode), who))
        return Result.ACCEPTED

    def _ask_pilot(self, request: str, who: Who, done: Handled) -> Result:
        if not request:
            return Result.DENIED
        if self.status.deaf:
            self.say(Severity.WARNING, f"Not asked to {request}: {self.status.deaf}")
            return Result.NOT_NOW
        done.events.append(FlightAsked(request, who))
        return Result.ACCEPTED

    def _set_mode(self, message: Message, now: int, done: Handled) -> None:
        result = self._change_mode(message.get("base_mode"), message.get("custom_mode"), _who(message), done)
        done.replies.append(self._acknowledge(SET_MODE_MESSAGE, result, message))

    def _set_parameter(self, message: Message, now: int, done: Handled) -> None:
        why_not = "can't be changed while armed" if self.status.armed and not self._live else ""
        replies, events, refused = self._parameters.change(message, why_not)
        done.replies.extend(replies)
        done.events.extend(events)
        if refused:
            self.say(Severity.WARNING, f"Not set: {refused}")

    def _refuse_key(self, message: Message, now: int, done: Handled) -> None:
        self.say(Severity.WARNING, "Keys are not taken over the link")


def _who(message: Message) -> Who:
    return message.system, message.component
