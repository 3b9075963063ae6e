"""Waiting for instants while packets come."""

from trimtab.flight.real_time import MOST_PACKETS, NS, WallClock


class Line:
    """A link that delivers a number of packets, one per call, and its clock."""

    def __init__(self, packets, step=0):
        self.left, self.waited, self.now, self._step = packets, [], 5_000, step

    def monotonic_ns(self):
        return self.now

    def receive(self, timeout):
        self.waited.append(timeout)
        self.left -= 1
        self.now += self._step if self.left >= 0 else round(timeout * 1e9)
        return b"." if self.left >= 0 else None


def test_wait_handles_all_packets_and_is_never_early():
    line, heard = Line(500, step=1_000), []
    clock = WallClock(line)
    due = clock.now() + 200_000
    woke = clock.wait(due, line, heard.append)
    assert woke == clock.start + due * NS
    assert len(heard) == 500
    assert line.waited[0] == 0.02
    assert line.waited[-1] == 0.0


def test_packet_flood_does_not_stop_the_clock():
    line, heard = Line(10_000), []
    clock = WallClock(line)
    clock.wait(clock.now() - 1, line, heard.append)
    assert MOST_PACKETS <= len(heard) <= MOST_PACKETS + 1
    assert set(line.waited) == {0.0}
    quiet = Line(0)
    clock.wait(clock.now() - 1, quiet, heard.append)
    assert quiet.waited == [0.0]


def test_now_is_counted_from_the_start_in_units_of_100_ns():
    line = Line(0)
    clock = WallClock(line)
    assert (clock.start, clock.now()) == (5_000, 0)
    line.now += 1_234_567
    assert clock.now() == 12_345
