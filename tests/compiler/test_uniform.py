"""Branches in place of selects whose test is the same in all lanes: same bits, less work."""

import random

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab
from compiler.random_steps import random_program
from trimtab.compiler import uniform
from trimtab.compiler.analysis import find_varying
from trimtab.compiler.function import lower_function
from trimtab.compiler.ir import If
from trimtab.compiler.uniform import inner_blocks

LANES = 4
RING = np.linspace(-1.0, 1.0, 64)


def over_ticks(step, count=6):
    """A function of one float: step(k, x) repeated over ticks k, which are the same in all lanes."""

    def function(x):
        return lax.scan(lambda x, k: (step(k, x), None), x, jnp.arange(count))[0]

    return function


def text_of(step):
    return lower_function(over_ticks(step), (0.5,)).text("go", LANES)


def inside_branch(text, call):
    """Whether every call stands in a branch of the function itself."""
    lines = text[text.index("void go(") :].splitlines()
    depth, found = 0, []
    for line in lines:
        depth -= line.strip().startswith("}") and depth > 0
        if f"{call}(" in line:
            found.append(depth > 0)
        depth += line.strip().startswith(("if (", "} else {"))
    assert found
    return all(found)


def both(function, xs):
    """Numbers of the lanes and of the single runs, as bits."""
    compiled = trimtab.compile(function, xs[0], lanes=LANES)
    return np.asarray(compiled.lanes(xs)), np.stack([np.asarray(compiled(x)) for x in xs])


def count_branches(blocks):
    items = [item for block in blocks for item in block.items]
    inner = [block for item in items for block in inner_blocks(item)]
    return sum(isinstance(item, If) for item in items) + (count_branches(inner) if inner else 0)


def test_skips_work_that_only_one_case_needs():
    text = text_of(lambda k, x: jnp.where(k % 3 == 0, jnp.exp(x), x))
    assert inside_branch(text, "ttv_exp")


def test_branches_on_a_negated_test():
    def step(k, x):
        return jnp.where(~(k % 3 == 0), x + 1.0, jnp.exp(-x))

    assert inside_branch(text_of(step), "ttv_exp")
    xs = np.array([0.5, -1.0, np.nan, np.inf])
    lanes, single = both(over_ticks(step), xs)
    np.testing.assert_array_equal(lanes, single)
    np.testing.assert_allclose(lanes, [over_ticks(step)(x) for x in xs], rtol=1e-13)


def test_keeps_a_value_that_is_also_used_elsewhere():
    def step(k, x):
        y = jnp.exp(-x)
        return jnp.where(k % 3 == 0, y, x) + y

    assert not inside_branch(text_of(step), "ttv_exp")


def test_keeps_a_value_that_both_cases_use():
    def step(k, x):
        y = jnp.exp(-x)
        return jnp.where(k % 3 == 0, y + 1.0, y - 1.0)

    assert not inside_branch(text_of(step), "ttv_exp")


def test_keeps_a_select_whose_test_differs_between_lanes():
    assert not inside_branch(text_of(lambda k, x: jnp.where(x > 0.0, jnp.exp(-x), x)), "ttv_exp")


def test_keeps_a_cheap_select():
    text = text_of(lambda k, x: jnp.where(k % 3 == 0, x + 1.0, x))
    assert " if (" not in text[text.index("void go(") :]


def test_selects_of_one_test_share_a_branch():
    def step(k, x):
        place = (k * 7 + jnp.int32(x)) & 63
        table = jnp.asarray(RING)
        due = k % 3 == 0
        return jnp.where(due, table[place], x) + jnp.where(due, jnp.exp(table[place]), 1.0)

    text = text_of(step)
    assert inside_branch(text, "tv_take_f64")
    assert inside_branch(text, "ttv_exp")


def test_does_not_change_the_given_blocks():
    made = lower_function(over_ticks(lambda k, x: jnp.where(k % 3 == 0, jnp.exp(x), x)), (0.5,))
    before = made.text("go")
    items = [id(item) for block in made.blocks for item in block.items]
    varying = find_varying(made.blocks, list(made.inputs[0].items.ravel()), [])
    results = list(made.outputs[0].items.ravel())
    new = uniform.branch_uniform_selects(made.blocks, varying, results)
    assert count_branches(new) == count_branches(made.blocks) + 1
    assert [id(item) for block in made.blocks for item in block.items] == items
    assert made.text("go") == before


