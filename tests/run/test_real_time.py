"""What became of the deadlines, told from the times given."""

import gc
import os
from time import monotonic_ns

from trimtab.core.time import ms
from trimtab.run.real_time import NS, Deadlines, real_time


def test_overruns_are_put_down_to_their_cause():
    kept = Deadlines(ms(1))
    period = ms(1) * NS
    now = monotonic_ns()
    kept.start = now - 10 * period  # deadline 10 is now
    assert not kept.done(10, now + 100, now + 200, now + 700)
    assert (kept.own, kept.scheduler) == (0, 0)
    assert kept.done(8, now - 1000, now - 900, now - 100)  # woke two periods late, worked a microsecond
    assert (kept.own, kept.scheduler) == (0, 1)
    assert kept.done(7, now - 2 * period, now - 2 * period, now)  # worked for two periods
    assert (kept.own, kept.scheduler) == (1, 1)
    assert kept.summary()["overruns"] == {"own_work": 1, "scheduler": 1}
    assert kept.step.summary().n == 3


def test_deadlines_do_not_drift():
    kept = Deadlines(ms(1))
    assert abs(kept.remaining(1000) - kept.remaining(500) - 0.5) < 0.05


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
