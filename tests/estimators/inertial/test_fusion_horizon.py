"""The window from the filter's horizon to now equals the composition of its samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.time import ms
from trimtab.estimators.inertial.fusion_horizon import (
    FIXES,
    add_fix,
    add_sample,
    correct_window,
    empty_window,
    is_due,
    next_fix,
    no_fixes,
    take_sample,
)
from trimtab.estimators.inertial.strapdown import compose, increment_of, no_increment

SLOTS, DELAY = 24, ms(20)


def sample(k):
    s = 0.05 * k
    return jnp.stack(
        [jnp.sin(s), 0.5 * jnp.cos(2 * s), -0.6 + 0 * s, 2 * jnp.cos(s), 1.0 + 0 * s, -9.8 + 3 * jnp.sin(s)]
    )


def bias_at(k, change):
    return jnp.array([0.01, -0.02, 0.005, 0.1, 0.05, -0.1]) + change * (k >= 490)  # the last ten of the window


@jax.jit
def run(change):
    """500 samples through a window of 20; the bias estimates change by `change` (6,) ten samples before the end."""
    add, take = add_sample, take_sample

    def step(k, window):
        window = add(window, (k + 1) * ms(1), sample(k.astype(float)), bias_at(k, change), 0.0)
        return jax.lax.while_loop(lambda w: is_due(w, DELAY), lambda w: take(w)[0], window)

    return jax.lax.fori_loop(0, 500, step, jax.tree.map(jnp.asarray, empty_window(SLOTS)))


@jax.jit
def composed_samples(window, bias):
    """The samples that wait, composed one by one with one bias."""

    def one(i, total):
        k = (window.head + i) % window.t.shape[0]
        return compose(total, increment_of(window.rate[k] - bias[:3], window.force[k] - bias[3:], window.dt[k]))

    return jax.lax.fori_loop(0, window.count, one, jax.tree.map(jnp.asarray, no_increment()))


correct = jax.jit(lambda window, bias: correct_window(window, bias[:3], bias[3:]))


@pytest.mark.thorough
def test_window_motion_equals_composition_of_waiting_samples():
    """After 480 samples have left at the front: to rounding."""
    window = run(jnp.zeros(6))
    assert int(window.count) == 20
    expected = composed_samples(window, bias_at(0, jnp.zeros(6)))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-11), window.motion, expected)
    np.testing.assert_allclose(window.entered, 0.02 * bias_at(0, 0.0), atol=1e-13)


def left(window, bias, name):
    """What correct_window leaves of what is missing, and that itself."""
    right, one = composed_samples(window, bias), correct(window, bias)
    if name == "turn":
        both = quaternion.local(one.turn, right.turn), quaternion.local(window.motion.turn, right.turn)
    else:
        both = tuple(getattr(m, name) - getattr(right, name) for m in (one, window.motion))
    return [float(np.linalg.norm(v)) for v in both]


CHANGE = jnp.array([0.004, -0.002, 0.003, 0.05, -0.04, 0.03])


@pytest.mark.parametrize("name", ["turn", "velocity", "position"])
def test_bias_change_at_window_end_is_corrected_to_first_order(name):
    """All samples entered with the old ones: what is left is of the order of the turn in the window, 2 %."""
    after, before = left(run(jnp.zeros(6)), bias_at(0, jnp.zeros(6)) + CHANGE, name)
    assert before > 1e-6
    assert after < 0.02 * before


@pytest.mark.parametrize(("name", "part"), [("turn", 0.02), ("velocity", 0.02), ("position", 0.4)])
def test_bias_change_within_window_is_mostly_corrected(name, part):
    """The older half entered with the old ones; the place is corrected as if all had, a little: a third is left."""
    after, before = left(run(CHANGE), bias_at(499, CHANGE), name)
    assert before > 1e-6
    assert after < part * before


def test_correction_without_bias_change_is_identity():
    window = run(jnp.zeros(6))
    bias = bias_at(0, 0.0)
    one = correct(window, bias)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-11), one, window.motion)


def test_first_sample_adds_no_motion_and_full_window_is_due():
    window = add_sample(jax.tree.map(jnp.asarray, empty_window(2)), ms(5), jnp.ones(6), jnp.zeros(6), 0.0)
    assert float(window.motion.time) == 0
    np.testing.assert_array_equal(window.motion.velocity, 0)
    assert not is_due(window, ms(100))
    window = add_sample(window, ms(6), jnp.ones(6), jnp.zeros(6), 0.0)
    assert is_due(window, ms(100)), "both slots are full"
    _, taken = take_sample(window)
    assert int(taken.t) == ms(5)


def test_fix_queue_is_ordered_and_holds_four():
    fixes = jax.tree.map(jnp.asarray, no_fixes(2))
    add, take = jax.jit(add_fix), jax.jit(next_fix)
    for k in range(FIXES):
        fixes, room = add(fixes, ms(k + 1), jnp.full(2, float(k)))
        assert room
    same, room = add(fixes, ms(9), jnp.ones(2))
    assert not room
    assert int(same.count) == FIXES
    t, value, fixes = take(fixes)
    assert int(t) == ms(1)
    fixes, room = add(fixes, ms(9), jnp.full(2, 9.0))
    assert room
    for expected in (1.0, 2.0, 3.0, 9.0):
        t, value, fixes = take(fixes)
        assert float(value[0]) == pytest.approx(expected)
    assert int(fixes.count) == 0
