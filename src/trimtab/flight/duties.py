"""Duties of a vehicle's firmware: accept or refuse commands, and bring the vehicle to a safe state when commands are
missing.

The firmware also forwards the requests of ground stations (hold, resume, end) to the autopilot. It repeats a request
every 100 ms until the autopilot acknowledges it. It also reports the autopilot's mode to the stations. The autopilot
sends heartbeats as an onboard computer. Their custom mode is the mode of the autopilot's supervisor. An autopilot
without a supervisor sends no custom mode, and accepts no requests.
Source: docs pages, Vehicle and Station.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from trimtab.actuators.failsafe import BREACHES, CAUSES, MODES, Failsafe
from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.signals import Command
from trimtab.core.time import SECONDS_PER_UNIT, ms, seconds
from trimtab.flight.exchange import GroupSample, slot_indices
from trimtab.flight.manual_control import MANUAL_MODE, ManualControl
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import (
    FLIGHT_COMMANDS,
    HOLD,
    RESUME,
    ArmRequest,
    CommandResult,
    FlightRequest,
    ModeFlag,
    ModeRequest,
    State,
    VehicleEvent,
)
from trimtab.flight.station.standard_services import Status
from trimtab.flight.station.streams import TextAssembly
from trimtab.loop import supervisor
from trimtab.loop.supervisor import HOLD as HOLDS
from trimtab.run.blocks import failsafe_block
from trimtab.run.kept_blocks import compile_kept
from trimtab.vehicles.vehicle_type import VehicleType

COMPUTER_MODE, HOLD_MODE = 15, 4
STATION_MODES = {COMPUTER_MODE: "computer", MANUAL_MODE: "manual", HOLD_MODE: "hold"}
"""Names of the vehicle's modes by the mode number that ground stations use. computer: the vehicle obeys the autopilot;
manual: it obeys the pilot's sticks; hold: it obeys the autopilot, whose mode is hold.

