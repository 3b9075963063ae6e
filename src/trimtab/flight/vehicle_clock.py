"""Clock of a vehicle, as an autopilot's end finds it by MAVLink's time synchronisation.

Source: docs page, Fly; MAVLink's service timesync.
"""

from collections.abc import Callable, Sequence

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint, UntimelyMessage
from trimtab.flight.mavlink.time_sync import TimeSync

SYNC_QUICK, SYNC_SLOW = ms(50), seconds(1)
QUICK_ANSWERS = 8
"""Number of answers after which the vehicle's clock counts as known. Questions then become less frequent."""
QUICK_ROUND_TRIP = ms(300)
"""Maximum round trip of the quickest answer for a known clock: an answer that waited in a queue is inaccurate."""


class VehicleClock:
    """Clock of the vehicle. Times `now` are this end's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, tell: Callable[[str], None], remarks: list[str]) -> None:
        """Start without an answer.

        Args:
            endpoint: this end of the link.
            tell: receives the messages for the user and for the log.
            remarks: list that a remark is appended to if this end follows the vehicle's clock.
        """
        self._endpoint, self._tell, self._remarks = endpoint, tell, remarks
        self.sync = TimeSync()
        self.untimely: UntimelyMessage | None = None
        """The vehicle's answer to a current question, rejected for its time stamp: the two clocks differ."""
        self._answers = self._jumps = self._next = 0

    @property
    def is_known(self) -> bool:
        """True if enough answers came, and one of them quickly."""
        return self._answers >= QUICK_ANSWERS and self.sync.shortest <= QUICK_ROUND_TRIP

    def offset(self, now: int) -> int:
        """Return the vehicle's clock minus this end's (100 ns), as applied now. It changes smoothly, without jumps."""
        return self.sync.to_remote(now) - now

    def due(self, now: int) -> list[bytes]:
        """Return the question that is due now."""
        if now < self._next:
            return []
        self._next = now + (SYNC_SLOW if self.is_known and not self.sync.is_doubtful else SYNC_QUICK)
        return [self._endpoint.pack("TIMESYNC", self.sync.ask(now))]

    def handle_answer(self, message: Message, now: int) -> bool:
        """Handle a TIMESYNC of the vehicle. Return whether it is the second answer to one question."""
        if not self.sync.handle_answer(message.get("tc1"), message.get("ts1"), now):
            return bool(self.sync.doubles)
        if self.sync.is_doubtful:
            self._next = now
            return False
        if self.sync.jumps != self._jumps:  # for example, because it was restarted
            self._jumps, self._answers = self.sync.jumps, 0
            self._tell("the vehicle's clock has changed")
        self._answers = min(self._answers + 1, QUICK_ANSWERS)
        return False

    def handle_untimely(self, untimely: Sequence[UntimelyMessage]) -> None:
        """Note that the clocks differ, if a frame that was rejected for its time answers a question of this end."""
        for refused in untimely:
            message = refused.message
            if message.name == "TIMESYNC" and message.get("tc1") > 0 and self.sync.is_open(message.get("ts1")):
                if self.untimely is None:
                    which = "ahead of" if refused.lead > 0 else "behind"
                    self._tell(f"the vehicle's time stamps are {abs(refused.lead):.1f} s {which} this end's: rejected")
                self.untimely = refused

    def follow(self) -> None:
        """Sign by the clock of the answering vehicle from now on."""
        if self.untimely is not None and self._endpoint.stamps is not None:
            self._endpoint.stamps.follow(self.untimely.stamp)
            remark = f"signing by the vehicle's clock, {self.untimely.lead:+.1f} s from this computer's"
            self._remarks.append(remark)
            self._tell(remark)
        self.untimely = None
