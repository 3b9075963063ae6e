"""Real time on an ordinary machine: absolute deadlines, what the system grants, and what became of each deadline.

A control period k ends at start + k * period, whatever happened before: lateness never adds up. A period whose work
ended after the next deadline is an overrun. Where the thread itself was on the processor for longer than a period it is
put down to its own work, else to the scheduler; periods that are made up afterwards, without a wait, to what the first
one was put down to.

Times are counted as they come, in a fixed table: a few hundred nanoseconds each, nothing allocated.
Source: G. Tene, HdrHistogram (buckets of constant relative width); docs page, Vehicle.
"""

import contextlib
import ctypes
import gc
import itertools
import os
from collections.abc import Callable, Iterator
from typing import NamedTuple

from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.core.time import UNITS_PER_SECOND, format_time, seconds

NS = 100
"""Nanoseconds in a unit of time."""
MOST_PACKETS = 64
"""Packets taken at one instant, so that a flood can't stop the clock."""
DISCARD_LIMIT = 10_000
"""Packets thrown away at most."""
LONGEST_DELAY = seconds("0.5")
"""A loop that is late by less than this catches up. A loop that is later skips periods."""
SUB_BUCKET_BITS = 5
"""Each doubling is cut into 2**SUB_BUCKET_BITS buckets: 3 % wide."""
BUCKETS = (64 - SUB_BUCKET_BITS) << SUB_BUCKET_BITS
FIRST_DOUBLING, LAST_DOUBLING = 10, 30
"""Powers of two (ns) between which a coarse count has its edges."""
PRIORITY = 40
MCL_CURRENT_AND_FUTURE = 3


class WallClock:
    """Integer time (100 ns) since it was made."""

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self._clock, self.start = clock, clock.monotonic_ns()

    def now(self) -> int:
        """Now."""
        return (self._clock.monotonic_ns() - self.start) // NS

    def wait(self, t: int, link: Link, hear: Callable[[bytes], None]) -> int:
        """Take what comes until integer time t, at least once and at most MOST_PACKETS late; returns now (ns)."""
        due = self.start + t * NS
        late = 0
        while True:
            left = (due - self._clock.monotonic_ns()) * 1e-9
            data = link.receive(max(left, 0.0))
            if data is not None:
                hear(data)
            late += left <= 0
            if (left <= 0 and data is None) or late > MOST_PACKETS:
                return self._clock.monotonic_ns()


def discard_packets(link: Link) -> int:
    """Throw away what lies waiting, of a time when nobody looked; returns how many packets."""
    count = 0
    while count < DISCARD_LIMIT and link.receive(0.0) is not None:
        count += 1
    return count


class TimeSummary(NamedTuple):
    """Times in seconds; a quantile is the upper end of its bucket."""

    n: int
    p50: float
    p99: float
    p999: float
    longest: float


class Histogram:
    """Counts of times, given in ns."""

    def __init__(self) -> None:
        self.counts = [0] * BUCKETS
        self.longest = 0

    def add(self, ns: int) -> None:
        """Count one; below 0 counts as 0."""
        ns = max(ns, 0)
        self.longest = max(self.longest, ns)
        shift = max(ns.bit_length() - SUB_BUCKET_BITS - 1, 0)
        self.counts[min((shift << SUB_BUCKET_BITS) + (ns >> shift), BUCKETS - 1)] += 1

    def quantile(self, share: float) -> float:
        """The time (s) that this share of all does not exceed; 0 when there is none."""
        rank, below = share * sum(self.counts), 0
        for bucket, count in enumerate(self.counts):
            below += count
            if count and below >= rank:
                return min(bucket_end(bucket), self.longest) * 1e-9
        return 0.0

    def count_doublings(self) -> tuple[list[float], list[int]]:
        """Counts in bins that double, from 1 us to 1 s: their edges (s), one more; longer is in the last."""
        first, last = FIRST_DOUBLING, LAST_DOUBLING
        starts = [(k + 1 - SUB_BUCKET_BITS) << SUB_BUCKET_BITS for k in range(first, last + 1)]
        bounds = [0, *starts[:-1], BUCKETS]
        counts = [sum(self.counts[a:b]) for a, b in itertools.pairwise(bounds)]
        return [0.0, *(2**k * 1e-9 for k in range(first, last + 1))], counts

    def summary(self) -> TimeSummary:
        """Count, median, tails."""
        tails = [self.quantile(share) for share in (0.5, 0.99, 0.999)]
        return TimeSummary(sum(self.counts), tails[0], tails[1], tails[2], self.longest * 1e-9)


