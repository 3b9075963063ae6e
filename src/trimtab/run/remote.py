"""A vehicle as the autopilot's end sees it: whether it is there, armed, what it says, and what its clock shows.

Source: docs page, Fly; MAVLink's services heartbeat, command and timesync.
"""

from collections.abc import Callable

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, seconds
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.message import Message
from trimtab.wire.protocol import ModeFlag, Order, Result
from trimtab.wire.time_sync import TimeSync

HEARTBEAT = {"type": 18, "autopilot": 8, "system_status": 4}
"""Of an onboard computer that is no flight controller, running."""
HEARTBEAT_PERIOD, ASK_PERIOD = seconds(1), ms(500)
SYNC_QUICK, SYNC_SLOW = ms(50), seconds(1)
QUICK_ASKS = 8
"""Answers after which the other clock counts as known, and is asked for seldom."""
SHORT = ms(300)
"""At least one answer must have been as quick as this: what waited in a queue tells little of a clock."""


class Remote:
    """Keeps the line to a vehicle: heartbeats, time synchronisation, arming. Times `now` are this end's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, link: Link) -> None:
        self._endpoint, self._link = endpoint, link
        self.sync = TimeSync()
        self.tell: Callable[[str], None] = lambda _: None
        self.armed = False
        self.system = 0
        self.heard: int | None = None
        """When the vehicle's last heartbeat came."""
        self._next = dict.fromkeys(("heartbeat", "sync", "ask"), 0)
        self._wants: float | None = None
        self._asks = 0

    @property
    def ready(self) -> bool:
        """Whether there is a vehicle whose clock is known."""
        return self.heard is not None and self._known

    @property
    def _known(self) -> bool:
        return self._asks >= QUICK_ASKS and self.sync.shortest <= SHORT

    def why_not(self) -> str:
        """Why it is not ready, for people."""
        counts, carried = self._endpoint.counts, self._link.statistics
        if not carried.packets_in:
            return "no vehicle answers" + ("" if carried.connected else ": there is no connection")
        if counts.wrong_signature or counts.unsigned:
            return f"{counts.wrong_signature + counts.unsigned} frames came unsigned or signed with another key"
        if counts.checksum or counts.unknown:
            return f"{counts.checksum + counts.unknown} frames don't fit: the vehicle flies another scenario"
        return "a vehicle answers, but its clock is not known yet"

    def offset(self, now: int) -> int:
        """The vehicle's clock minus this end's (100 ns)."""
        return round(self.sync.offset)

    def take(self, message: Message, now: int) -> None:
        """Follow a message that is no sample."""
        if message.name == "HEARTBEAT":
            self.heard, self.system = now, message.system
            self.armed = bool(message.get("base_mode") & ModeFlag.ARMED)
        elif message.name == "TIMESYNC":
            if self.sync.answered(message.get("tc1"), message.get("ts1"), now) and self._asks < QUICK_ASKS:
                self._asks += 1
        elif message.name == "STATUSTEXT":
            self.tell(f"vehicle: {message.get('text')}")
        elif message.name == "COMMAND_ACK" and message.get("command") == Order.ARM:
            self._acknowledged(message.get("result"))

    def _acknowledged(self, result: int) -> None:
        if result == Result.ACCEPTED and self._wants is not None:
            self.armed, self._wants = bool(self._wants), None

    def due(self, now: int) -> None:
        """Send what is to be sent by now."""
        if now >= self._next["heartbeat"]:
            self._next["heartbeat"] = now + HEARTBEAT_PERIOD
            self._link.send(self._endpoint.pack("HEARTBEAT", HEARTBEAT))
        if now >= self._next["sync"]:
            self._next["sync"] = now + (SYNC_SLOW if self._known else SYNC_QUICK)
            self._link.send(self._endpoint.pack("TIMESYNC", self.sync.ask(now)))
        if self._wants is not None and now >= self._next["ask"]:
            self._next["ask"] = now + ASK_PERIOD
            self._send_arm(self._wants)

    def arm(self) -> None:
        """Ask the vehicle to arm, again and again until it has answered."""
        if self._wants is None and not self.armed:
            self._wants, self._next["ask"] = 1.0, 0

    def disarm(self) -> None:
        """Ask the vehicle to disarm, once."""
        self._wants = None
        self._send_arm(0.0)

    def _send_arm(self, wanted: float) -> None:
        fields = {"command": Order.ARM, "param1": wanted, "target_system": self.system, "target_component": 0}
        self._link.send(self._endpoint.pack("COMMAND_LONG", fields))
