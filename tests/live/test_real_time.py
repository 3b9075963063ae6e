"""What became of the deadlines, told from the times given."""

import gc
import os
from time import monotonic_ns

import pytest

from trimtab.core.time import ms
from trimtab.live.real_time import NS, Deadlines, real_time


class Processor:
    """Processor time of the thread, as a test says."""

    def __init__(self):
        self.ns = 0

    def __call__(self):
        return self.ns


@pytest.mark.real_time
def test_overruns_are_put_down_to_their_cause():
    """Period k is said to have woken `late` and worked for `work` periods, of which the thread had `busy`."""
    processor = Processor()
    kept = Deadlines(ms(1), processor)
    period = ms(1) * NS

    def done(late, work, busy):
        now = monotonic_ns()
        kept.start = now - round((late + work) * period) - 10 * period
        processor.ns += round(busy * period)
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


@pytest.mark.real_time
def test_deadlines_do_not_drift():
    kept = Deadlines(ms(1))
    assert abs(kept.remaining(1000) - kept.remaining(500) - 0.5) < 0.05


@pytest.mark.real_time
def test_what_was_granted_is_given_back():
    before = os.sched_getscheduler(0)
    with real_time(False) as granted:
        assert granted == ("ordinary", False)
        assert not gc.isenabled()
    assert gc.isenabled()
    with real_time() as granted:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == (granted.scheduler == "fifo")
        assert granted.scheduler in str(granted)
    assert os.sched_getscheduler(0) == before
