"""Shapes of programs that another compiler of JAX got wrong without a word (benchmarks/peers/peer_elodin.py), and the
whole loop that they come from: here the numbers are JAX's, in single calls, over lanes, and vmapped before compiling.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab

REFERENCE = Path(__file__).parents[2] / "benchmarks" / "reference"
CRAFTS = 13
"""More than go side by side, and no multiple of 4 or 8."""


@pytest.fixture(scope="module")
def hover():
    """The loop as its author would write it in JAX."""
    sys.path.insert(0, str(REFERENCE))
    try:
        import hover_jax
    finally:
        sys.path.remove(str(REFERENCE))
    return hover_jax


def fly(step, state, ticks):
    """The state after some ticks, tick by tick."""
    for k in range(ticks):
        state = step(np.int32(k), *state)
    return state


def crafts(state, rng):
    """States of many crafts that differ in every real number."""
    return [np.stack([v + rng.normal(size=np.shape(v)) for _ in range(CRAFTS)]) for v in state]


def check_one_and_many(step, state, ticks):
    """Compare steps of one craft, of many over lanes, and of many as one function with JAX."""
    compiled = trimtab.compile(step, np.int32(0), *state)
    for got, wanted in zip(fly(compiled, state, ticks), fly(jax.jit(step), state, ticks), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-13)
    many = crafts(state, np.random.default_rng(1))
    starts = np.arange(CRAFTS, dtype=np.int32) * 5  # each at a tick of its own
    together = jax.jit(jax.vmap(lambda k, offset, *s: step(k + offset, *s), (None, *[0] * (1 + len(state)))))
    as_one = trimtab.compile(together, np.int32(0), starts, *many)
    lanes, one, wanted = many, many, many
    for k in range(ticks):
        lanes = compiled.lanes(starts + np.int32(k), *lanes)
        one = as_one(np.int32(k), starts, *one)
        wanted = together(np.int32(k), starts, *wanted)
    for a, b, w in zip(lanes, one, wanted, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(a, w, rtol=1e-12, atol=1e-13)


def test_ring_reads_at_a_different_index_per_craft(hover):
    def step(k, ring, x):
        ring, read = hover.through(ring, x + 1, k, 2 + k % 7)
        return ring, 0.9 * read + 0.1 * x

    check_one_and_many(step, (np.zeros((64, 3)), np.array([1.0, 2.0, 3.0])), 90)


@pytest.mark.thorough
def test_vector_select_after_a_random_delay(hover):
    key = jnp.array([7, 0], jnp.uint32)

    def step(k, ring, x, latch):
        _, draw = hover.uni(key, k, 0)
        ring, read = hover.through(ring, x + 1, k, 2 + (8 * draw).astype(jnp.int32))
        return ring, 0.9 * x + 0.1, jnp.where(k % 5 == 0, read, latch)

    check_one_and_many(step, (np.zeros((64, 2)), np.array([1.0, 2.0]), np.zeros(2)), 45)


@pytest.mark.thorough
def test_random_draws_inside_and_after_a_branch(hover):
    key = jnp.array([7, 0], jnp.uint32)

    def step(k, bias, x, ring):
        def sample():
            n0, n1 = hover.nrm2(key, k, 1)
            n2, _ = hover.nrm2(key, k, 2)
            return bias + jnp.array([1e-2 * n0, 1e-1 * n1, 1e-1 * n2])

        bias = lax.cond(k % 7 == 0, sample, lambda: bias)
        x = lax.cond((k % 11 == 0) & (k > 0), lambda: x - 0.3 * jnp.stack(hover.nrm2(key, k, 4)), lambda: x)
        draw, _ = hover.uni(key, k, 0)
        ring, read = hover.through(ring, x + bias[1:], k, 3 + (6 * draw).astype(jnp.int32))
        return bias, 0.99 * x + 0.01 * read, ring

    check_one_and_many(step, (np.array([0.002, 0.03, -0.02]), np.array([0.5, -1.8]), np.zeros((64, 2))), 60)


@pytest.mark.thorough
def test_whole_step_and_whole_run_match_jax(hover):
    gains, key = np.array(hover.GAINS), np.array([hover.KEY0, 0], np.uint32)
    jitted = jax.jit(hover.step)
    state = hover.init()
    compiled = trimtab.compile(hover.step, gains, key, state, np.int32(0))
    own = state
    for k in range(1100):  # beyond the first fix
        state, row = jitted(gains, key, state, np.int32(k))
        own, own_row = compiled(gains, key, own, np.int32(k))
        np.testing.assert_allclose(own_row, row, rtol=1e-10, atol=1e-12)
    for got, wanted in zip(jax.tree.leaves(own), jax.tree.leaves(state), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-12)
    text = (REFERENCE.parent / "README.md").read_text(encoding="utf-8").split("```")[-2]
    whole = trimtab.compile(hover.summary, gains, key)
    np.testing.assert_allclose(whole(gains, key), [float(x) for x in text.split()], rtol=0, atol=1e-9)
    keys = np.stack([np.full(CRAFTS, hover.KEY0), np.arange(CRAFTS)], 1).astype(np.uint32)
    assert np.array_equal(whole.lanes(gains, keys)[0], whole(gains, key))
