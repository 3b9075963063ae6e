"""Sender of an autopilot's commands, stamped with the vehicle's time.

Source: docs page, Fly.
"""

from trimtab.core.interfaces import Link
from trimtab.flight.autopilot_end import AutopilotEnd
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.time_sync import TimeSync


class CommandSender:
    """Sender of the commands of one flight.

    Every command has a later time stamp than the command before, because a vehicle rejects a command that is older than
    the last one.
    """

    def __init__(self, end: AutopilotEnd, endpoint: Endpoint, link: Link, sync: TimeSync) -> None:
        """Start without a command. sync: estimator of the vehicle's clock."""
        self._end, self._endpoint, self._link, self._sync = end, endpoint, link, sync
        self._last_time = self._jumps = 0

    def send(self, t: int, ahead: int) -> None:
        """Send the current command. t: time of the control loop (100 ns).  ahead: the vehicle's time minus the loop's
        time (100 ns).

        The time stamps of commands increase even if the estimated time of the vehicle's clock decreases. Only after a
        jump of the vehicle's clock, e.g. a reboot, may they decrease.
        """
        if t + ahead <= self._last_time and self._sync.jumps == self._jumps:
            ahead = self._last_time + 1 - t
        self._last_time, self._jumps = t + ahead, self._sync.jumps
        for packet in self._end.command_packets(self._endpoint, ahead):
            self._link.send(packet)
