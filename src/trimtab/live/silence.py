"""How long nothing has been heard, and when that is said."""

from trimtab.core.time import ms, to_seconds
from trimtab.wire.mavlink import FrameCounts

SILENCE = ms(250)
"""After which it is said that nothing comes."""
SHORT_SILENCE = ms(100)
"""A vehicle that was heard so lately is heard."""


class SilenceWatch:
    """Watches the frames of an end; times `now` are that end's, in 100 ns."""

    def __init__(self, counts: FrameCounts, now: int = 0) -> None:
        """counts: of the end that hears."""
        self._counts, self._accepted, self._heard_time = counts, 0, now
        self.is_silent = False
        """Whether it was said that nothing comes."""

    def restart(self, now: int) -> None:
        """Count from now on."""
        self._heard_time = now

    def length(self, now: int) -> int:
        """Time since it was last noted that a frame came."""
        return now - self._heard_time

    def is_heard(self, now: int) -> bool:
        """Whether something came since `update`, or shortly before."""
        return self._counts.accepted != self._accepted or self.length(now) < SHORT_SILENCE

    def update(self, now: int) -> str:
        """Note what came; a line for people where silence begins or ends, else nothing."""
        length, news = self.length(now), ""
        if self._counts.accepted != self._accepted:
            if self.is_silent:
                news = f"the vehicle is heard again, after {to_seconds(length):.3f} s"
            self._accepted, self._heard_time, self.is_silent = self._counts.accepted, now, False
        elif length >= SILENCE and not self.is_silent:
            self.is_silent = True
            news = f"nothing from the vehicle for {to_seconds(length):.3f} s"
        return news