The mode numbers are those of GUIDED, MANUAL and HOLD of ArduPilot's rovers and boats, so that ground stations show
these names.
"""
RESEND_PERIOD, REQUEST_TIMEOUT, AUTOPILOT_TIMEOUT = ms(100), seconds(2), seconds(5)
"""Three times (100 ns): a request is repeated after the first, and given up after the second. The autopilot counts as
missing if no heartbeat arrives within the third.
"""
NO_AUTOPILOT_PROBLEM = "no supervised autopilot on the link"


class CommandSource(NamedTuple):
    """Mode of the vehicle, which says who commands it, and the cause of the last change of mode."""

    mode: str
    cause: str


class CommandPath:
    """Path of a received command into the compiled failsafe, through a compiled block of the uplink if there is one."""

    def __init__(self, step: CompiledBlock, uplink: CompiledBlock | None) -> None:
        """uplink: compiled block that commands pass before the failsafe, e.g. with a fault, or None."""
        self._step, self._uplink = step, uplink
        self._first = step if uplink is None else uplink
        self._slots = _input_slots(self._first)
        if uplink is not None:
            own = _input_slots(step)
            paths = [p for p in uplink.writes if p in own]
            self._outputs = slot_indices(uplink.writes, paths, len(uplink.outputs))
            self._inputs = slot_indices(own, paths, len(step.inputs))

    def slot(self, path: str) -> Any:
        """Return the index of an element of the newest command in the inputs of the first compiled block of the
        path."""
        return self._slots[path]

    def set_inputs(self, t: int, command: GroupSample | None) -> None:
        """Write the newest command into the inputs of the compiled failsafe, through the uplink's block if there is
        one."""
        inputs, at = self._first.inputs, self._slots
        if command is not None:
            command.write(inputs)
        inputs[at["t"]] = t
        inputs[at["command.fresh"]] = command is not None
        inputs[at["command.age"]] = (t - inputs[at["command.t"]]) * SECONDS_PER_UNIT
        if self._uplink is not None:
            self._uplink.step()
            self._step.inputs[self._inputs] = self._uplink.outputs[self._outputs]


class Duties:
    """Failsafe of a vehicle between its link and its actuators, with the requests that wait for the failsafe's next
    call."""

    def __init__(
        self, failsafe: Failsafe, command: Command, world: CompiledBlock, uplink: CompiledBlock | None = None
    ) -> None:
        """Start disarmed.

        Args:
            failsafe: failsafe of the vehicle.
            command: example of a command with the structure that the autopilot sends.
            world: compiled world. The failsafe's output is written into its inputs.
            uplink: compiled block that commands pass before the failsafe, e.g. with a fault, or None.
        """
        self.failsafe, self._world, self.uplink = failsafe, world, uplink
        self.step = compile_kept(failsafe_block, failsafe, command)
        self._inputs, writes = _input_slots(self.step), self.step.writes
        shared = [p for p in writes if p.startswith("command.") and p in world.reads]
        self._out = slot_indices(writes, shared, len(self.step.outputs))
        self._in = slot_indices(world.reads, shared, len(world.inputs))
        self.commands = CommandPath(self.step, uplink)
        self.pilot = ManualControl(failsafe, self.step.inputs, self._inputs)
        self._arm = self._disarm = False
        self.mode = CommandSource(MODES[0], CAUSES[0])
        self.breach = BREACHES[0]
        """Name of the limit that the vehicle violates, for the failsafe's next call."""
        self.is_ending = False
        """True while the vehicle disarms because the vehicle's program ends."""

    def handle_event(self, event: VehicleEvent, now: int) -> None:
        """Store a request for the failsafe's next call."""
        if isinstance(event, ArmRequest):
            self._arm, self._disarm = event.arm, not event.arm
        self.pilot.handle_event(event, now)

    def act(self, t: int, command: GroupSample | None) -> bool:
        """Run the compiled failsafe at integer time t. Return True if the mode changes.

        command: the newest command if one has arrived since the last call, otherwise None.
        """
        self.commands.set_inputs(t, command)
        inputs, at = self.step.inputs, self._inputs
        inputs[at["t"]] = t
        self.pilot.set_inputs(t)
        inputs[at["arm"]], inputs[at["disarm"]] = self._arm, self._disarm
        inputs[at["breach"]] = BREACHES.index(self.breach)
        self._arm = self._disarm = False
        self.step.step()
        self.pilot.end_step()
        self._world.inputs[self._in] = self.step.outputs[self._out]
        before = self.mode
        self.mode = CommandSource(MODES[int(self.step.result("mode"))], CAUSES[int(self.step.result("cause"))])
        return self.mode != before

    @property
    def is_commanded(self) -> bool:
        """True while the vehicle obeys the autopilot or the pilot."""
        return self.mode.mode in ("computer", "manual")

    @property
    def status(self) -> Status:
        """Status of the vehicle (mode, armed or not, MAVLink state) for ground stations."""
        state = {"failsafe": State.CRITICAL, "disarmed": State.STANDBY}.get(self.mode.mode, State.ACTIVE)
        state = State.POWEROFF if self.is_ending and state != State.CRITICAL else state
        mode = MANUAL_MODE if self.pilot.wants_control else COMPUTER_MODE
        return Status(mode=mode, armed=self.is_commanded, state=state)


def _input_slots(step: CompiledBlock) -> dict[str, Any]:
    """Return the index of each input of a compiled block, by the input's path without the prefix "input."."""
    return {path.removeprefix("input."): at for path, at in step.reads.items()}


class _PendingRequest(NamedTuple):
    request: str
    since: int
    next: int
    sent: int


