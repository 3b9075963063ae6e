"""Reporter of a live vehicle or autopilot: each message is passed to the user and written into the log of the flight.

Source: docs pages, Fly and Vehicle.
"""

from collections.abc import Callable

from trimtab.flight.flight_log import FlightRecorder


class Reporter:
    """Distributor of messages. The parts of a live vehicle or autopilot use this object to report to the user and to
    the log."""

    def __init__(self) -> None:
        """Start without receivers: messages are lost until `begin` is called."""
        self._tells: tuple[Callable[[str], None], ...] = ()
        self._log: FlightRecorder | None = None

    def begin(self, log: FlightRecorder | None, *tells: Callable[[str], None]) -> None:
        """Send messages to these receivers from now on.

        log: log of the flight, or None.  tells: functions that are called with each message. They must not block.
        """
        self._tells, self._log = tells, log

    def end_log(self) -> None:
        """Stop reporting to the log, which is about to be closed."""
        self._log = None

    @property
    def has_log(self) -> bool:
        """True while messages are logged."""
        return self._log is not None

    def log(self, text: str) -> None:
        """Write a message into the log only."""
        if self._log is not None:
            self._log.write_event(text)

    def report(self, text: str) -> None:
        """Report a message to all receivers."""
        for tell in self._tells:
            tell(text)
        self.log(text)
