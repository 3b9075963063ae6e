"""Distribution of received packets to the parts of a vehicle.

Source: docs page, Vehicle.
"""

from trimtab.flight.exchange import GroupSample
from trimtab.flight.injector import format_value
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.protocol import ArmRequest, ParameterChange, VehicleEvent
from trimtab.flight.real_time import WallClock
from trimtab.flight.scenario_identity import identity_path
from trimtab.flight.vehicle_parts import VehicleParts


class VehicleReceiver:
    """Receiver of the packets that are sent to a vehicle."""

    def __init__(self, parts: VehicleParts, clock: WallClock) -> None:
        """Start without a command. clock: clock of the vehicle."""
        self._parts, self._clock = parts, clock
        self._newest_command: GroupSample | None = None
        self._declared = {p.path: p.declaration for p in parts.parameters.listed}

    def take_command(self) -> GroupSample | None:
        """Return the newest command that was received since the last call, or None."""
        command, self._newest_command = self._newest_command, None
        return command

    def handle_data(self, data: bytes) -> None:
        """Pass the messages of a received packet to the parts that handle them."""
        parts, now, messages = self._parts, self._clock.now(), self._parts.endpoint.feed(data)
        parts.refusals.handle_refusals(now)
        parts.broadcast.accept_sender(messages, now)
        for message in messages:
            if message.name in parts.command.names:
                self._handle_command(message, now)
            else:
                self._handle_message(message, now)

    def _handle_command(self, message: Message, now: int) -> None:
        if not self._parts.gate.admits(message, now):
            return
        command = self._parts.command.assemble(message)
        if command is not None and (self._newest_command is None or command.t >= self._newest_command.t):
            self._newest_command = command

    def _handle_message(self, message: Message, now: int) -> None:
        parts = self._parts
        parts.requests.handle_message(message, now)
        parts.relay.pass_on(message)
        for packet in parts.identity.answer(message):
            parts.broadcast.send(packet)
        handled = parts.station.handle_message(message, now)
        for packet in handled.replies:
            parts.broadcast.send(packet)
        for event in handled.events:
            self._handle_event(event, now)

    def _handle_event(self, event: VehicleEvent, now: int) -> None:
        parts = self._parts
        if isinstance(event, ParameterChange):
            self._set_parameter(event)
            return
        parts.duties.handle_event(event, now)
        if isinstance(event, ArmRequest):
            self._note_request(event)
        parts.requests.handle_event(event, now)
        parts.instruments.handle_event(event, now)

    def _note_request(self, request: ArmRequest) -> None:
        """Log the results of the checks when the vehicle is armed. When the user disarms the vehicle, record the
        confirmation that it may be armed again after a failsafe."""
        if request.by_hand and not request.arm:
            self._parts.guard.confirm()
        if request.arm and not self._parts.duties.is_commanded:
            for check in self._parts.guard.checks:
                self._parts.reporter.log(check.record)

    def _set_parameter(self, event: ParameterChange) -> None:
        parts, path = self._parts, event.path.removeprefix("world.")
        uplink, world = parts.duties.uplink, parts.body.world
        if uplink is not None and path in uplink.parameters:
            values = uplink.parameters[path]
        else:
            values = world.parameters[event.path]
        values.flat[event.slot] = event.value
        parts.identity.change(identity_path(event.path), values)
        parts.station.status = parts.station.status._replace(identity=parts.identity.number)
        parts.reporter.report(f"{event.path} = {format_value(self._declared[event.path], event.value)}")
