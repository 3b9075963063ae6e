"""Real time on an ordinary machine: absolute deadlines, what the system grants, and what became of each deadline.

A control period k ends at start + k * period, whatever happened before: lateness never adds up. A period whose work
ended after the next deadline is an overrun. Where the thread itself was on the processor for longer than a period it is
put down to its own work, else to the scheduler; periods that are made up afterwards, without a wait, to what the first
one was put down to.
"""

import contextlib
import ctypes
import gc
import os
from collections.abc import Callable, Iterator
from time import monotonic_ns, thread_time_ns
from typing import NamedTuple

from trimtab.core.time import show
from trimtab.live.histogram import Histogram

NS = 100
"""Nanoseconds in a unit of time."""
PRIORITY = 40
MCL_CURRENT_AND_FUTURE = 3


class Granted(NamedTuple):
    """What the system granted: scheduler "fifo" or "ordinary", memory locked or not."""

    scheduler: str
    locked: bool

    def __str__(self) -> str:
        lock = "memory locked" if self.locked else "memory not locked"
        return f"{self.scheduler} scheduling, {lock}"


@contextlib.contextmanager
def real_time(wanted: bool = True) -> Iterator[Granted]:
    """Within it this process is scheduled before ordinary ones and stays in memory, where that is allowed.

    The collector of cycles rests: the loop makes none, and a collection takes milliseconds.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    scheduler, locked = "ordinary", False
    gc.collect()
    gc.disable()
    libc = ctypes.CDLL(None, use_errno=True)
    if wanted:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            scheduler = "fifo"
        locked = libc.mlockall(MCL_CURRENT_AND_FUTURE) == 0
    try:
        yield Granted(scheduler, locked)
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

    def __init__(self, period: int, spent: Callable[[], int] = thread_time_ns) -> None:
        """Begin now. spent: processor time of this thread (ns)."""
        self.period, self._spent = period, spent
        self._before, self._over, self._blamed = spent(), False, False
        self.start = monotonic_ns()
        self.late, self.step, self.work = Histogram(), Histogram(), Histogram()
        self.own = self.scheduler = self.skipped = 0

    def remaining(self, k: int) -> float:
        """Seconds until deadline k; negative when it has passed."""
        return (self.start + k * self.period * NS - monotonic_ns()) * 1e-9

    def done(self, k: int, woke: int, began: int, stepped: int) -> bool:
        """Account for period k: when it woke, and when the step began and ended (ns). Returns whether it overran."""
        deadline = self.start + k * self.period * NS
        ended = monotonic_ns()
        self.late.add(woke - deadline)
        self.step.add(stepped - began)
        self.work.add(ended - woke)
        spent = self._spent()
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
        tables = {name: getattr(self, name).summary()._asdict() for name in ("late", "step", "work")}
        overruns = {"own_work": self.own, "scheduler": self.scheduler}
        return {"period": show(self.period), **tables, "overruns": overruns}
