"""Arming state and owner of a vehicle, as known to the autopilot, and the autopilot's requests to arm and disarm.

Source: docs pages, Fly and Vehicle (Authority); MAVLink's services heartbeat and command.
"""

from collections.abc import Callable, Mapping

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandCode, ModeFlag, State
from trimtab.flight.scenario_comparison import ScenarioComparison
from trimtab.flight.station.arming import CONFIRMATION
from trimtab.flight.station.standard_services import OWNED_COMMANDS

ARM_PERIOD, DISARM_PERIOD = ms(500), ms(100)
"""Times after which an unanswered request is repeated: first for a request to arm, second for a request to disarm."""
COMMON_END = seconds(1)
"""Grace period (100 ns). If the vehicle's program ends at most this long before the flight ends, the end counts as
normal."""


class RemoteArming:
    """Arming state of the vehicle. Times `now` are by the autopilot's clock, in 100 ns."""

    def __init__(
        self, endpoint: Endpoint, comparison: ScenarioComparison, confirms: bool, tell: Callable[[str], None]
    ) -> None:
        """Start with a disarmed vehicle.

        Args:
            endpoint: autopilot's end of the link.
            comparison: comparison of the scenarios of vehicle and autopilot. The scenarios must match while the vehicle
                is asked to arm.
            confirms: True if the user confirms that the vehicle may be armed again after a failsafe.
            tell: function that receives the messages for the user and for the log.
        """
        self._endpoint, self._comparison, self.confirms, self._tell = endpoint, comparison, confirms, tell
        self.armed = self.has_failed_safe = self.is_in_failsafe = False
        """armed: True if the vehicle reports that it is armed.  has_failed_safe: True if the vehicle was in failsafe
        while it belonged to this autopilot.
        """
        self._end_time: int | None = None
        """Time at which the vehicle reported that it had disarmed because its program ends, or None."""
        self.owner = 0
        """Session number of the autopilot that owns the vehicle, as last reported by the vehicle, or 0 if the vehicle
        has no owner or has reported none."""
        self.has_authority = self._takes_over = False
        """has_authority: True if the vehicle accepts this autopilot as its owner."""
        self._request: float | None = None
        self._next = 0

    @property
    def is_taken(self) -> bool:
        """True if the vehicle belongs to another autopilot and this autopilot has not asked to take it over."""
        return self.owner not in (0, self._endpoint.session) and not self._takes_over

    @property
    def is_asking(self) -> bool:
        """True while a request to arm or disarm is unanswered."""
        return self._request is not None

    def arm(self, *, takes_over: bool = False) -> None:
        """Ask the vehicle to arm, repeatedly until the vehicle answers. If the vehicle is already armed, ask for its
        owner.

        takes_over: True to take the vehicle over from the autopilot that flies it.
        """
        if self._request is None and not self.has_authority:
            self._takes_over = takes_over
            self._request, self._next = 1.0, 0

    def disarm(self) -> None:
        """Ask the vehicle to disarm, repeatedly until the vehicle answers."""
        self._request, self._next = 0.0, 0

    def due(self, now: int, system: int) -> list[bytes]:
        """Return the packets of the request that is due now. system: MAVLink system id of the vehicle."""
        if self._request and not self.armed and self._comparison.count_differences():
            self._request = None  # settings have changed since the request and must be compared first
        if self._request is None or now < self._next:
            return []
        self._next = now + (ARM_PERIOD if self._request else DISARM_PERIOD)
        packets, own, theirs = list[bytes](), self._endpoint.session, self._comparison.vehicle_session
        if self._takes_over:
            control = {"param2": 1, "param5": own, "param6": theirs}
            request = CommandCode.REQUEST_CONTROL
            packets.append(pack_command(self._endpoint, system, request, self._endpoint.system, control))
        fields = {"param3": own, "param4": theirs, "param5": self._comparison.identity_number}
        if self.confirms and self._request:
            fields["param2"] = CONFIRMATION
        return [*packets, pack_command(self._endpoint, system, CommandCode.ARM, self._request, fields)]

    def handle_heartbeat(self, message: Message, now: int) -> None:
        """Handle a heartbeat of the vehicle."""
        armed, state = bool(message.get("base_mode") & ModeFlag.ARMED), message.get("system_status")
        if self.armed and not armed:
            self._end_time = now if state == State.POWEROFF else None
            self._tell("the vehicle is no longer armed")
        self.is_in_failsafe = state == State.CRITICAL
        self.has_failed_safe |= self.has_authority and self.is_in_failsafe
        if not armed:
            self.owner = 0
        self.armed = armed

    def handle_acknowledgement(self, command: int, is_accepted: bool, owner: int) -> None:
        """Handle the vehicle's answer to a command.

        owner: session number of the autopilot that owns the vehicle, or 0 if the vehicle has no owner or reports none.
        """
        if command in OWNED_COMMANDS:
            self._follow_owner(owner)
        is_ours = owner in (0, self._endpoint.session)  # else it answers another autopilot with the same ids
        if command == CommandCode.ARM and is_accepted and is_ours and self._request is not None:
            self.armed = self.has_authority = bool(self._request)
            self._request = None
        elif command == CommandCode.ARM and not is_ours and self._request == 0.0:
            self._request = None  # another autopilot owns the vehicle: do not disarm it

    def _follow_owner(self, owner: int) -> None:
        """Store the owner of the vehicle. Give up authority if the owner is another autopilot."""
        self.owner = owner
        if self.has_authority and owner not in (0, self._endpoint.session):
            self.has_authority = False
            self._tell(f"the vehicle belongs to another autopilot now, session {owner:06x}")
        elif owner == self._endpoint.session:
            self._takes_over = False
            if self._request:  # the announcement of the owner serves as the acknowledgement if that was lost
                self.armed = self.has_authority = True
                self._request = None

    def list_problems(self, was_armed: bool, is_silent: bool, now: int, is_stopped: bool = False) -> list[str]:
        """Return the problems of the vehicle at the end of the flight, before the vehicle is disarmed, for the JSON
        report.

        is_stopped: True if a pilot has disarmed the vehicle.
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


def pack_command(
    endpoint: Endpoint, system: int, command: CommandCode, first: float, others: Mapping[str, float] | None = None
) -> bytes:
    """Return the packet of a MAVLink command.

    system: id of the system that receives the command.  first: first parameter of the command.  others: further
    parameters, by name.
    """
    fields = {"command": command, "param1": first, "target_system": system, "target_component": 0}
    return endpoint.pack("COMMAND_LONG", fields | dict(others or {}))