def test_reads_a_ring_before_it_is_written():
    """A read before a write does not move behind it; one after it may."""

    def function(x):
        def step(carry, k):
            ring, y = carry
            place = (k - jnp.int32(x)) & 63
            old = ring[place]
            ring = ring.at[k & 63].set(y)
            new = ring[place]
            due = k % 3 == 0
            return (ring, jnp.where(due, jnp.exp(old), y) + jnp.where(due, jnp.sin(new), 0.25)), None

        return lax.scan(step, (jnp.zeros(64), x), jnp.arange(9))[0]

    xs = np.array([0.5, 1.5, 2.5, 0.0])
    compiled = trimtab.compile(function, 0.5, lanes=LANES)
    wanted = jax.tree.leaves(jax.vmap(function)(xs))
    for lanes, want in zip(jax.tree.leaves(compiled.lanes(xs)), wanted, strict=True):
        np.testing.assert_allclose(lanes, want, rtol=1e-13)


def test_skips_divisions_by_zero_and_reads_out_of_range():
    """The case that is not chosen would divide by zero, convert NaN and read behind the end of a table."""

    def step(k, x):
        table = jnp.asarray(RING)
        zero = jnp.int32(x) * 0
        risky = table[jnp.int32(x * 1e12)] + lax.div(jnp.int32(7), zero) + jnp.log(-jnp.abs(x)) / 0.0
        return jnp.where(k == 99, risky, x * 0.5)

    xs = np.array([0.5, np.nan, -np.inf, 3e300])
    lanes, single = both(over_ticks(step), xs)
    np.testing.assert_array_equal(lanes, single)
    np.testing.assert_array_equal(lanes, xs / 64.0)


def programs(first, count):
    """Some random programs as one function, and arguments for all lanes."""
    made = [random_program(random.Random(seed)) for seed in range(first, first + count)]

    def together(x, i):
        return [program(x, i) for program in made]

    rng = np.random.default_rng(first)
    special = [0.0, -0.0, np.nan, np.inf, -np.inf, 2147483647.0, -2147483648.5, 4e9]
    floats, integers = (2 * LANES, 3), (2 * LANES, 2)
    x = np.where(rng.random(floats) < 0.3, rng.choice(special, floats), rng.normal(size=floats))
    whole = np.array([0, -1, 1, 63, 64, 2**31 - 1, -(2**31)])
    i = np.where(rng.random(integers) < 0.5, rng.choice(whole, integers), rng.integers(-70, 70, integers))
    return together, x, i.astype(np.int32)


@pytest.mark.parametrize(("count", "without"), [(12, []), pytest.param(120, [93], marks=pytest.mark.thorough)])
def test_random_programs_have_selects_that_become_branches(count, without, monkeypatch):
    monkeypatch.setattr(uniform, "BRANCH_COST_MIN", 1)
    unchanged = []
    for first in range(0, count, 3):
        together, x, i = programs(first, 3)
        made = lower_function(together, (x[0], i[0]))
        inputs = [t for a in made.inputs for t in (a.items.ravel() if a.items is not None else [a.buffer])]
        kept = [v for a in made.outputs if a.items is not None for v in a.items.ravel()]
        branched = uniform.branch_uniform_selects(made.blocks, find_varying(made.blocks, inputs, []), kept)
        unchanged += [first] if count_branches(branched) <= count_branches(made.blocks) else []
    assert unchanged == without  # these three programs have no select that all lanes decide alike


@pytest.mark.thorough(*[f"first{k}" for k in range(3, 120, 3)])
@pytest.mark.parametrize("first", range(0, 120, 3), ids=lambda k: f"first{k}")
def test_random_programs_agree_with_jax_and_in_lanes(first, monkeypatch):
    monkeypatch.setattr(uniform, "BRANCH_COST_MIN", 1)
    together, x, i = programs(first, 3)
    compiled = trimtab.compile(together, x[0], i[0], lanes=LANES)
    many = compiled.lanes(x, i)
    jitted = jax.jit(together)
    for k in range(len(x)):
        one, wanted = compiled(x[k], i[k]), jitted(x[k], i[k])
        for lane, single, want in zip(*map(jax.tree.leaves, (many, one, wanted)), strict=True):
            np.testing.assert_array_equal(lane[k], single)
            np.testing.assert_allclose(single, want, rtol=1e-9, atol=1e-12)
