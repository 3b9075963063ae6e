"""Lines written by a thread: put() never blocks, and lost lines are counted."""

import threading

from trimtab.core.line_writer import ROOM, LineWriter


def test_all_lines_are_written_in_order():
    written = []
    writer = LineWriter(written.append)
    for k in range(500):
        writer.put(str(k))
    assert writer.close(60.0) == 0
    assert written == [str(k) for k in range(500)]


def test_blocked_write_does_not_block_put_and_overflow_is_counted():
    go, written = threading.Event(), []

    def write(text):
        go.wait(60.0)
        written.append(text)

    writer = LineWriter(write)
    for k in range(2 * ROOM):
        writer.put(str(k))
    assert ROOM - 1 <= writer.lost_count <= ROOM
    assert writer.close(0.0) >= 2 * ROOM - 1
    go.set()


def test_failed_writes_are_counted_and_later_lines_written():
    written = []

    def write(text):
        if text == "2":
            raise BrokenPipeError
        if text == "3":
            raise ValueError("closed file")
        written.append(text)

    writer = LineWriter(write)
    for k in range(5):
        writer.put(str(k))
    assert writer.close(60.0) == 2
    assert written == ["0", "1", "4"]


def test_waiting_lines_count_as_lost_until_written():
    go, written = threading.Event(), []

    def write(text):
        go.wait(60.0)
        written.append(text)

    writer = LineWriter(write)
    for k in range(5):
        writer.put(str(k))
    assert writer.settle(0.0) >= 5
    go.set()
    assert writer.settle(60.0) == 0
    writer.put("5")
    assert writer.close(60.0) == 0
    assert written == [str(k) for k in range(6)]
