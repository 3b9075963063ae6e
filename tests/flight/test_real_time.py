"""Statistics of deadlines, from given times."""

import gc
import os

import pytest

from trimtab.core.time import ms
from trimtab.flight.real_time import NS, Deadlines, real_time


class HandClock:
    """A clock that a test sets: monotonic time, and processor time of the thread."""

    def __init__(self):
        self.now = self.busy = 0

    def monotonic_ns(self):
        return self.now

    def thread_ns(self):
        return self.busy


def test_overruns_are_attributed_to_their_cause():
    """Each period wakes `late` periods late and takes `work` periods, of which the thread is busy for `busy`."""
    clock = HandClock()
    kept = Deadlines(ms(1), clock)
    period = ms(1) * NS

    def done(late, work, busy):
        clock.now = now = clock.now + 100 * period
        kept.start = now - round((late + work) * period) - 10 * period
        clock.busy += round(busy * period)
        woke = now - round(work * period)
        return kept.record_period(10, woke, woke + 100, woke + 700)

    causes = []
    for late, work, busy in (
        (0.0, 0.2, 0.2),
        (2.0, 0.1, 0.1),  # woken two periods late
        (1.2, 0.1, 0.1),  # making up for it
        (0.0, 0.1, 0.1),
        (0.0, 2.5, 2.5),  # its own work took too long
        (1.5, 0.1, 0.1),  # making up for that
        (0.0, 0.1, 0.1),
        (0.0, 2.5, 0.3),  # the system took the processor away in the middle
        (0.0, 0.1, 0.1),
    ):
        before = kept.own, kept.scheduler
        over = done(late, work, busy)
        causes.append((over, kept.own - before[0], kept.scheduler - before[1]))
    in_time, slow, waited = (False, 0, 0), (True, 1, 0), (True, 0, 1)
    assert causes == [in_time, waited, waited, in_time, slow, slow, in_time, waited, in_time]
    assert kept.summary()["overruns"] == {"own_work": 2, "scheduler": 3}
    assert kept.step.summary().n == 9


def test_deadlines_do_not_drift():
    clock = HandClock()
    kept = Deadlines(ms(1), clock)
    clock.now = 12_345
    assert kept.remaining(1000) == pytest.approx(1.0 - 12_345e-9, abs=1e-12)
    assert kept.remaining(500) == pytest.approx(0.5 - 12_345e-9, abs=1e-12)


@pytest.mark.parametrize(("late", "passed"), [(0.499, 0), (0.5, 500), (1.2345, 1234)])
def test_stalled_loop_skips_missed_periods(late, passed):
    clock = HandClock()
    kept = Deadlines(ms(1), clock)
    clock.now = round((0.01 + late) * 1e9)
    assert kept.count_passed(10) == (passed, round(late * 1e7))


@pytest.mark.real_time
def test_scheduler_and_garbage_collector_are_restored():
    before = os.sched_getscheduler(0)
    with real_time(False) as granted:
        assert granted == ("ordinary", False)
        assert not gc.isenabled()
    assert gc.isenabled()
    with real_time() as granted:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == (granted.scheduler == "fifo")
        assert granted.scheduler in str(granted)
    assert os.sched_getscheduler(0) == before
