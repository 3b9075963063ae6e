"""The journal in flash: completed records survive a power failure at any write."""

import ctypes

import numpy as np
import pytest

TAGS = 4


@pytest.fixture
def power(library):
    library.power_find.restype = ctypes.c_int64
    return library


def append(power, tag, value):
    return power.power_append(tag, ctypes.c_uint64(value))


def live(power, rng, written, begun, actions):
    """Appends and times of rest until the power fails; what is surely written, and what may be."""
    for _ in range(actions):
        if rng.random() < 0.05:
            if power.power_tidy() < 0:
                return False
            continue
        tag, value = int(rng.integers(TAGS)), int(rng.integers(1, 2**62))
        begun.clear()
        begun[tag] = value
        outcome = append(power, tag, value)
        if outcome < 0:
            return False
        if outcome:
            written[tag] = value
        begun.clear()
    return True


def check(power, written, begun):
    for tag in range(TAGS):
        found = power.power_find(tag)
        assert found in {written.get(tag, -1), begun.get(tag, written.get(tag, -1))}
        if found != -1:
            written[tag] = found
    begun.clear()


@pytest.mark.thorough
@pytest.mark.parametrize("garbage", [0, 1])
def test_survives_power_failure_at_every_flash_operation(power, garbage):
    """A sequence of 150 records over changing sectors, cut at each of its flash operations in turn."""
    power.power_new(3, garbage)
    power.power_start(0, TAGS)
    live(power, np.random.default_rng(5), {}, {}, 150)
    total = power.power_operations()
    assert total > 600
    assert power.power_erasures() > 2
    for cut in range(1, total + 1):
        power.power_new(3, garbage)
        written, begun = {}, {}
        if power.power_start(cut, TAGS) > 0:
            live(power, np.random.default_rng(5), written, begun, 150)
        assert power.power_start(0, TAGS) == 1
        check(power, written, begun)
        assert append(power, 0, 77) == 1  # and it goes on
        assert power.power_find(0) == 77
        assert power.power_abuses() == 0  # nothing was written where an erasure had not been finished


def test_survives_repeated_power_failures_during_startup(power):
    rng = np.random.default_rng(11)
    power.power_new(4, 1)
    written, begun, cuts = {}, {}, 0
    for _ in range(3000):
        if power.power_start(int(rng.integers(1, 200)), TAGS) < 0:
            cuts += 1
            continue
        check(power, written, begun)
        cuts += not live(power, rng, written, begun, 60)
    assert cuts > 2000
    assert power.power_start(0, TAGS) == 1
    check(power, written, begun)
    assert power.power_abuses() == 0


def test_without_erasure_fills_second_sector_then_rejects_records(power):
    """No sector is erased while armed: records fill two sectors, and each further record is rejected and counted."""
    power.power_new(1, 0)
    power.power_start(0, TAGS)
    before, capacity = power.power_erasures(), power.power_capacity()
    outcomes = [append(power, 0, k) for k in range(3 * capacity)]
    done = sum(outcomes)
    assert done == capacity + capacity - 1  # one slot took the record that was copied
    assert outcomes == [1] * done + [0] * (3 * capacity - done)
    assert power.power_failures() == 3 * capacity - done
    assert power.power_erasures() == before
    assert power.power_find(0) == done - 1
    power.power_tidy()
    assert append(power, 0, 99) == 1


def test_uncopied_records_keep_at_least_the_last_half(power):
    """The black box keeps the last records of a long flight."""
    power.power_new(2, 0)
    power.power_start(0, 0)
    for k in range(400):
        power.power_tidy()
        assert append(power, 0, k) == 1
    assert power.power_find(0) == 399
