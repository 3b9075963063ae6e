"""Conversion of the times of a vehicle's samples to the autopilot's clock, and rejection of samples with implausible
times.

Source: docs page, Fly.
"""

from trimtab.core.clock import Clock
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.flight.mavlink.time_sync import TimeSync
from trimtab.flight.real_time import NS
from trimtab.flight.reporter import Reporter

LONGEST_SAMPLE_AGE, MOST_SAMPLE_LEAD = seconds(2), ms(200)
"""Largest accepted age of a sample, and largest accepted lead of its time stamp. Outside these limits, the clock of the
sample is wrong, and the sample is rejected.

No sample is measured after it arrives. So an apparent lead is an error of the estimated clock offset, which is at most
half a round-trip time.
"""
REPORT_PERIOD = seconds(10)
"""Shortest time between two reports of rejected samples."""


class SampleClock:
    """Converter of sample times from the vehicle's clock to the time of the control loop."""

    def __init__(self, sync: TimeSync, clock: Clock, reporter: Reporter) -> None:
        """Start at time zero.

        Args:
            sync: estimator of the vehicle's clock.
            clock: clock of the autopilot's computer.
            reporter: receiver of the messages on rejected samples. They are reported only while a log is written.
        """
        self._sync, self._clock, self._reporter = sync, clock, reporter
        self._start = self._report_time = 0

    def start_loop(self, start: int) -> None:
        """Set the loop's time zero to `start`, a time of the monotonic clock (ns)."""
        self._start = start // NS

    def to_local(self, t: int) -> int:
        """Convert a time of the vehicle's clock to the time of the control loop."""
        return self._sync.to_local(t) - self._start

    def accepts(self, t: int) -> bool:
        """Return True if a sample measured at time t of the vehicle's clock is neither too old nor too far in the
        future."""
        now = self._clock.monotonic_ns() // NS
        lead = self._sync.show_local(t) - now
        is_recent = -LONGEST_SAMPLE_AGE <= lead <= MOST_SAMPLE_LEAD
        if self._reporter.has_log and not is_recent and now >= self._report_time:
            self._report_time = now + REPORT_PERIOD
            why = "the clocks differ" if lead > 0 else "the clocks differ, or the sample was delayed that long"
            self._reporter.report(f"sample rejected: its time is {to_seconds(lead):+.3f} s from now, {why}")
        return is_recent
