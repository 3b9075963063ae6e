"""Bounds of integers: they hold for every number that the operations give, and decide tests."""

import random

import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.ir import TYPES, Builder
from trimtab.compiler.ranges import certain_result, integer_bounds, never_wraps
from trimtab.compiler.values import Value

TYPE = "i32"
RUNS = 60
"""Number of inputs that are tried with each value."""
OPERATIONS = {
    "add": np.add,
    "sub": np.subtract,
    "and": np.bitwise_and,
    "min": np.minimum,
    "max": np.maximum,
    "rem": np.fmod,
}
TESTS = {"lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal}
TESTS |= {"eq": np.equal, "ne": np.not_equal}


def random_value(rng, inputs, depth):
    """A value that nothing has folded, and how to compute it from the inputs."""
    kind = rng.choice(["input", "const", "index"] if depth == 0 else [*OPERATIONS, "select", "convert", "const"])
    if kind == "const":
        number = TYPES[TYPE](rng.choice([0, 1, -1, 7, 63, 64, rng.randint(-9, 99)]))
        return Value("const", (), TYPE, const=number), lambda _, number=number: number
    if kind in ("input", "index"):
        k = len(inputs)
        inputs.append(kind)
        return Value(kind, (), TYPE, attr=10 if kind == "index" else None), lambda given, k=k: given[k]
    x, of_x = random_value(rng, inputs, depth - 1)
    y, of_y = random_value(rng, inputs, depth - 1)
    if kind == "select":
        test = Value("input", (), "bool")
        return Value("select", (test, x, y), TYPE), lambda given: np.where(given[-1] % 2, of_x(given), of_y(given))
    if kind == "convert":
        wide = Value("convert", (x,), "i64")
        return Value("convert", (wide,), TYPE), of_x
    if kind == "rem" and y.op != "const":
        kind = "add"

    def compute(given):
        a, b = of_x(given), of_y(given)
        with np.errstate(all="ignore"):
            return OPERATIONS[kind](a, b) if kind != "rem" or b else a

    return Value(kind, (x, y), TYPE), compute


@pytest.mark.parametrize("first", range(0, 300, 50))
def test_values_stay_within_their_integer_bounds(first):
    for seed in range(first, first + 50):
        check_bounds(seed)


def check_bounds(seed):
    """Compare the bounds of two random values with all that the values give for RUNS random inputs."""
    rng, numbers, inputs = random.Random(seed), np.random.default_rng(seed), []
    x, of_x = random_value(rng, inputs, 3)
    y, of_y = random_value(rng, inputs, 2)
    given = []
    for kind in inputs:
        ends = [(0, 10), (0, 10)] if kind == "index" else [(-(2**31), 2**31), (-70, 71)]
        wide, near = (numbers.integers(low, high, RUNS, np.int32) for low, high in ends)
        given.append(np.where(numbers.random(RUNS) < 0.5, wide, near))
    given.append(numbers.integers(0, 2, RUNS, np.int32))
    bounds, a, b = integer_bounds(x), of_x(given), of_y(given)
    assert bounds is None or np.all((bounds[0] <= a) & (a <= bounds[1])), seed
    for op, test in TESTS.items():
        certain = certain_result(op, (x, y))
        assert certain is None or np.all(test(a, b) == certain), seed
    for op in ("min", "max", "and"):
        which = certain_result(op, (x, y))
        assert which is None or np.all((a, b)[which] == OPERATIONS[op](a, b)), seed


def test_masked_ring_index_needs_no_bounds_check():
    b = Builder()
    slot = b.op("and", Value("input", (), "i64"), b.const(63, "i64"), dtype="i64")
    assert integer_bounds(slot) == (0, 63)
    assert b.op("lt", slot, b.const(0, "i64"), dtype="bool").const == np.False_
    assert b.op("min", b.op("max", slot, b.const(0, "i64"), dtype="i64"), b.const(63, "i64"), dtype="i64") is slot


def test_sums_that_may_overflow_have_the_bounds_of_their_type():
    b = Builder()
    least = b.op("max", Value("input", (), "i32"), b.const(0, "i32"), dtype="i32")
    assert integer_bounds(least) == (0, 2**31 - 1)
    large = b.op("and", Value("input", (), "i32"), b.const(2**31 - 1, "i32"), dtype="i32")
    total = b.op("add", large, b.const(1, "i32"), dtype="i32")
    assert integer_bounds(total) == (-(2**31), 2**31 - 1)
    assert not never_wraps(total)
    slot = b.op("and", Value("input", (), "i32"), b.const(63, "i32"), dtype="i32")
    assert never_wraps(b.op("mul", slot, b.const(1000, "i32"), dtype="i32"))


def test_indices_in_range_are_not_clamped():
    x = np.arange(100.0)
    source = trimtab.compile(lambda x, n: x[n & 63] + jnp.sum(x[jnp.arange(60)]), x, 3).c_source
    assert "tt_max" not in source
    assert "tt_min" not in source
