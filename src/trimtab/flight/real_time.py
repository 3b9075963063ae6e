"""Real-time loops on an ordinary computer: absolute deadlines, real-time priority, and statistics of delays and
overruns.

Deadline k is at start + k * period, even after delays, so delays do not accumulate. A period whose work ended after the
next deadline is an overrun. The loop itself is the cause if its thread used the processor for longer than a period.
Otherwise the system's scheduler is the cause. After an overrun the loop catches up without waiting. The late periods
until then have the cause of the overrun.

Each measured time is counted in a histogram of fixed size. Counting takes a few hundred nanoseconds and allocates no
memory.
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
"""Number of nanoseconds in the unit of integer times (100 ns)."""
MOST_PACKETS = 64
"""Maximum number of packets read after the start time of an instant has passed, so that a flood of packets cannot stop
the loop."""
DISCARD_LIMIT = 10_000
"""Maximum number of packets that `discard_packets` removes."""
LONGEST_DELAY = seconds("0.5")
"""Smallest delay (100 ns) of a loop at which the loop skips periods. With a smaller delay, the loop catches up."""
SUB_BUCKET_BITS = 5
"""Base-2 logarithm of the number of histogram buckets per doubling of the time. The width of a bucket is at most 3 % of
the time."""
BUCKETS = (64 - SUB_BUCKET_BITS) << SUB_BUCKET_BITS
FIRST_DOUBLING, LAST_DOUBLING = 10, 30
"""First and last edge of the coarse histogram, as exponents of two (2^10 ns = 1 us, 2^30 ns = 1 s)."""
PRIORITY = 40
MCL_CURRENT_AND_FUTURE = 3


class WallClock:
    """Clock that returns the integer time (100 ns) since it was made or restarted."""

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self._clock, self.start = clock, clock.monotonic_ns()

    def restart(self) -> None:
        """Restart the clock: the time is zero now."""
        self.start = self._clock.monotonic_ns()

    def now(self) -> int:
        """Return the time since the clock was made or restarted, in units of 100 ns."""
        return (self._clock.monotonic_ns() - self.start) // NS

    def wait(self, t: int, link: Link, hear: Callable[[bytes], None]) -> int:
        """Handle packets until integer time t. Read the link at least once. After t, read at most MOST_PACKETS waiting
        packets.

        Return the monotonic time (ns) at the end.
        """
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
    """Discard the packets that arrived before this call and were not read. Return the number of these packets."""
    count = 0
    while count < DISCARD_LIMIT and link.receive(0.0) is not None:
        count += 1
    return count


class TimeSummary(NamedTuple):
    """Summary of measured times (s): number, quantiles and longest time. A quantile is the upper end of a histogram
    bucket."""

    n: int
    p50: float
    p99: float
    p999: float
    longest: float


class Histogram:
    """Histogram of measured times, which are added in ns."""

    def __init__(self) -> None:
        self.counts = [0] * BUCKETS
        self.longest = 0

    def add(self, ns: int) -> None:
        """Add a time to the histogram. A negative time counts as 0."""
        ns = max(ns, 0)
        self.longest = max(self.longest, ns)
        shift = max(ns.bit_length() - SUB_BUCKET_BITS - 1, 0)
        self.counts[min((shift << SUB_BUCKET_BITS) + (ns >> shift), BUCKETS - 1)] += 1

    def quantile(self, share: float) -> float:
        """Return a quantile (s): the time that the given share of all times does not exceed, or 0 before the first
        time."""
        rank, below = share * sum(self.counts), 0
        for bucket, count in enumerate(self.counts):
            below += count
            if count and below >= rank:
                return min(bucket_end(bucket), self.longest) * 1e-9
        return 0.0

    def count_doublings(self) -> tuple[list[float], list[int]]:
        """Return the edges (s) and counts of bins whose width doubles, from 1 us to 1 s. The last bin also counts all
        longer times."""
        first, last = FIRST_DOUBLING, LAST_DOUBLING
        starts = [(k + 1 - SUB_BUCKET_BITS) << SUB_BUCKET_BITS for k in range(first, last + 1)]
        bounds = [0, *starts[:-1], BUCKETS]
        counts = [sum(self.counts[a:b]) for a, b in itertools.pairwise(bounds)]
        return [0.0, *(2**k * 1e-9 for k in range(first, last + 1))], counts

    def summary(self) -> TimeSummary:
        """Return the number of measured times, their median and high quantiles, and the longest time."""
        tails = [self.quantile(share) for share in (0.5, 0.99, 0.999)]
        return TimeSummary(sum(self.counts), tails[0], tails[1], tails[2], self.longest * 1e-9)


def bucket_end(bucket: int) -> int:
    """Return the longest time (ns) that is counted in the bucket with this index."""
    shift = max((bucket >> SUB_BUCKET_BITS) - 1, 0)
    return ((bucket - (shift << SUB_BUCKET_BITS) + 1) << shift) - 1


class RealTimeGrant(NamedTuple):
    """Real-time rights granted by the system: scheduler "fifo" or "ordinary", and True if the memory is locked."""

    scheduler: str
    locked: bool

    def __str__(self) -> str:
        lock = "memory locked" if self.locked else "memory not locked"
        return f"{self.scheduler} scheduling, {lock}"


@contextlib.contextmanager
def real_time(is_wanted: bool = True) -> Iterator[RealTimeGrant]:
    """Give this process real-time priority and lock its memory, if the system allows it, within this context.

    Python's garbage collector is switched off, because the loop makes no reference cycles and a collection takes
    milliseconds.
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
    """Deadlines at a fixed period from now on, with statistics of delays, work and overruns."""

    def __init__(self, period: int, clock: Clock = SYSTEM_CLOCK) -> None:
        """Start now. clock: clock of this process. Its processor time distinguishes the process's own work from
        waiting."""
        self.period, self._clock = period, clock
        self._before, self._over, self._blamed = clock.thread_ns(), False, False
        self.start = clock.monotonic_ns()
        self.late, self.step, self.work = Histogram(), Histogram(), Histogram()
        self.own = self.scheduler = 0

    def remaining(self, k: int) -> float:
        """Return the time (s) until deadline k. The time is negative if the deadline has passed."""
        return (self.start + k * self.period * NS - self._clock.monotonic_ns()) * 1e-9

    def count_passed(self, k: int) -> tuple[int, int]:
        """Return the number of periods to skip before period k, and the delay of period k (100 ns).

        No period is skipped while the delay is below LONGEST_DELAY.
        """
        behind = -round(self.remaining(k) * UNITS_PER_SECOND)
        return (behind // self.period if behind >= LONGEST_DELAY else 0), behind

    def record_period(self, k: int, woke: int, began: int, stepped: int) -> bool:
        """Record the monotonic times (ns) of period k: wake-up, start and end of the compiled step. Return True if the
        period overran."""
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
        """Return all statistics for a report, times in seconds."""
        return {
            "period": format_time(self.period),
            "late": self.late.summary()._asdict(),
            "step": self.step.summary()._asdict(),
            "work": self.work.summary()._asdict(),
            "overruns": {"own_work": self.own, "scheduler": self.scheduler},
        }
