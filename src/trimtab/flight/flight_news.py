"""Reports of events in a flight: sensors with decreasing time stamps, decisions of the supervisor, violated formulas of
the monitor.

Source: docs pages, Fly and Supervisor.
"""

from trimtab.flight.autopilot_parts import AutopilotParts
from trimtab.flight.silence import SilenceWatch
from trimtab.flight.supervised import explain_change


class FlightNews:
    """Reporter of events in a flight. Each event is reported once."""

    def __init__(self, parts: AutopilotParts, silence: SilenceWatch) -> None:
        """Start with nothing reported. silence: detector of missing data from the vehicle."""
        self._parts, self._silence = parts, silence
        self._backward_sensors: list[str] = []

    def report(self, now: int, was_armed: bool) -> None:
        """Report the changes since the last call, and pass requests of ground stations on to the supervisor."""
        parts = self._parts
        sensors = parts.autopilot_end.backward_sensors
        for sensor in sensors if sensors != self._backward_sensors else ():
            parts.reporter.report(f"{sensor}: time stamps run backwards, samples rejected")
        self._backward_sensors = sensors
        self._report_supervisor(now, was_armed)
        for news in parts.autopilot_end.monitored.describe_changes():
            parts.reporter.report(news)

    def _report_supervisor(self, now: int, was_armed: bool) -> None:
        remote, supervised = self._parts.remote, self._parts.supervised
        remote.requests.mode = supervised.mode
        if remote.requests.pending:
            supervised.request(remote.requests.pending.popleft())
        news = supervised.describe_changes()
        if news:
            silent = self._backward_sensors if self._silence.is_heard(now) else None
            self._parts.reporter.report(f"{news}{explain_change(supervised, remote, silent, was_armed)}")
