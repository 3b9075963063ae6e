"""Estimation of the vehicle's clock at the autopilot's end, by MAVLink's time synchronisation.

Source: docs page, Fly; MAVLink's service timesync.
"""

from collections.abc import Callable, Sequence

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint, UntimelyMessage
from trimtab.flight.mavlink.time_sync import TimeSync

SYNC_QUICK, SYNC_SLOW = ms(50), seconds(1)
QUICK_ANSWERS = 8
"""Number of answered time requests after which the vehicle's clock counts as known. Further requests are then less
frequent."""
QUICK_ROUND_TRIP = ms(300)
"""Largest round-trip time (100 ns) of the quickest answer at which the vehicle's clock counts as known."""


class VehicleClock:
    """Estimator of the vehicle's clock. Times `now` are by the autopilot's clock, in 100 ns."""

    def __init__(self, endpoint: Endpoint, tell: Callable[[str], None], remarks: list[str]) -> None:
        """Start without an answer of the vehicle.

        Args:
            endpoint: autopilot's end of the link.
            tell: function that receives the messages for the user and for the log.
            remarks: list to which a remark is appended if the autopilot follows the vehicle's clock.
        """
        self._endpoint, self._tell, self._remarks = endpoint, tell, remarks
        self.sync = TimeSync()
        self.untimely: UntimelyMessage | None = None
        """Answer of the vehicle to a pending time request that was rejected because of its time stamp, or None."""
        self._answers = self._jumps = self._next = 0

    @property
    def is_known(self) -> bool:
        """True if enough answers have arrived, at least one of them with a short round trip."""
        return self._answers >= QUICK_ANSWERS and self.sync.shortest <= QUICK_ROUND_TRIP

    def offset(self, now: int) -> int:
        """Return the offset (100 ns) that is used in conversions: the vehicle's clock minus the autopilot's clock. The
        offset changes without jumps."""
        return self.sync.to_remote(now) - now

    def due(self, now: int) -> list[bytes]:
        """Return the packet of a time request if a request is due now, otherwise an empty list."""
        if now < self._next:
            return []
        self._next = now + (SYNC_SLOW if self.is_known and not self.sync.is_doubtful else SYNC_QUICK)
        return [self._endpoint.pack("TIMESYNC", self.sync.ask(now))]

    def handle_answer(self, message: Message, now: int) -> bool:
        """Handle a TIMESYNC message of the vehicle. Return True if this message is a second answer to the same
        request."""
        if not self.sync.handle_answer(message.get("tc1"), message.get("ts1"), now):
            return bool(self.sync.doubles)
        if self.sync.is_doubtful:
            self._next = now
            return False
        if self.sync.jumps != self._jumps:  # e.g. because the vehicle was restarted
            self._jumps, self._answers = self.sync.jumps, 0
            self._tell("the vehicle's clock has changed")
        self._answers = min(self._answers + 1, QUICK_ANSWERS)
        return False

    def handle_untimely(self, untimely: Sequence[UntimelyMessage]) -> None:
        """If a frame that was rejected because of its time stamp answers a pending time request, record that the clocks
        differ."""
        for refused in untimely:
            message = refused.message
            if message.name == "TIMESYNC" and message.get("tc1") > 0 and self.sync.is_open(message.get("ts1")):
                if self.untimely is None:
                    which = "ahead of" if refused.lead > 0 else "behind"
                    self._tell(f"the vehicle's time stamps are {abs(refused.lead):.1f} s {which} this end's: rejected")
                self.untimely = refused

    def follow(self) -> None:
        """Sign packets from now on with the time of the vehicle that answered."""
        if self.untimely is not None and self._endpoint.stamps is not None:
            self._endpoint.stamps.follow(self.untimely.stamp)
            remark = (
                f"packets are signed by the vehicle's clock, which is {self.untimely.lead:+.1f} s from this "
                "computer's clock"
            )
            self._remarks.append(remark)
            self._tell(remark)
        self.untimely = None
