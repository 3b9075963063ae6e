"""Waits end when data arrives, or at the timeout with sub-millisecond accuracy."""

import os
import select
import time

import pytest

from trimtab.flight.transports.reconnecting_stream import wait_until_ready

pytestmark = pytest.mark.real_time


def test_wait_detects_readable_and_writable_descriptors():
    reading, writing = os.pipe()
    try:
        assert not wait_until_ready(reading, select.POLLIN, 0.0)
        assert wait_until_ready(writing, select.POLLOUT, 1.0)
        os.write(writing, b"x")
        assert wait_until_ready(reading, select.POLLIN, 1.0)
        assert wait_until_ready(reading, select.POLLIN | select.POLLOUT, 1.0)
    finally:
        os.close(reading)
        os.close(writing)


def test_waits_below_a_millisecond_are_accurate():
    """Half of 200 waits of 0.2 ms end within 0.9 ms. With timeouts in whole milliseconds none would."""
    reading, writing = os.pipe()
    try:
        times = []
        for _ in range(200):
            began = time.perf_counter()
            assert not wait_until_ready(reading, select.POLLIN, 2e-4)
            times.append(time.perf_counter() - began)
        assert min(times) >= 1.9e-4
        assert sorted(times)[100] < 9e-4
    finally:
        os.close(reading)
        os.close(writing)


def test_closed_descriptor_counts_as_ready():
    reading, writing = os.pipe()
    os.close(reading)
    os.close(writing)
    assert wait_until_ready(reading, select.POLLIN, 0.0)
