"""Running compiled runs: progress, Ctrl-C, threads."""

import os
import signal
import threading
import time

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.run import program
from trimtab.run.program import row_numbers, thread_count
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios import catalogue

needs_c = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@pytest.fixture(scope="module")
def short():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    return replace(scenario, duration=seconds("0.5"))


def test_row_numbers_count_written_rows():
    np.testing.assert_array_equal(row_numbers(np.array([True, False, False, True])), [0, 4, 4, 1])


def test_thread_count_is_bounded():
    assert thread_count(0) == 1
    assert thread_count(3) == 3
    assert thread_count(10**6) == 256
    assert thread_count(None) >= 1


@pytest.mark.thorough
@needs_c
def test_progress_reaches_the_number_of_runs(short, monkeypatch):
    monkeypatch.setattr(program, "SHORT", 0)
    seen = []
    watched = simulate_batch(short, seeds=range(40), signals=("truth",), progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 40
    monkeypatch.undo()
    plain = simulate_batch(short, seeds=range(40), signals=("truth",))
    np.testing.assert_array_equal(watched.rms["truth.yaw_rate"], plain.rms["truth.yaw_rate"])


@pytest.fixture
def interruptible():
    """Make Ctrl-C raise, also in a background process, where it would be ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.real_time
@needs_c
def test_ctrl_c_stops_a_batch(short, interruptible):
    simulate_batch(short, seeds=range(2), signals=("truth",))  # compiled before the clock starts
    many = range(40_000)  # a quarter of a minute at least
    threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        simulate_batch(short, seeds=many, signals=("truth",), log_period=seconds(1), duration=seconds(20))
    assert time.perf_counter() - began < 10
