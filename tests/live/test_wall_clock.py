"""Waiting for instants while packets come; judged by what was heard, and by bounds that a busy machine keeps."""

from time import monotonic_ns

import pytest

from trimtab.live.real_time import MOST_PACKETS, NS, WallClock

pytestmark = pytest.mark.real_time


class Packets:
    """A link with so many packets, one a call."""

    def __init__(self, n):
        self.left, self.waited = n, []

    def receive(self, timeout):
        self.waited.append(timeout)
        self.left -= 1
        return b"." if self.left >= 0 else None


def test_all_that_comes_before_an_instant_is_heard_and_the_instant_is_not_early():
    clock, link, heard = WallClock(), Packets(500), []
    due = clock.now() + 200_000
    woke = clock.wait(due, link, heard.append)
    assert woke >= clock.start + due * NS
    assert len(heard) == 500
    assert 0 < link.waited[0] <= 0.02
    assert link.waited[-1] == 0.0


def test_late_it_still_listens_but_a_flood_does_not_stop_the_clock():
    clock, link, heard = WallClock(), Packets(10_000), []
    clock.wait(clock.now() - 1, link, heard.append)
    assert MOST_PACKETS <= len(heard) <= MOST_PACKETS + 1
    assert set(link.waited) == {0.0}
    quiet = Packets(0)
    clock.wait(clock.now() - 1, quiet, heard.append)
    assert quiet.waited == [0.0]


def test_now_is_counted_from_its_making_in_units_of_100_ns():
    before = monotonic_ns()
    clock = WallClock()
    after = monotonic_ns()
    assert before <= clock.start <= after
    first = clock.now()
    assert 0 <= first <= (monotonic_ns() - before) // NS
    assert clock.now() >= first
