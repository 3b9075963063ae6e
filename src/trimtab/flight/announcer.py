"""Announcer of a vehicle: it sends lines of text to ground stations, to the user and to the vehicle's log.

Source: docs page, Vehicle.
"""

from trimtab.flight.mavlink.protocol import Severity
from trimtab.flight.reporter import Reporter
from trimtab.flight.station.standard_services import Station


class Announcer:
    """Sender of lines of text to ground stations, the user and the log."""

    def __init__(self, station: Station, reporter: Reporter) -> None:
        """station: sender to ground stations.  reporter: sender to the user and to the log."""
        self._station, self._reporter = station, reporter

    def announce(self, severity: Severity, text: str) -> None:
        """Send a line of text to ground stations, the log and the user."""
        self._station.queue_text(severity, text)
        self._reporter.report(text)

    def notice(self, text: str) -> None:
        """Announce an event with severity NOTICE."""
        self.announce(Severity.NOTICE, text)

    def warn(self, text: str) -> None:
        """Announce a warning with severity WARNING."""
        self.announce(Severity.WARNING, text)
