"""Checks of a stream of samples: invalid, duplicate, disordered, frozen."""

import jax
import numpy as np
import pytest
from estimators.flights import Fix

from trimtab.compiler.function import lower_function
from trimtab.core.signals import hold_sample, new_sample
from trimtab.estimators.inertial.sensor_watch import initial_watch, validate_sample


def look(watch, now, t, value, fresh, ordered, frozen_after):
    sample = hold_sample(now, new_sample(t, Fix(*value)), fresh=fresh)
    return validate_sample(watch, now, sample, (value[0], value[1]), frozen_after=frozen_after, ordered=ordered)


compiled = jax.jit(look, static_argnames="ordered")


def watched(stream, *, ordered=False, frozen_after=3):
    """The last judgement of a stream of (t, north[, now]), and which were usable."""
    watch, used, last = initial_watch(), [], None
    for t, north, *now in stream:
        value = np.array([north, 1.0])
        last = compiled(watch, np.int64(now[0] if now else t), np.int64(t), value, True, ordered, frozen_after)
        watch = last.watch
        used.append(bool(last.usable))
    return last, used


def test_valid_samples_are_used():
    last, used = watched([(10, 1.0), (20, 2.0), (30, 1.0)])
    assert used == [True] * 3
    assert (last.watch.samples, last.watch.invalid, last.watch.duplicates, last.watch.disordered) == (3, 0, 0, 0)
    np.testing.assert_array_equal(last.value, [1.0, 1.0, 0.0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_sample_is_not_used_and_counted(bad):
    last, used = watched([(10, 1.0), (20, bad), (30, 2.0)])
    assert used == [True, False, True]
    assert last.watch.invalid == 1
    bad_one, _ = watched([(10, bad)])
    assert np.isfinite(bad_one.value).all()


def test_sample_from_the_future_is_not_used():
    last, used = watched([(10, 1.0), (50, 2.0, 40), (45, 2.0, 60)])
    assert used == [True, False, True]
    assert last.watch.invalid == 1
    assert last.watch.last == 45


def test_duplicate_is_counted_and_not_used():
    last, used = watched([(10, 1.0), (10, 1.0, 20), (30, 2.0)])
    assert used == [True, False, True]
    assert last.watch.duplicates == 1
    assert last.watch.repeats == 0


def test_backwards_time_is_flagged():
    stream = [(10, 1.0), (30, 2.0), (20, 3.0, 40)]
    late, used = watched(stream)
    assert used == [True, True, True]
    assert (bool(late.watch.backwards), int(late.watch.disordered), int(late.watch.last)) == (True, 1, 30)
    refused, used = watched(stream, ordered=True)
    assert used == [True, True, False]
    assert refused.watch.backwards
    after, _ = watched([*stream, (50, 4.0)], ordered=True)
    assert not after.watch.backwards


def test_repeated_equal_samples_are_flagged_frozen():
    last, _ = watched([(10, 1.0), (20, 2.0), (30, 2.0), (40, 2.0)])
    assert (int(last.watch.repeats), bool(last.watch.frozen)) == (2, False)
    last, _ = watched([(10, 1.0), (20, 2.0), (30, 2.0), (40, 2.0), (50, 2.0)])
    assert last.watch.frozen
    last, _ = watched([(10, 2.0), (20, 2.0), (30, 2.0), (40, 2.0), (50, 2.0), (60, 2.1)])
    assert not last.watch.frozen
    last, _ = watched([(t, 2.0) for t in range(10, 90, 10)], frozen_after=0)
    assert not last.watch.frozen
    last, _ = watched([(t, 0.0) for t in (10, 20, 30)], frozen_after=3)
    assert last.watch.repeats == 2  # the first has nothing to be equal to


def test_stale_sample_leaves_the_watch_unchanged():
    value = np.array([1.0, 2.0])
    watch = initial_watch()
    found = compiled(watch, np.int64(20), np.int64(10), value, False, False, 3)
    assert not found.usable
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(np.array_equal(a, b)), found.watch, watch))


@pytest.mark.thorough
def test_sensor_watch_lowers_to_generated_c():
    args = (initial_watch(), np.int64(20), np.int64(10), np.ones(2), np.bool_(True))
    assert lower_function(lambda w, now, t, v, f: look(w, now, t, v, f, True, 3), args).text("f")
