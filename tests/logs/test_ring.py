"""A ring between two processes: order, gaps, bounds, and the death of either side."""

import os
import subprocess
import sys
import threading
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.logs.ring import TEXT_BYTES, Ring

PRODUCER = """
import os, sys
from trimtab.logs.ring import Ring
ring = Ring.create(sys.argv[1], columns=3, rows=64)
for i in range(40):
    ring.write_row([i, i / 8, -i])
    if i == 20:
        ring.write_text("half way")
print("done", flush=True)
sys.stdin.read()
"""
CONSUMER = """
import sys
from trimtab.logs.ring import Ring
ring = Ring.attach(sys.argv[1])
ring.read_rows()
print("joined", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def ring():
    made = Ring.create(columns=2, rows=8, events=4)
    yield made
    made.close()
    made.unlink()


def started(program: str, name: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    arguments = [sys.executable, "-c", program, name]
    return subprocess.Popen(arguments, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env={**os.environ})


def ended(process: subprocess.Popen[str]) -> str:
    """Return the standard error of a killed process."""
    process.kill()
    return process.communicate()[1]


@settings(max_examples=50)
@given(st.lists(st.one_of(st.integers(1, 30), st.none()), max_size=30))
def test_ring_is_a_fifo_that_rejects_rows_when_full(moves):
    """Compare with a list: an integer writes that many rows, None reads all."""
    expected, taken, sequence, dropped = [], [], 0, 0
    held: list[int] = []
    with Ring.create(columns=1, rows=8) as ring:
        for move in [*moves, None]:
            if move is None:
                numbers, rows = ring.read_rows()
                assert numbers.dtype == np.int64
                taken += list(zip(numbers.tolist(), rows[:, 0].tolist(), strict=True))
                expected += [(n, n / 4) for n in held]
                held = []
                continue
            for _ in range(move):
                fits = len(held) < 8
                assert ring.write_row(np.array([sequence / 4])) is fits
                held += [sequence] if fits else []
                dropped += not fits
                sequence += 1
        assert taken == expected
        assert (ring.dropped_rows, ring.waiting_rows) == (dropped, 0)
        ring.unlink()


def test_texts_keep_their_position_among_rows(ring):
    ring.write_text("first")
    ring.write_row([1, 2])
    ring.write_row([3, 4])
    ring.write_text("µ" * TEXT_BYTES)
    heard = ring.read_texts()
    assert [e.before for e in heard] == [0, 2]
    np.testing.assert_array_equal([e.newest for e in heard], [np.nan, 3])
    assert heard[0].text == "first"
    assert heard[1].text == "µ" * (TEXT_BYTES // 2)
    assert [ring.write_text("more") for _ in range(6)] == [True] * 4 + [False] * 2
    assert len(ring.read_texts()) == 4


def test_rows_keep_floats_bit_for_bit(ring):
    row = np.array([-0.0, np.nan])
    ring.write_row(row)
    ring.write_row(np.array([np.inf, float(2**53 - 1)]))
    _, rows = ring.read_rows()
    assert rows[0].tobytes() == row.tobytes()
    assert rows[1].tolist() == [np.inf, 2.0**53 - 1]


def test_two_threads_lose_no_accepted_rows():
    with Ring.create(columns=4, rows=256) as ring:
        count, put = 30_000, [0]

        def produce():
            for i in range(count):
                put[0] += ring.write_row(np.full(4, float(i)))

        thread = threading.Thread(target=produce)
        thread.start()
        seen = []
        while thread.is_alive() or ring.waiting_rows:
            sequence, rows = ring.read_rows()
            np.testing.assert_array_equal(rows, np.repeat(sequence[:, None].astype(float), 4, axis=1))
            seen += sequence.tolist()
        thread.join()
        assert seen == sorted(set(seen))
        assert len(seen) == put[0] == count - ring.dropped_rows
        ring.unlink()


def test_rows_of_a_killed_producer_remain_readable():
    name = f"trimtab-test-{os.getpid()}-a"
    process = started(PRODUCER, name)
    assert process.stdout is not None
    assert process.stdout.readline() == "done\n"
    with Ring.attach(name) as ring:
        ended(process)
        sequence, rows = ring.read_rows()
        assert sequence.tolist() == list(range(40))
        np.testing.assert_array_equal(rows, [[i, i / 8, -i] for i in range(40)])
        assert [tuple(e) for e in ring.read_texts()] == [(21, 20.0, "half way")]


def test_killed_consumer_only_increases_dropped_rows(ring):
    process = started(CONSUMER, ring.name)
    assert process.stdout is not None
    assert process.stdout.readline() == "joined\n"
    assert ended(process) == ""
    assert [ring.write_row([i, i]) for i in range(12)] == [True] * 8 + [False] * 4
    assert ring.dropped_rows == 4
    with Ring.attach(ring.name) as another:  # a new one goes on where the dead one was
        assert another.read_rows()[0].tolist() == list(range(8))
        ring.write_row([12, 12])
        assert another.read_rows()[0].tolist() == [12]


def test_writing_rows_allocates_no_lasting_memory(ring):
    row = np.ones(2)
    ring.write_row(row)
    tracemalloc.start()
    for _ in range(100):
        ring.write_row(row)
    before = tracemalloc.take_snapshot()
    for _ in range(5000):
        ring.write_row(row)
    after = tracemalloc.take_snapshot()
    tracemalloc.stop()
    grown = [s for s in after.compare_to(before, "filename") if s.traceback[0].filename.endswith("ring.py")]
    assert sum(s.size_diff for s in grown) < 1000
    assert ring.dropped_rows == 5000 + 101 - 8


def test_rejects_invalid_size_and_name(ring):
    with pytest.raises(InputError, match="one of each"):
        Ring.create(columns=0)
    with pytest.raises(InputError, match="ring named"):
        Ring.create(ring.name, columns=1)
    with pytest.raises(InputError, match="no ring named"):
        Ring.attach("trimtab-test-of-nobody")
    with pytest.raises(InputError, match="do not fit"):
        Ring.create(columns=1000, rows=10**9)


def test_closing_twice_is_harmless():
    ring = Ring.create(columns=1)
    ring.close()
    ring.close()
    ring.unlink()
