"""Two faults of one part: each acts on the result of the faults before it in the list."""

import numpy as np
import pytest
from loop.test_faults import (
    ACTS,
    SLOTS,
    START,
    STEP,
    TRUE,
    K,
    Odometer,
    assert_silent,
    assert_unchanged,
    commanded,
    fault,
    flown,
    motion,
    sent,
)

from trimtab.actuators.allocation import DirectActuation
from trimtab.links.wire import Wire
from trimtab.loop.faults import FaultyActuators, FaultyChannel, FaultySensor

BEFORE = START - 1


def double(**more):
    """Fault that doubles every number."""
    return fault("wrong", 1.0, **more)


def add_three(**more):
    """Fault that adds 3 to every number."""
    return fault("wrong", 0.0, bias=3.0, **more)


def sensor(*faults):
    part = Odometer()
    for each in faults:
        part = FaultySensor(part, each, capacity=SLOTS)
    return flown(part, motion)


def channel(*faults):
    part = Wire(period=STEP)
    for each in faults:
        part = FaultyChannel(part, each, capacity=SLOTS)
    return flown(part, sent, carried=True)


def actuators(*faults):
    part = DirectActuation(period=STEP)
    for each in faults:
        part = FaultyActuators(part, each, capacity=SLOTS)
    return flown(part, commanded).u


@pytest.mark.parametrize("make", [sensor, channel])
def test_order_of_two_wrong_faults_is_the_order_of_the_list(make):
    for faults, expected in (((double(), add_three()), 2 * TRUE + 3), ((add_three(), double()), 2 * (TRUE + 3))):
        out = make(*faults)
        np.testing.assert_array_equal(out.value.distance[ACTS], expected[ACTS])
        assert_unchanged(out, ~ACTS)


@pytest.mark.parametrize("make", [sensor, channel])
@pytest.mark.parametrize("word", ["stuck", "delayed"])
def test_no_sample_passes_if_one_of_two_faults_is_off(make, word):
    """A link that is stuck repeats the last sample, even if no sample arrives at the fault."""
    off, other = fault("off"), fault(word, 0.05)
    assert_silent(make(other, off), ACTS, BEFORE)
    assert_silent(make(off, other), ACTS, BEFORE)


@pytest.mark.parametrize("make", [sensor, channel])
def test_wrong_fault_also_changes_the_last_sample_of_a_part_that_is_off(make):
    out = make(fault("off"), double())
    assert (out.value.distance[ACTS] == 2 * TRUE[BEFORE]).all()
    assert (out.t[ACTS] == BEFORE * STEP).all()
    assert not out.fresh[ACTS].any()
    assert_silent(make(double(), fault("off")), ACTS, BEFORE)


def test_stuck_sensor_that_is_wrong_repeats_the_wrong_value():
    out = sensor(fault("stuck"), double())
    assert (out.value.distance[ACTS] == 2 * TRUE[BEFORE]).all()
    np.testing.assert_array_equal(out.t[ACTS], K[ACTS] * STEP)
    out = sensor(double(), fault("stuck"))
    assert (out.value.distance[ACTS] == TRUE[BEFORE]).all()


@pytest.mark.parametrize("make", [sensor, channel])
def test_delays_of_two_faults_add_up(make):
    out = make(fault("delayed", 0.05), fault("delayed", 0.10))
    late = (K >= START + 15) & ACTS
    np.testing.assert_array_equal(out.t[late], (K[late] - 15) * STEP)
    np.testing.assert_array_equal(out.value.distance[late], TRUE[late] - 15)
    assert_silent(out, ACTS & ~late, BEFORE)


@pytest.mark.parametrize("make", [sensor, channel])
def test_one_slow_fault_thins_the_samples_of_the_other(make):
    out = make(fault("slow", 2), fault("slow", 3))
    assert set(np.diff(K[ACTS & out.fresh])) == {6}


@pytest.mark.parametrize("make", [sensor, channel])
def test_faults_at_different_times_do_not_affect_each_other(make):
    first, second = (K >= 100) & (K < 150), (K >= 150) & (K < 200)
    out = make(fault("off", duration=50 * STEP), double(start=150 * STEP, duration=50 * STEP))
    assert_silent(out, first, BEFORE)
    np.testing.assert_array_equal(out.value.distance[second], 2 * TRUE[second])
    assert_unchanged(out, ~ACTS)


@pytest.mark.parametrize("make", [sensor, channel])
def test_two_random_faults_of_one_part_use_the_same_numbers(make):
    """Two intermittent faults together are off as often as the one that is off more often."""
    both = make(fault("intermittent", 0.3), fault("intermittent", 0.6))
    one = make(fault("none"), fault("intermittent", 0.6))
    np.testing.assert_array_equal(both.fresh, one.fresh)
    assert 0 < both.fresh[ACTS].sum() < ACTS.sum()


def test_faults_of_actuators_act_in_the_order_of_the_list():
    true = actuators(fault("none"), fault("none")).FX
    for faults, expected in (
        ((double(), add_three()), 2 * true + 3),
        ((add_three(), double()), 2 * (true + 3)),
        ((fault("off"), add_three()), 0 * true + 3),
        ((add_three(), fault("off")), 0 * true),
        ((fault("stuck"), double()), 0 * true + 2 * true[BEFORE]),
    ):
        out = actuators(*faults).FX
        np.testing.assert_array_equal(out[ACTS], expected[ACTS])
        np.testing.assert_array_equal(out[~ACTS], true[~ACTS])
