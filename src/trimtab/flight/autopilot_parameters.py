"""Access of ground stations to the autopilot's parameters: the relay on the vehicle, and the parameter service on the
autopilot.

A ground station has a link to the vehicle only. So the vehicle forwards a station's messages to the autopilot, and the
autopilot's answers to the stations. The autopilot answers requests for its parameters, and changes parameters between
two control periods. Each change is an event in the autopilot's log, so that a replay repeats the change. If a station
asks to store the parameters, they are written to the disk at the end of the flight, so that the disk cannot delay the
flight.
Source: docs page, Ground stations.
"""

from collections import deque
from typing import Any

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.quantity import Quantity
from trimtab.flight.broadcast import Broadcast
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandCode, CommandResult, Severity
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.station.parameters import NO_STORE, Parameters, ParameterService
from trimtab.flight.station.standard_services import RESET_STORAGE, WRITE_STORAGE
from trimtab.flight.station.streams import TextQueue
from trimtab.loop.scenario import Scenario
from trimtab.run.parameter_changes import AutopilotChange
from trimtab.vehicles.vehicle_type import VehicleType

PREFIX = "autopilot"
LIST, READ, SET = "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"
REQUESTS = (LIST, READ, SET, "COMMAND_LONG")
ANSWERS = ("HEARTBEAT", "PARAM_VALUE", "STATUSTEXT", "COMMAND_ACK")


class AutopilotRelay:
    """Relay on the vehicle, which forwards parameter requests to the autopilot and the autopilot's answers to ground
    stations."""

    def __init__(self, endpoint: Endpoint, broadcast: Broadcast) -> None:
        """Start without an autopilot. Messages are forwarded after the first heartbeat of an autopilot."""
        self._endpoint, self._broadcast = endpoint, broadcast
        self._component = 0

    def pass_on(self, message: Message) -> None:
        """Forward a message if it is a request to the autopilot or an answer of the autopilot."""
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
    """Return unit, meaning and bounds of a parameter as a dictionary for the console."""
    bounds = {"low": declared.low, "high": declared.high, "above": declared.above, "modes": declared.modes or None}
    return {"unit": declared.unit, "meaning": declared.doc, **bounds}


class AutopilotParameters:
    """Parameter service of the autopilot, which answers requests for parameters and changes parameters on request.

    Times `now` are by the autopilot's clock, in 100 ns.
    """

    def __init__(self, scenario: Scenario, step: CompiledBlock, endpoint: Endpoint, store: ParameterStore) -> None:
        """step: compiled autopilot of the scenario.  store: file in which changed parameters are stored."""
        self._endpoint, self._step = endpoint, step
        held = {f"{PREFIX}.{path}" for path in step.parameters}
        self._parameters = Parameters(scenario.autopilot, PREFIX, only=held)
        self._service = ParameterService(endpoint, self._parameters)
        self._store = store
        self._waiting: deque[AutopilotChange] = deque()
        self._packets: deque[bytes] = deque()
        self._texts, self._storage = TextQueue(endpoint), 0

    def handle_message(self, message: Message) -> bool:
        """Return True if the message is a parameter request to the autopilot. Such a message is handled."""
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
        """Return a description of each parameter, for the console: path, value, default, unit and bounds."""
        held = self._parameters
        return [
            {"path": f"{p.path}", "slot": p.slot, "value": value, "default": default, **_describe_bounds(p.declaration)}
            for p, value, default in zip(held.listed, held.values, held.defaults, strict=True)
        ]

    def value(self, path: str, slot: int) -> float | None:
        """Return the value that a parameter has from the next control period on, or None if the parameter does not
        exist."""
        index = self._parameters.index_of(path, slot)
        return None if index is None else self._parameters.values[index]

    def change(self, path: str, slot: int, value: float) -> str:
        """Change a parameter from the next control period on. Return the reason if the change is refused, or an empty
        string."""
        index = self._parameters.index_of(path, slot)
        if index is None:
            return f"no parameter {path!r} with an element {slot}"
        before, refusal = self._parameters.values[index], self._parameters.change_value(index, value)
        if not refusal and self._parameters.values[index] != before:
            self._waiting.append(AutopilotChange(0, path.removeprefix(f"{PREFIX}."), slot, value))
        return f"{path} {refusal}" if refusal else ""

    def ask_storage(self) -> str:
        """Request that the parameters are stored at the end of the flight. Return the reason if the request is refused,
        or ""."""
        self._storage = WRITE_STORAGE if self._store.is_there else 0
        return "" if self._storage else NO_STORE

    def _handle_command(self, message: Message) -> bool:
        if message.get("command") != CommandCode.STORAGE:
            return False
        self._storage = int(message.get("param1")) if message.get("param1") in (WRITE_STORAGE, RESET_STORAGE) else 0
        result = CommandResult.ACCEPTED if self._storage else CommandResult.UNSUPPORTED
        self._packets.append(self._endpoint.pack("COMMAND_ACK", {"command": CommandCode.STORAGE, "result": result}))
        if self._storage:
            self._tell("Parameters will be stored when the flight ends")
        return True

    def apply_changes(self, t: int) -> list[AutopilotChange]:
        """Apply the pending parameter changes to the compiled autopilot at integer time t. Return these changes."""
        changes = [change._replace(t=t) for change in self._waiting]
        self._waiting.clear()
        for change in changes:
            change.put_into(self._step.parameters)
        return changes

    def due(self, now: int) -> list[bytes]:
        """Return the packets with parameters, texts and acknowledgements that must be sent now."""
        packets = [*self._packets, *self._texts.pack_texts(), *self._service.due(now)]
        self._packets.clear()
        return packets

    def store(self) -> str:
        """If a ground station has requested it, store or reset the parameters after a flight. Return a message for the
        user, or ""."""
        if not self._storage:
            return ""
        is_reset, self._storage = self._storage == RESET_STORAGE, 0
        why = self._store.write(None if is_reset else self._parameters.changed_values())
        return f"parameters not stored: {why}" if why else "parameters stored for the next start"

    def _tell(self, text: str) -> None:
        self._texts.queue_text(Severity.NOTICE, text)
