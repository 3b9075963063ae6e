"""Announcer of a vehicle: lines for ground stations, for the user and for the vehicle's log.

Source: docs page, Vehicle.
"""

from trimtab.flight.mavlink.protocol import Severity
from trimtab.flight.reporter import Reporter
from trimtab.flight.station.standard_services import Station


class Announcer:
    """Sender of lines to ground stations, the user and the log."""

    def __init__(self, station: Station, reporter: Reporter) -> None:
        """station: sends lines to ground stations.  reporter: sends lines to the user and to the log."""
        self._station, self._reporter = station, reporter

    def announce(self, severity: Severity, text: str) -> None:
        """Report a line to ground stations, the log and the user."""
        self._station.queue_text(severity, text)
        self._reporter.report(text)

    def notice(self, text: str) -> None:
        """Announce an event."""
        self.announce(Severity.NOTICE, text)

    def warn(self, text: str) -> None:
        """Announce a warning."""
        self.announce(Severity.WARNING, text)
