"""What ground stations ask of the autopilot, passed on by the vehicle: hold, resume, end; and what the autopilot does.

The autopilot's heartbeat, of an onboard computer, has its supervisor's mode as custom mode; one without a supervisor
has none, and can't be asked. A request is sent again each 100 ms until it is acknowledged.
Source: docs page, Station.
"""

from collections.abc import Callable
from typing import NamedTuple

from trimtab.core.time import ms, seconds
from trimtab.live.duties import COMPUTER_MODE, HOLD_MODE
from trimtab.loop.supervision import HOLD as HOLDS
from trimtab.loop.supervision import MODES
from trimtab.wire.events import Event, FlightAsked, ModeAsked
from trimtab.wire.flight_requests import HOLD, ORDERS, RESUME
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.message import Message
from trimtab.wire.protocol import ModeFlag, Result, VehicleType
from trimtab.wire.station import Status

AGAIN, GIVEN_UP, GONE = ms(100), seconds(2), seconds(5)
"""Until a request is sent again, and not any more; without heartbeats for so long the autopilot is gone."""
NOBODY = "no autopilot with a supervisor is heard"


class _Pending(NamedTuple):
    request: str
    since: int
    next: int
    sent: int


class FlightRequests:
    """The vehicle's side; times `now` are the vehicle's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, tell: Callable[[str], None]) -> None:
        """tell: is given lines for people."""
        self._endpoint, self._tell = endpoint, tell
        self._heard: int | None = None
        self._autopilot, self._mode = 0, 0
        self._pending: _Pending | None = None

    def hear(self, message: Message, now: int) -> None:
        """Follow the autopilot: its heartbeats, and what it acknowledges."""
        if message.system != self._endpoint.system:
            return
        if message.name == "HEARTBEAT":
            self._beat(message, now)
        elif message.name == "COMMAND_ACK" and message.component == self._autopilot:
            self._acknowledged(message)

    def _beat(self, message: Message, now: int) -> None:
        mode, supervised = message.get("custom_mode"), message.get("base_mode") & ModeFlag.CUSTOM
        if message.get("type") != VehicleType.ONBOARD_COMPUTER or not supervised or mode >= len(MODES):
            return
        if not self._there(now) or mode != self._mode:
            self._tell(f"autopilot: {MODES[mode]}")
        self._heard, self._autopilot, self._mode = now, message.component, mode

    def _acknowledged(self, message: Message) -> None:
        asked = self._pending
        if asked is None or message.get("command") != ORDERS[asked.request].command:
            return
        self._pending = None
        if message.get("result") != Result.ACCEPTED:
            self._tell(f"autopilot: {asked.request} refused")

    def ask(self, event: Event, now: int) -> None:
        """Begin to pass a request on; a newer one takes the place of an older."""
        if isinstance(event, FlightAsked):
            self._pending = _Pending(event.request, now, now, 0)
        elif isinstance(event, ModeAsked) and event.mode == HOLD_MODE:
            self._pending = _Pending(HOLD, now, now, 0)
        elif isinstance(event, ModeAsked) and event.mode == COMPUTER_MODE and (self.holds or self._is_to_hold):
            self._pending = _Pending(RESUME, now, now, 0)

    @property
    def holds(self) -> bool:
        """Whether the autopilot said last that it holds."""
        return self._mode == HOLDS

    @property
    def _is_to_hold(self) -> bool:
        return self._pending is not None and self._pending.request == HOLD

    def _there(self, now: int) -> bool:
        return self._heard is not None and now - self._heard <= GONE

    def due(self, now: int) -> list[bytes]:
        """What is to be sent by now."""
        asked = self._pending
        if asked is None or now < asked.next:
            return []
        if now - asked.since > GIVEN_UP:
            self._pending = None
            self._tell(f"autopilot: {asked.request}: no answer")
            return []
        self._pending = asked._replace(next=now + AGAIN, sent=asked.sent + 1)
        command, first, second = ORDERS[asked.request]
        fields = {"command": command, "param1": first, "param2": second, "confirmation": asked.sent}
        to = {"target_system": self._endpoint.system, "target_component": self._autopilot}
        return [self._endpoint.pack("COMMAND_LONG", fields | to)]

    def status(self, status: Status, now: int) -> Status:
        """What the vehicle tells, with the autopilot's part in it."""
        there = self._there(now)
        mode = HOLD_MODE if there and self.holds and status.mode == COMPUTER_MODE else status.mode
        why = "" if there else NOBODY
        return status._replace(mode=mode, deaf=why, closed={HOLD_MODE: why} if why else {})
