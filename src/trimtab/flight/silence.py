"""Watch for silence on a link, and report when it starts and ends."""

from trimtab.core.time import ms, to_seconds
from trimtab.flight.mavlink.endpoint import FrameCounts

SILENCE = ms(250)
"""Time without data after which silence is reported."""
SHORT_SILENCE = ms(100)
"""Time without data up to which the vehicle still counts as received."""


class SilenceWatch:
    """Silence on one end of a link. Times `now` are that end's, in 100 ns."""

    def __init__(self, counts: FrameCounts, now: int = 0) -> None:
        """counts: frame counters of the receiving end."""
        self._counts, self._accepted, self._heard_time = counts, 0, now
        self.is_silent = False
        """True once silence has been reported and has not ended."""

    def restart(self, now: int) -> None:
        """Restart the measurement of silence now."""
        self._heard_time = now

    def length(self, now: int) -> int:
        """Return the time since the last frame that `update` noted."""
        return now - self._heard_time

    def is_heard(self, now: int) -> bool:
        """Return whether a frame arrived since the last `update`, or shortly before it."""
        return self._counts.accepted != self._accepted or self.length(now) < SHORT_SILENCE

    def update(self, now: int) -> str:
        """Look for new frames. Return a message when silence starts or ends, otherwise an empty string."""
        length, news = self.length(now), ""
        if self._counts.accepted != self._accepted:
            if self.is_silent:
                news = f"data from the vehicle again after {to_seconds(length):.3f} s"
            self._accepted, self._heard_time, self.is_silent = self._counts.accepted, now, False
        elif length >= SILENCE and not self.is_silent:
            self.is_silent = True
            news = f"no data from the vehicle for {to_seconds(length):.3f} s"
        return news
