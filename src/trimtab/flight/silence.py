"""Detector of silence on a link, that is, of a period without data. The detector reports start and end of each
silence."""

from trimtab.core.time import ms, to_seconds
from trimtab.flight.mavlink.endpoint import FrameCounts

SILENCE = ms(250)
"""Time (100 ns) without data after which silence is reported."""
SHORT_SILENCE = ms(100)
"""Longest time (100 ns) without data for which the link still counts as receiving data."""


class SilenceWatch:
    """Detector of silence (missing data) at one end of a link. Times `now` are by the clock of this end, in 100 ns."""

    def __init__(self, counts: FrameCounts, now: int = 0) -> None:
        """counts: frame counters of the receiving end."""
        self._counts, self._accepted, self._heard_time = counts, 0, now
        self.is_silent = False
        """True from the report of a silence until data arrives again."""

    def restart(self, now: int) -> None:
        """Restart the measurement of the time without data, now."""
        self._heard_time = now

    def length(self, now: int) -> int:
        """Return the time (100 ns) since `update` last found a new frame."""
        return now - self._heard_time

    def is_heard(self, now: int) -> bool:
        """Return True if a frame has arrived since the last call of `update` or at most SHORT_SILENCE ago."""
        return self._counts.accepted != self._accepted or self.length(now) < SHORT_SILENCE

    def update(self, now: int) -> str:
        """Check for new frames. Return a message when a silence starts or ends, otherwise an empty string."""
        length, news = self.length(now), ""
        if self._counts.accepted != self._accepted:
            if self.is_silent:
                news = f"data from the vehicle again after {to_seconds(length):.3f} s"
            self._accepted, self._heard_time, self.is_silent = self._counts.accepted, now, False
        elif length >= SILENCE and not self.is_silent:
            self.is_silent = True
            news = f"no data from the vehicle for {to_seconds(length):.3f} s"
        return news
