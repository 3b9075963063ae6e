"""The autopilot's numbers as a ground station's parameters, on both ends of the line.

A station reaches the vehicle alone. So the vehicle passes what is meant for the autopilot's component on to it, and its
answers back to the stations; the autopilot answers for its numbers, and changes them between two steps. Each change is
an event of its log, so that a replay repeats it. They are stored, when that is asked for, at the end of the flight: no
disk keeps a flight waiting.
Source: docs page, Ground stations.
"""

from collections import deque
from typing import Any

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.quantity import Quantity
from trimtab.live.broadcast import Broadcast
from trimtab.live.parameter_store import ParameterStore
from trimtab.loop.scenario import Scenario
from trimtab.run.parameter_changes import AutopilotChange
from trimtab.wire.definitions import Message
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.parameters import NO_STORE, Parameters, ParameterService
from trimtab.wire.protocol import CommandCode, CommandResult, Severity, VehicleType
from trimtab.wire.station import RESET_STORAGE, WRITE_STORAGE
from trimtab.wire.streams import TextQueue

PREFIX = "autopilot"
LIST, READ, SET = "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"
REQUESTS = (LIST, READ, SET, "COMMAND_LONG")
ANSWERS = ("HEARTBEAT", "PARAM_VALUE", "STATUSTEXT", "COMMAND_ACK")


class AutopilotRelay:
    """The vehicle's part: passes parameters' requests and answers on."""

    def __init__(self, endpoint: Endpoint, broadcast: Broadcast) -> None:
        """No autopilot heard yet."""
        self._endpoint, self._broadcast = endpoint, broadcast
        self._component = 0

    def pass_on(self, message: Message) -> None:
        """Pass a message on if it is for the autopilot, or one of its answers."""
        if message.system == self._endpoint.system:
            self._pass_answer(message)
        elif self._component and message.name in REQUESTS and self._is_for_autopilot(message):
            fields = message.fields() | {"target_component": self._component}
            self._broadcast.send_private([self._endpoint.pack(message.name, fields)])

    def _pass_answer(self, message: Message) -> None:
        if message.name == "HEARTBEAT" and message.get("type") == VehicleType.ONBOARD_COMPUTER:
            self._component = message.component
        if message.component != self._component or message.name not in ANSWERS:
            return
        if message.name != "COMMAND_ACK" or message.get("command") == CommandCode.STORAGE:
            self._broadcast.forward(message)

    def _is_for_autopilot(self, message: Message) -> bool:
        if message.get("target_system") not in (0, self._endpoint.system):
            return False
        if message.name == "COMMAND_LONG" and message.get("command") != CommandCode.STORAGE:
            return False
        whom = (0, self._component) if message.name == LIST else (self._component,)
        return message.get("target_component") in whom


def _describe_bounds(declared: Quantity) -> dict[str, Any]:
    """What may be said of a number's values."""
    bounds = {"low": declared.low, "high": declared.high, "above": declared.above, "modes": declared.modes or None}
    return {"unit": declared.unit, "meaning": declared.doc, **bounds}


class AutopilotParameters:
    """The autopilot's part. Times `now` are this end's, in 100 ns."""

    def __init__(self, scenario: Scenario, step: CompiledBlock, endpoint: Endpoint, store: ParameterStore) -> None:
        """step: the compiled autopilot of this scenario.  store: where they are kept."""
        self._endpoint, self._step = endpoint, step
        held = {f"{PREFIX}.{path}" for path in step.parameters}
        self._parameters = Parameters(scenario.autopilot, PREFIX, only=held)
        self._service = ParameterService(endpoint, self._parameters)
        self._store = store
        self._waiting: deque[AutopilotChange] = deque()
        self._packets: deque[bytes] = deque()
        self._texts, self._storage = TextQueue(endpoint), 0

    def handle_message(self, message: Message) -> bool:
        """Follow a request about parameters; whether it was one, for this end."""
        own = self._endpoint.system, self._endpoint.component
        if message.name not in REQUESTS or (message.get("target_system"), message.get("target_component")) != own:
            return False
        if message.name == "COMMAND_LONG":
            return self._handle_command(message)
        if message.name == LIST:
            self._service.start_list()
        elif message.name == READ:
            self._packets.extend(self._service.read(message))
        else:
            packets, changes, refusal = self._service.change_value(message)
            self._packets.extend(packets)
            self._waiting.extend(
                AutopilotChange(0, c.path.removeprefix(f"{PREFIX}."), c.slot, c.value) for c in changes
            )
            if refusal:
                self._tell(f"Not set: {refusal}")
        return True

    def describe(self) -> list[dict[str, Any]]:
        """Each of them, for people who change them."""
        held = self._parameters
        return [
            {"path": f"{p.path}", "slot": p.slot, "value": value, "default": default, **_describe_bounds(p.declaration)}
            for p, value, default in zip(held.listed, held.values, held.defaults, strict=True)
        ]

    def value(self, path: str, slot: int) -> float | None:
        """What holds now, or from the next step on; None where there is no such parameter."""
        index = self._parameters.index_of(path, slot)
        return None if index is None else self._parameters.values[index]

    def change(self, path: str, slot: int, value: float) -> str:
        """Give one another value, from the next step on; why not, empty where it was done."""
        index = self._parameters.index_of(path, slot)
        if index is None:
            return f"there is no parameter {path!r}, number {slot}"
        before, refusal = self._parameters.values[index], self._parameters.change_value(index, value)
        if not refusal and self._parameters.values[index] != before:
            self._waiting.append(AutopilotChange(0, path.removeprefix(f"{PREFIX}."), slot, value))
        return f"{path} {refusal}" if refusal else ""

    def ask_storage(self) -> str:
        """Have them stored at the end of the flight; why not, empty where they will be."""
        self._storage = WRITE_STORAGE if self._store.is_there else 0
        return "" if self._storage else NO_STORE

    def _handle_command(self, message: Message) -> bool:
        if message.get("command") != CommandCode.STORAGE:
            return False
        self._storage = int(message.get("param1")) if message.get("param1") in (WRITE_STORAGE, RESET_STORAGE) else 0
        result = CommandResult.ACCEPTED if self._storage else CommandResult.UNSUPPORTED
        self._packets.append(self._endpoint.pack("COMMAND_ACK", {"command": CommandCode.STORAGE, "result": result}))
        if self._storage:
            self._tell("Parameters are stored when the flight ends")
        return True

    def apply_changes(self, t: int) -> list[AutopilotChange]:
        """Put what was changed into the step that is to come, at integer time t; what that was."""
        changes = [change._replace(t=t) for change in self._waiting]
        self._waiting.clear()
        for change in changes:
            change.put_into(self._step.parameters)
        return changes

    def due(self, now: int) -> list[bytes]:
        """What is to be sent by now."""
        packets = [*self._packets, *self._texts.pack_texts(), *self._service.due(now)]
        self._packets.clear()
        return packets

    def store(self) -> str:
        """Store them, or forget them, if that was asked for, after a flight; a line for people, or nothing."""
        if not self._storage:
            return ""
        is_reset, self._storage = self._storage == RESET_STORAGE, 0
        why = self._store.write(None if is_reset else self._parameters.changed_values())
        return f"parameters not stored: {why}" if why else "parameters stored, for the next start"

    def _tell(self, text: str) -> None:
        self._texts.queue_text(Severity.NOTICE, text)
