"""Filter that refuses commands from a wrong sender or with a wrong time stamp, and reports the refusals to vehicle,
autopilot and log.

Source: docs page, Vehicle.
"""

from collections.abc import Callable, Mapping

from trimtab.core.record import Quantity
from trimtab.core.time import ms, seconds
from trimtab.flight.broadcast import Broadcast
from trimtab.flight.mavlink.authority import Sender, command_sender
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.dialect import TIME
from trimtab.flight.station.standard_services import Station

MOST_COMMAND_LEAD = ms(200)
"""Largest accepted lead of a command's time stamp over the vehicle's clock (100 ns). A larger lead shows a wrong clock.
If such a command were accepted, the failsafe would refuse all other commands until the time of this time stamp.

The limit is below the failsafe's time-out. So one accepted command with a leading time stamp makes the vehicle refuse a
few good commands, but does not trigger the failsafe.
"""
TELL_PERIOD, REPORT_PERIOD = seconds(1), seconds(10)
AUTHORITY_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "firmware.owner": (
        "i8",
        Quantity(
            "1",
            "Session number of the vehicle's owner; 0: no owner, or an owner without a session number.",
            kind="count",
        ),
    ),
    "firmware.foreign": (
        "i8",
        Quantity("1", "Number of commands refused so far because their sender has no authority.", kind="count"),
    ),
    "firmware.leading": (
        "i8",
        Quantity(
            "1", "Number of commands refused so far because their time stamp is too far in the future.", kind="count"
        ),
    ),
}
"""Signals of the vehicle's log: the vehicle's owner, and counts of refused commands. `CommandGate.counts` returns the
values."""


class CommandGate:
    """Filter that accepts only the owner's commands. Times `now` are by the vehicle's clock, in 100 ns."""

    def __init__(self, station: Station, line: Broadcast, tell: Callable[[str], None]) -> None:
        """tell: function that receives the messages for vehicle, autopilot and log."""
        self._station, self._authority, self._line, self._tell = station, station.authority, line, tell
        self._tell_time = 0
        self._report_times: dict[tuple[str, Sender], int] = {}
        self._last_owner: Sender | None = None
        self.leading_commands = 0

    def admits(self, message: Message, now: int) -> bool:
        """Return True if the vehicle must obey a COMMAND message."""
        sender = command_sender(message)
        if not self._authority.accepts_command(sender):
            self._report(now, "without authority", sender, f"owner is {self._authority.owner}")
            if now >= self._tell_time:
                self._tell_time = now + TELL_PERIOD
                self._line.send(self._station.owner_packet())
            return False
        lead = message.get(TIME) - now
        if lead > MOST_COMMAND_LEAD:
            self.leading_commands += 1
            self._report(now, "of another clock", sender, f"{lead * 1e-7:.3g} s ahead of the vehicle's clock")
            return False
        return True

    def follow(self, is_commanded: bool) -> None:
        """Update the owner, and announce a new owner. Call this at each instant.

        is_commanded: True while an autopilot or the pilot is in command. Otherwise the vehicle has no owner.
        """
        if not is_commanded:
            self._authority.end_flight()
        owner = self._authority.owner
        if owner != self._last_owner:
            self._last_owner = owner
            self._line.send(self._station.owner_packet())
            if owner is not None:
                self._tell(f"commanded by {owner}")

    @property
    def counts(self) -> tuple[int, int, int]:
        """Current values of the signals in AUTHORITY_SIGNALS."""
        owner = self._authority.owner
        return 0 if owner is None else owner.session, self._authority.refused_commands, self.leading_commands

    def _report(self, now: int, what: str, sender: Sender, why: str) -> None:
        if now < self._report_times.get((what, sender), 0):
            return
        self._report_times = {k: t for k, t in self._report_times.items() if t > now}
        self._report_times[what, sender] = now + REPORT_PERIOD
        self._tell(f"commands {what} refused, from {sender}: {why}")
