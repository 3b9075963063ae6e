"""Requests of ground stations to the supervisor, forwarded by the vehicle, and heartbeats that report the supervisor's
mode.

Source: docs page, Fly; MAVLink's services heartbeat and command.
"""

from collections import deque

from trimtab.core.time import seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandResult, FlightCommand, ModeFlag, parse_request
from trimtab.vehicles.vehicle_type import VehicleType

NO_AUTOPILOT = 8
HEARTBEAT = {"type": VehicleType.ONBOARD_COMPUTER, "autopilot": NO_AUTOPILOT, "system_status": 4}
"""Heartbeat of a running onboard computer that is not a flight controller."""
HEARTBEAT_PERIOD = seconds(1)
MOST_REQUESTS = 8


class ForwardedRequests:
    """Receiver of forwarded requests, and sender of the autopilot's heartbeats.

    Times are by the autopilot's clock, in 100 ns.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        """endpoint: autopilot's end of the link."""
        self._endpoint = endpoint
        self.pending: deque[str] = deque(maxlen=MOST_REQUESTS)
        """Requests of ground stations that have not been passed to the supervisor yet."""
        self.mode: int | None = None
        """Number of the supervisor's mode, sent in heartbeats, or None without a supervisor that accepts requests."""
        self._last_mode: int | None = None
        self._next = 0

    def due(self, now: int) -> list[bytes]:
        """Return the heartbeat if it is due now, otherwise an empty list. After a change of mode the heartbeat is due
        immediately."""
        if now < self._next and self.mode == self._last_mode:
            return []
        self._next, self._last_mode = now + HEARTBEAT_PERIOD, self.mode
        mode = {} if self.mode is None else {"base_mode": ModeFlag.CUSTOM, "custom_mode": self.mode}
        return [self._endpoint.pack("HEARTBEAT", HEARTBEAT | mode)]

    def answer(self, message: Message) -> list[bytes]:
        """Store the request in a COMMAND_LONG message, and return the packets that acknowledge it. Commands to other
        components are ignored."""
        own = self._endpoint.system, self._endpoint.component
        if (message.get("target_system"), message.get("target_component")) != own:
            return []
        request = parse_request(FlightCommand(*(message.get(n) for n in ("command", "param1", "param2"))))
        is_accepted = bool(request) and self.mode is not None
        if request and is_accepted:
            self.pending.append(request)
        result = CommandResult.ACCEPTED if is_accepted else CommandResult.UNSUPPORTED
        answer = {"command": message.get("command"), "result": result}
        to = {"target_system": message.system, "target_component": message.component}
        return [self._endpoint.pack("COMMAND_ACK", answer | to)]
