"""Instants in wall-clock time, and what comes over a line until each of them.

Source: docs page, Vehicle.
"""

from collections.abc import Callable
from time import monotonic_ns

from trimtab.core.interfaces import Link

NS = 100
"""Nanoseconds in a unit of time."""
MOST = 64
"""Packets taken at one instant, so that a flood can't stop the clock."""

QUEUE = 10_000
"""Packets thrown away at most."""


class WallClock:
    """Integer time (100 ns) since it was made."""

    def __init__(self) -> None:
        self.start = monotonic_ns()

    def now(self) -> int:
        """Now."""
        return (monotonic_ns() - self.start) // NS

    def wait(self, t: int, link: Link, hear: Callable[[bytes], None]) -> int:
        """Take what comes until integer time t, at least once and at most MOST packets late; returns now (ns)."""
        due = self.start + t * NS
        late = 0
        while True:
            left = (due - monotonic_ns()) * 1e-9
            data = link.receive(max(left, 0.0))
            if data is not None:
                hear(data)
            late += left <= 0
            if (left <= 0 and data is None) or late > MOST:
                return monotonic_ns()


def discard(link: Link) -> int:
    """Throw away what lies waiting, of a time when nobody looked; returns how many packets."""
    found = 0
    while found < QUEUE and link.receive(0.0) is not None:
        found += 1
    return found
