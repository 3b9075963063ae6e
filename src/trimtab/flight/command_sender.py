"""Sender of an autopilot's commands, stamped with the vehicle's time.

Source: docs page, Fly.
"""

from trimtab.core.interfaces import Link
from trimtab.flight.autopilot_end import AutopilotEnd
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.time_sync import TimeSync


class CommandSender:
    """Sender of the commands of one flight.

    The time stamps of the commands increase, because a vehicle rejects a command that is older than the last command.
    """

    def __init__(self, end: AutopilotEnd, endpoint: Endpoint, link: Link, sync: TimeSync) -> None:
        """Start without a command. sync: estimate of the vehicle's clock."""
        self._end, self._endpoint, self._link, self._sync = end, endpoint, link, sync
        self._last_time = self._jumps = 0

    def send(self, t: int, ahead: int) -> None:
        """Send the current command. t: time of the loop.  ahead: the vehicle's time minus the loop's time.

        The time stamps increase even if the estimate of the vehicle's clock decreases. After a jump of this clock, e.g.
        a reboot of the vehicle, they may decrease.
        """
        if t + ahead <= self._last_time and self._sync.jumps == self._jumps:
            ahead = self._last_time + 1 - t
        self._last_time, self._jumps = t + ahead, self._sync.jumps
        for packet in self._end.command_packets(self._endpoint, ahead):
            self._link.send(packet)