def bucket_end(bucket: int) -> int:
    """The longest time (ns) that falls into a bucket."""
    shift = max((bucket >> SUB_BUCKET_BITS) - 1, 0)
    return ((bucket - (shift << SUB_BUCKET_BITS) + 1) << shift) - 1


class RealTimeGrant(NamedTuple):
    """What the system granted: scheduler "fifo" or "ordinary", memory locked or not."""

    scheduler: str
    locked: bool

    def __str__(self) -> str:
        lock = "memory locked" if self.locked else "memory not locked"
        return f"{self.scheduler} scheduling, {lock}"


@contextlib.contextmanager
def real_time(is_wanted: bool = True) -> Iterator[RealTimeGrant]:
    """Within it this process is scheduled before ordinary ones and stays in memory, where that is allowed.

    The collector of cycles rests: the loop makes none, and a collection takes milliseconds.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    scheduler, locked = "ordinary", False
    gc.collect()
    gc.disable()
    libc = ctypes.CDLL(None, use_errno=True)
    if is_wanted:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            scheduler = "fifo"
        locked = libc.mlockall(MCL_CURRENT_AND_FUTURE) == 0
    try:
        yield RealTimeGrant(scheduler, locked)
    finally:
        gc.enable()
        if locked:
            libc.munlockall()
        if scheduler == "fifo":
            os.sched_setscheduler(0, *before)


class Deadlines:
    """Deadlines at a fixed period from now on, and how they were kept.

    late: from deadline to wake-up.  step: the compiled step alone.  work: from wake-up to the end of the period's work.
    """

    def __init__(self, period: int, clock: Clock = SYSTEM_CLOCK) -> None:
        """Begin now. clock: clock of this process; its processor time tells own work from waiting for a processor."""
        self.period, self._clock = period, clock
        self._before, self._over, self._blamed = clock.thread_ns(), False, False
        self.start = clock.monotonic_ns()
        self.late, self.step, self.work = Histogram(), Histogram(), Histogram()
        self.own = self.scheduler = 0

    def remaining(self, k: int) -> float:
        """Seconds until deadline k; negative when it has passed."""
        return (self.start + k * self.period * NS - self._clock.monotonic_ns()) * 1e-9

    def count_passed(self, k: int) -> tuple[int, int]:
        """Return the number of periods to skip before period k, and the delay of period k (100 ns).

        No period is skipped while the delay is below LONGEST_DELAY.
        """
        behind = -round(self.remaining(k) * UNITS_PER_SECOND)
        return (behind // self.period if behind >= LONGEST_DELAY else 0), behind

    def record_period(self, k: int, woke: int, began: int, stepped: int) -> bool:
        """Account for period k: when it woke, and when the step began and ended (ns). Returns whether it overran."""
        deadline = self.start + k * self.period * NS
        ended = self._clock.monotonic_ns()
        self.late.add(woke - deadline)
        self.step.add(stepped - began)
        self.work.add(ended - woke)
        spent = self._clock.thread_ns()
        busy, self._before = spent - self._before, spent
        over = ended - deadline > self.period * NS
        if over and not self._over:
            self._blamed = busy > self.period * NS
        elif over:
            self._blamed = self._blamed or busy > self.period * NS
        self._over = over
        self.own += over and self._blamed
        self.scheduler += over and not self._blamed
        return over

    def summary(self) -> dict[str, object]:
        """All of it, times in seconds, for a report."""
        return {
            "period": format_time(self.period),
            "late": self.late.summary()._asdict(),
            "step": self.step.summary()._asdict(),
            "work": self.work.summary()._asdict(),
            "overruns": {"own_work": self.own, "scheduler": self.scheduler},
        }
