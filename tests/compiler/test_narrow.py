"""Integers of 64 bits of which the low 32 are used: the same numbers from 32 bits, at the limits of both types."""

import random

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.function import lower_function
from trimtab.compiler.ir import TYPES, Builder
from trimtab.compiler.narrow import LARGEST, narrow_integer
from trimtab.compiler.values import Value

WHOLE = [0, 1, -1, 2, 63, 64, -64, 2**31 - 1, -(2**31), 2**31, 2**32 - 1, 2**32, 2**63 - 1, -(2**63), 123456789012345]
COMPUTE = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "neg": np.negative,
}


def evaluate(value, given):
    """The number of a value; given: by id of an input."""
    if value.op == "const":
        return value.const
    if value.op == "input":
        return given[id(value)]
    numbers = [evaluate(a, given) for a in value.args]
    with np.errstate(all="ignore"):
        if value.op == "convert":
            return np.asarray(numbers[0]).astype(TYPES[value.dtype])[()]
        return COMPUTE[value.op](*numbers)


def random_wide(rng, inputs, depth, dtype):
    """A 64-bit value of inputs of all widths, that nothing has folded."""
    if depth == 0 or rng.random() < 0.15:
        source = rng.choice(["bool", "i8", "u16", "i32", "u32", "i32", dtype, "const"])
        if source == "const":
            return Value("const", (), dtype, const=np.asarray(rng.choice(WHOLE[:8])).astype(TYPES[dtype])[()])
        made = Value("input", (), source)
        inputs.append(made)
        return made if source == dtype else Value("convert", (made,), dtype)
    op = rng.choice([*COMPUTE, "convert"])
    if op == "convert":
        other = "u64" if dtype == "i64" else "i64"
        return Value(op, (random_wide(rng, inputs, depth - 1, other),), dtype)
    count = 1 if op in ("not", "neg") else 2
    return Value(op, tuple(random_wide(rng, inputs, depth - 1, dtype) for _ in range(count)), dtype)


def widths(value, found):
    """The types of all values that are computed for this one."""
    if value.op not in ("input", "const"):
        found.add((value.op, value.dtype))
        for a in value.args:
            widths(a, found)
    return found


@pytest.mark.parametrize("seed", range(200))
def test_narrowed_integer_matches_low_bits_of_wide(seed):
    rng, inputs = random.Random(seed), []
    wide = random_wide(rng, inputs, 3, rng.choice(["i64", "u64"]))
    dtype = rng.choice(["i32", "u32"])
    narrow = narrow_integer(Builder(), wide, dtype)
    if narrow is None:
        return
    assert narrow.dtype == dtype
    assert not {(op, t) for op, t in widths(narrow, set()) if op != "convert" and t in ("i64", "u64")}
    for _ in range(40):
        given = {id(v): np.asarray(rng.choice(WHOLE)).astype(TYPES[v.dtype])[()] for v in inputs}
        assert evaluate(narrow, given) == np.asarray(evaluate(wide, given)).astype(TYPES[dtype])


def test_most_random_integers_become_narrow():
    found = 0
    for seed in range(200):
        rng = random.Random(seed)
        found += narrow_integer(Builder(), random_wide(rng, [], 3, "i64"), "i32") is not None
    assert found > 60


def place(b, instant, back):
    """(instant - back) & 63 in 64 bits."""
    wide = b.op("convert", back, dtype="i64")
    return b.op("and", b.op("sub", instant, wide, dtype="i64"), b.const(63, "i64"), dtype="i64")


def test_ring_index_is_narrowed_to_32_bits():
    b = Builder()
    instant, back = Value("input", (), "i64"), Value("input", (), "i32")
    found = b.op("convert", place(b, instant, back), dtype="i32")
    assert (found.op, found.dtype, found.args[0].op, found.args[0].dtype) == ("and", "i32", "sub", "i32")
    assert found.args[0].args[1] is back


def test_integers_of_64_bit_inputs_stay_wide():
    b = Builder()
    x, y = Value("input", (), "i64"), Value("input", (), "i64")
    assert narrow_integer(b, b.op("add", x, y, dtype="i64"), "i32") is None
    assert narrow_integer(b, b.op("add", x, b.const(1, "i64"), dtype="i64"), "i32") is None


def test_quotients_and_right_shifts_stay_wide():
    b = Builder()
    wide = b.op("convert", Value("input", (), "i32"), dtype="i64")
    for op in ("div", "rem", "shift_right_logical", "shift_right_arithmetic", "max"):
        assert narrow_integer(b, b.op(op, wide, b.const(5, "i64"), dtype="i64"), "i32") is None


def test_computation_beyond_the_size_limit_stays_wide():
    b = Builder()
    x = b.op("convert", Value("input", (), "i32"), dtype="i64")
    for _ in range(LARGEST):
        x = b.op("mul", x, x, dtype="i64")
    assert narrow_integer(b, x, "i32") is not None
    assert narrow_integer(b, b.op("mul", x, x, dtype="i64"), "i32") is None


def test_ring_reads_match_jax_at_extreme_indices():
    table = np.linspace(0.0, 1.0, 64)

    def function(instant, delay):
        return jnp.asarray(table)[(instant - jnp.floor(delay).astype(jnp.int32)) & 63]

    instants = np.array([0, 63, 64, 2**31, 2**40 + 5, -1, -(2**63), 2**63 - 1])
    delays = np.array([0.0, 1.5, 63.9, 64.0, 2e9, -3e9, np.nan, np.inf])
    lowered = lower_function(function, (instants[0], delays[0]))
    text = lowered.text("go")
    assert "& 63;" in text[text.index("void go(") :]  # not 63LL
    compiled = trimtab.compile(function, instants[0], delays[0], lanes=4)
    wanted = jax.vmap(function)(instants, delays)
    np.testing.assert_array_equal(compiled.lanes(instants, delays), wanted)
    np.testing.assert_array_equal([compiled(t, d) for t, d in zip(instants, delays, strict=True)], wanted)


def test_float_to_int32_conversion_matches_jax_at_limits():
    near = [2147483646.5, 2147483647.0, 2147483647.5, 2147483648.0, 4e9, 1e30, np.inf, 0.9, -0.0, np.nan]
    x = np.array([*near, *np.negative(near), -2147483648.5, -2147483649.0, 5.0, -7.9])
    for dtype in (np.float64, np.float32):
        values = x.astype(dtype)
        compiled = trimtab.compile(lambda v: v.astype(jnp.int32), values[0], lanes=4)
        wanted = [jnp.asarray(v).astype(jnp.int32) for v in values]
        np.testing.assert_array_equal(compiled.lanes(values), wanted)
        ordinary = np.array([1.5, -2.5, 3e8, -3e8], dtype)
        np.testing.assert_array_equal(compiled.lanes(ordinary), ordinary.astype(np.int32))
