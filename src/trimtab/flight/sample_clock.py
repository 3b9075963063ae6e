"""Clock of a vehicle's samples, as known at the autopilot's end.

Source: docs page, Fly.
"""

from trimtab.core.clock import Clock
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.flight.mavlink.time_sync import TimeSync
from trimtab.flight.real_time import NS
from trimtab.flight.reporter import Reporter

LONGEST_SAMPLE_AGE, MOST_SAMPLE_LEAD = seconds(2), ms(200)
"""Largest age and largest lead of a sample. A sample beyond these limits is rejected: it comes from another clock.

A sample cannot be newer than its arrival. An apparent lead is an error of the clock offset, at most half a round trip.
"""
REPORT_PERIOD = seconds(10)
"""Shortest time between two reports of rejected samples."""


class SampleClock:
    """Times of samples by the clocks of both ends."""

    def __init__(self, sync: TimeSync, clock: Clock, reporter: Reporter) -> None:
        """Start at time zero.

        Args:
            sync: offset of the vehicle's clock.
            clock: clock of this end.
            reporter: receives the messages on rejected samples, while a log is written.
        """
        self._sync, self._clock, self._reporter = sync, clock, reporter
        self._start = self._report_time = 0

    def start_loop(self, start: int) -> None:
        """Set time zero of the loop to a time of the monotonic clock (ns)."""
        self._start = start // NS

    def to_local(self, t: int) -> int:
        """Return a time of the vehicle's clock as a time of the loop."""
        return self._sync.to_local(t) - self._start

    def accepts(self, t: int) -> bool:
        """Return whether a sample with this vehicle time is recent enough."""
        now = self._clock.monotonic_ns() // NS
        lead = self._sync.show_local(t) - now
        is_recent = -LONGEST_SAMPLE_AGE <= lead <= MOST_SAMPLE_LEAD
        if self._reporter.has_log and not is_recent and now >= self._report_time:
            self._report_time = now + REPORT_PERIOD
            why = "the clocks differ" if lead > 0 else "the clocks differ, or the sample was delayed that long"
            self._reporter.report(f"sample rejected: its time is {to_seconds(lead):+.3f} s from now, {why}")
        return is_recent
