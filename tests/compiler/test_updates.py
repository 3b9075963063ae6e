"""Rings: a few elements of a large array are written in place where nobody reads the old ones, also under a select."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab


def select_after(ring, i, x):
    return jnp.where(x > 0, ring.at[i].set(x), ring), ring[(i + 3) % ring.shape[0]]


def select_of_two(ring, i, x):
    return jnp.where(x > 0, ring.at[i].set(x), ring.at[i + 1].set(-x)), ring[i]


def chain(ring, i, x):
    new = ring.at[i].set(x).at[(i + 1) % ring.shape[0]].set(2 * x)
    return jnp.where(x > 0.3, new, ring), ring[(i + 1) % ring.shape[0]]


def update_before_the_old_is_read(ring, i, x):
    new = lax.dynamic_update_slice(ring, jnp.stack([x, ring[i]]), (i,))
    return new, ring[(i + 1) % ring.shape[0]]


def out_of_range(ring, i, x):
    return jnp.where(x > 0, ring.at[i - 10].set(x, mode="drop"), ring.at[i + 60].set(x)), x


def conditional(ring, i, x):
    return lax.cond(x > 0, lambda: (ring.at[i].set(x), ring[0]), lambda: (ring, ring[1]))


def both_are_read(ring, i, x):
    new = ring.at[i].set(x)
    return jnp.where(x > 0, new, ring), ring.sum() + new[3]


def old_is_kept(ring, i, x):
    new = ring.at[i].set(x)
    return jnp.where(new[0] > 0.5, ring, new), jnp.where(x > 0, ring, new)[5]


STEPS = (select_after, select_of_two, chain, update_before_the_old_is_read, out_of_range, conditional)
IN_PLACE = STEPS[:5]
COPYING = (both_are_read, old_is_kept)


def fly(step):
    def flight(ring, numbers):
        def turn(carried, x):
            ring, i = carried
            ring, y = step(ring, i, x)
            return (ring, (i + 1) % ring.shape[0]), y

        (ring, _), outputs = lax.scan(turn, (ring, jnp.int32(0)), numbers)
        return ring, outputs

    return flight


@pytest.mark.parametrize("step", [*STEPS, *COPYING], ids=lambda f: f.__name__)
def test_ring_updates_match_jax(step):
    flight = fly(step)
    ring, numbers = np.random.default_rng(1).normal(size=64), np.random.default_rng(0).normal(size=(3, 200))
    compiled = trimtab.compile(flight, ring, numbers[0], lanes=4)
    together = compiled.lanes(ring, numbers)
    for k in range(3):
        result = compiled(ring, numbers[k])
        for mine, jaxs, lanes in zip(result, jax.jit(flight)(ring, numbers[k]), together, strict=True):
            np.testing.assert_allclose(mine, jaxs, rtol=0, atol=1e-12)
            assert np.array_equal(lanes[k], mine)


@pytest.mark.parametrize("step", IN_PLACE, ids=lambda f: f.__name__)
def test_no_step_copies_the_ring(step):
    ring = np.zeros(2048)
    source = trimtab.compile(fly(step), ring, np.zeros(50)).c_source
    assert source.count("< 2048;") == 1  # once, into the result


def test_select_between_updated_and_old_array_reads_correctly():
    ring = np.arange(100.0)
    compiled = trimtab.compile(lambda r, x: jnp.where(x > 0, r.at[3].set(x), r)[3] + r[3], ring, 1.0)
    assert compiled(ring, 2.0) == 5.0
    assert compiled(ring, -2.0) == 6.0


def test_callers_array_is_not_modified():
    ring = np.arange(100.0)
    compiled = trimtab.compile(lambda r, x: (jnp.where(x > 0, r.at[3].set(x), r), r.at[5].set(x)), ring, 1.0)
    first, second = compiled(ring, 2.0)
    assert np.array_equal(ring, np.arange(100.0))
    assert (first[3], first[5], second[3], second[5]) == (2.0, 5.0, 3.0, 2.0)


@pytest.mark.parametrize(
    "f",
    [
        lambda r, i: r + r.at[i].set(7.0),
        lambda r, i: r.at[i].set(7.0) * r.at[i].set(7.0),
        lambda r, i: r.at[i].set(7.0) - r.at[i + 1].set(5.0),
        lambda r, i: jnp.where(r > 0, r.at[i].set(7.0), 2 * r),
        lambda r, i: jnp.where(r > 0, r.at[i].set(7.0), r),
        lambda r, i: jnp.where((r > 0).at[i].set(False) & (r > 0), r, 1.0),
        lambda r, i: jnp.concatenate([r, r.at[i].set(7.0)]),
        lambda r, i: r.at[r.astype(int)].add(r.at[i].set(7.0)),
        lambda r, i: lax.dynamic_update_slice(r.at[i].set(7.0), r[:50], (3,)),
        lambda r, i: lax.cond(i > 3, lambda a, b: a - b, lambda a, b: b, r, r.at[i].set(7.0)),
        lambda r, i: lax.fori_loop(0, 3, lambda _, c: (c[1], c[0].at[i].set(c[1][0])), (r, 2 * r))[1],
    ],
)
def test_operation_on_old_and_new_elements_matches_jax(f):
    ring = np.random.default_rng(4).normal(size=60)
    for start in (lambda r: r, lambda r: 3 * r):  # the caller's array, and one of the program's own
        for i in (0, 5, 58):
            compiled = trimtab.compile(lambda r, i, start=start: f(start(r), i), ring, i)
            wanted = jax.jit(lambda r, i, start=start: f(start(r), i))(ring, i)
            np.testing.assert_allclose(compiled(ring, i), wanted, rtol=0, atol=1e-13)


def test_loop_carries_that_start_as_one_array_stay_separate():
    """The two must not share memory: a write to one must not change the other."""

    def flight(x):
        start = x * 2.0

        def turn(k, carried):
            a, b = carried
            return a.at[k].set(b[k + 1] + a[k]), b.at[k + 2].add(a[k])

        return lax.fori_loop(0, 40, turn, (start, start))

    x = jnp.linspace(0.0, 1.0, 300)
    for got, wanted in zip(trimtab.compile(flight, x)(x), flight(x), strict=True):
        np.testing.assert_array_equal(got, wanted)


BRANCHES = (
    lambda a, b, x: lax.cond(x > 0, lambda: (2 * a + b[::-1], b), lambda: (a, b)),
    lambda a, b, x: lax.cond(x > 0, lambda: (a, b), lambda: (a - b, 0.5 * b)),
    lambda a, b, x: lax.cond(x > 0, lambda: (b, a), lambda: (a, b)),
    lambda a, b, x: lax.cond(x > 0, lambda: (2 * a, a), lambda: (a, b)),
    lambda a, b, x: lax.cond(x > 0, lambda: (a + 1, b - a), lambda: (a, a)),
    lambda a, b, x: lax.cond(x > 0, lambda: (a[::-1] + b, a[::-1] - b), lambda: (a, b)),
    lambda a, b, x: (lax.cond(x > 0, lambda: a + 1, lambda: a), a[::-1] + b),
    lambda a, b, x: lax.switch((3 * x).astype(int), (lambda: (a, b), lambda: (a[::-1], b), lambda: (a, 2 * b))),
    lambda a, b, x: lax.cond(
        x > 0,
        lambda: (lax.cond(x > 0.5, lambda: a + b, lambda: a), b),
        lambda: (a, lax.cond(x < -0.5, jnp.sin, jnp.cos, b)),
    ),
)


@pytest.mark.parametrize("f", BRANCHES)
def test_branches_that_pass_arrays_through_match_jax(f):
    """One side of a branch may write into an array that the other passes through, but never into one still read."""

    def flight(a, b, numbers):
        def turn(carried, x):
            a, b = f(*carried, x)
            return (jnp.sin(a), b) if f is BRANCHES[0] else (a, b), a[7] - b[3]

        return lax.scan(turn, (a, b), numbers)

    rng = np.random.default_rng(5)
    a, b, numbers = rng.normal(size=64), rng.normal(size=64), rng.uniform(-1, 1, size=30)
    compiled = trimtab.compile(flight, a, b, numbers)
    for mine, jaxs in zip(
        jax.tree.leaves(compiled(a, b, numbers)), jax.tree.leaves(flight(a, b, numbers)), strict=True
    ):
        np.testing.assert_allclose(mine, jaxs, rtol=1e-13, atol=1e-13)


def test_unchanged_side_of_a_branch_copies_no_array():
    """Only the side with the new array writes into the loop's own array; the other side passes it through."""

    def flight(a, numbers):
        return lax.scan(lambda a, x: (lax.cond(x > 0, lambda: a[::-1] * x, lambda: a), x), a, numbers)[0]

    source = trimtab.compile(flight, np.zeros(2048), np.zeros(50)).c_source
    assert source.count("< 2048;") == 4  # into the loop's before it; two for the new one; that into the loop's