class FlightRequests:
    """Forwarder of requests from ground stations to the autopilot. Times are by the vehicle's clock, in 100 ns."""

    def __init__(self, endpoint: Endpoint, tell: Callable[[str], None]) -> None:
        """tell: function that receives the messages for the user."""
        self._endpoint, self._tell = endpoint, tell
        self._heartbeat_time: int | None = None
        self._autopilot, self._mode = 0, 0
        self._pending: _PendingRequest | None = None
        self._texts = TextAssembly()

    def handle_message(self, message: Message, now: int) -> None:
        """Handle a heartbeat, text or acknowledgement of the autopilot. Other messages have no effect."""
        if message.system != self._endpoint.system:
            return
        if message.name == "HEARTBEAT":
            self._handle_heartbeat(message, now)
        elif message.name == "STATUSTEXT":
            text = self._texts.join(message)
            if text:
                self._tell(f"autopilot: {text}")
        elif message.name == "COMMAND_ACK" and message.component == self._autopilot:
            self._handle_acknowledgement(message)

    def _handle_heartbeat(self, message: Message, now: int) -> None:
        mode, supervised = message.get("custom_mode"), message.get("base_mode") & ModeFlag.CUSTOM
        if message.get("type") != VehicleType.ONBOARD_COMPUTER or not supervised or mode >= len(supervisor.MODES):
            return
        if not self._is_autopilot_present(now) or mode != self._mode:
            self._tell(f"autopilot: {supervisor.MODES[mode]}")
        self._heartbeat_time, self._autopilot, self._mode = now, message.component, mode

    def _handle_acknowledgement(self, message: Message) -> None:
        pending = self._pending
        if pending is None or message.get("command") != FLIGHT_COMMANDS[pending.request].command:
            return
        self._pending = None
        if message.get("result") != CommandResult.ACCEPTED:
            self._tell(f"autopilot: {pending.request} refused")

    def handle_event(self, event: VehicleEvent, now: int) -> None:
        """Start to forward a request to the autopilot. It replaces an earlier request that is still pending."""
        if isinstance(event, FlightRequest):
            self._pending = _PendingRequest(event.request, now, now, 0)
        elif isinstance(event, ModeRequest) and event.mode == HOLD_MODE:
            self._pending = _PendingRequest(HOLD, now, now, 0)
        elif isinstance(event, ModeRequest) and event.mode == COMPUTER_MODE and (self.holds or self._is_hold_pending):
            self._pending = _PendingRequest(RESUME, now, now, 0)

    @property
    def holds(self) -> bool:
        """True if the autopilot's last heartbeat reported the mode "hold"."""
        return self._mode == HOLDS

    @property
    def _is_hold_pending(self) -> bool:
        return self._pending is not None and self._pending.request == HOLD

    def _is_autopilot_present(self, now: int) -> bool:
        return self._heartbeat_time is not None and now - self._heartbeat_time <= AUTOPILOT_TIMEOUT

    def due(self, now: int) -> list[bytes]:
        """Return the packet of a pending request if it must be sent now."""
        pending = self._pending
        if pending is None or now < pending.next:
            return []
        if now - pending.since > REQUEST_TIMEOUT:
            self._pending = None
            self._tell(f"autopilot: {pending.request}: no answer")
            return []
        self._pending = pending._replace(next=now + RESEND_PERIOD, sent=pending.sent + 1)
        command, first, second = FLIGHT_COMMANDS[pending.request]
        fields = {"command": command, "param1": first, "param2": second, "confirmation": pending.sent}
        to = {"target_system": self._endpoint.system, "target_component": self._autopilot}
        return [self._endpoint.pack("COMMAND_LONG", fields | to)]

    def status(self, status: Status, now: int) -> Status:
        """Return a copy of the vehicle's status in which the autopilot's mode and problem are set."""
        there = self._is_autopilot_present(now)
        mode = HOLD_MODE if there and self.holds and status.mode == COMPUTER_MODE else status.mode
        why = "" if there else NO_AUTOPILOT_PROBLEM
        return status._replace(mode=mode, autopilot_problem=why, closed_modes={HOLD_MODE: why} if why else {})
