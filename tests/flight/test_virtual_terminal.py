"""A hanging terminal blocks programs that write to it directly, but not those that use a queue."""

from trimtab.core.line_writer import CLOSE_S, ROOM
from trimtab.flight.virtual_terminal import VirtualTerminal
from trimtab.flight.virtual_time import VirtualTime


def start():
    time = VirtualTime(1)
    clock, written = time.adopt("user").clock, []
    terminal = VirtualTerminal(time)
    return time, clock, terminal, written, terminal.open_queue(written.append)


def test_queued_lines_keep_order_until_the_terminal_resumes():
    time, _, terminal, written, lines = start()
    lines.put("a")
    terminal.hangs = True
    lines.put("b")
    lines.put("c")
    assert (written, time.now) == (["a"], 0)
    terminal.hangs = False
    lines.put("d")
    assert written == ["a", "b", "c", "d"]
    assert lines.settle() == 0


def test_lines_that_do_not_fit_are_lost_and_counted():
    time, _, terminal, written, lines = start()
    terminal.hangs = True
    for k in range(ROOM + 3):
        lines.put(str(k))
    assert lines.lost_count == 3
    assert lines.settle() == ROOM + 3
    assert CLOSE_S <= time.seconds < CLOSE_S + 0.01
    terminal.hangs = False
    assert lines.settle() == 3
    assert written == [str(k) for k in range(ROOM)]


def test_settle_returns_when_the_terminal_resumes():
    time, _, terminal, written, lines = start()
    terminal.hangs = True
    lines.put("a")
    time.call_at(0.3, lambda: setattr(terminal, "hangs", False))
    assert lines.settle() == 0
    assert written == ["a"]
    assert 0.3 <= time.seconds < 0.31


def test_direct_write_blocks_while_the_terminal_hangs():
    time, clock, terminal, _, _ = start()
    times = []

    def write(own):
        terminal.wait_for_room()
        times.append(time.seconds)
        own.wait(None, 0.1)
        terminal.wait_for_room()
        times.append(time.seconds)

    time.start("writer", write)
    time.call_at(0.05, lambda: setattr(terminal, "hangs", True))
    time.call_at(0.75, lambda: setattr(terminal, "hangs", False))
    clock.wait(None, 1.0)
    assert times[0] == 0.0
    assert 0.75 <= times[1] < 0.76
