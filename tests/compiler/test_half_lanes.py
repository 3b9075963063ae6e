"""Lanes of programs of 32-bit numbers: twice as many as doubles in a vector, with the same bits as single calls."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.compiled_function import CompiledFunction
from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.core.errors import InputError

X, N, B = np.float32(0.3), np.int32(2), np.bool_(True)


def mixed(x: Any, n: Any, b: Any) -> tuple[Any, ...]:
    """Return results of branches, loops, tables and elementary functions of 32-bit numbers."""

    def turn(i: Any, carried: Any) -> Any:
        y, k = carried
        y = jnp.where(y > 0.5, jnp.sin(y) * 0.9 + jnp.arctan2(y, x + i.astype(jnp.float32)), y + jnp.exp(-y * y))
        return y, jnp.where(b, k + 1, k ^ 3)

    y, k = jax.lax.fori_loop(0, 20, turn, (x, n))
    start = x, n * 0
    z, turns = jax.lax.while_loop(
        lambda c: (c[0] < 3) & (c[1] < 50), lambda c: (c[0] + jnp.abs(jnp.cos(c[0])), c[1] + 1), start
    )
    table = jnp.linspace(x, y, 5)
    written = table.at[n % 5].set(jnp.sqrt(jnp.abs(x)))
    rare = n.astype(np.float64) > 0.3  # a few numbers of 64 bits are allowed
    whole = (jnp.sign(x), jnp.floor(x), x.astype(jnp.int32), n.astype(jnp.float32), n.astype(jnp.uint32) >> 1)
    tests = (b & (x > 0), jnp.isfinite(x), rare)
    return (y, k, z, turns, table[n % 5], written, *tests, *whole, jnp.maximum(x, y), jnp.sin(x), jnp.cos(x))


def call_in_halves(compiled: CompiledFunction, lanes: int) -> Any:
    """Return the compiled function over lanes, with the elementary functions in halves of them, on any CPU."""
    text = compiled._lowered.program_text(compiled._symbol, lanes, large_as_data=True, halves=True)
    arguments = compiled._arguments
    program = compiled._load(text, lanes)._replace(lanes=lanes, normalise=arguments.normaliser(of_runs=True))
    return arguments.make_callable(program)


@pytest.mark.thorough(16)
@pytest.mark.parametrize("lanes", [8, 16])
def test_lanes_of_32_bit_numbers_equal_single_calls(lanes: int) -> None:
    compiled, rng = trimtab.compile(mixed, X, N, B), np.random.default_rng(0)
    assert compiled._lowered.has_half_width()
    x = (2 * rng.normal(size=203)).astype(np.float32)
    x[:7] = [np.nan, np.inf, -np.inf, -0.0, 1e30, 1e-40, 2.0**31]
    n, b = rng.integers(-9, 9, 203).astype(np.int32), rng.random(203) > 0.5
    many = call_in_halves(compiled, lanes)(x, n, b)
    for k in range(203):
        for place, (found, wanted) in enumerate(zip(many, compiled(x[k], n[k], b[k]), strict=True)):
            assert found.dtype == wanted.dtype
            bits = f"u{found.itemsize}"
            same = (np.isnan(found[k]) & np.isnan(wanted)) | (found[k].view(bits) == wanted[()].view(bits))
            assert same.all(), (k, place)


@pytest.mark.parametrize(
    ("function", "example", "half"),
    [
        (lambda x: jnp.sin(x) * 2, X, True),
        (lambda n: jnp.where(n > 3, n ^ 5, -n), N, True),
        (lambda x: jnp.sin(x) * 2, np.float64(1), False),
        (lambda x: jnp.sin(x.astype(float)).astype(x.dtype), X, False),  # a double is not simple here
        (lambda x: jax.lax.fori_loop(0, 3, lambda i, y: y + x, np.float64(1)), X, False),  # carried
        (lambda x: x * np.float64(2) + np.float64(3) * x, X, False),  # not rare
    ],
)
def test_programs_of_32_bit_numbers_are_found(function: Any, example: Any, half: bool) -> None:
    compiled = trimtab.compile(function, example)
    assert compiled._lowered.has_half_width() is half
    found = find_compiler("c++")
    width = lane_count(found) if found else 1
    assert compiled._build_lanes()[0] == (2 * width if half and width > 1 else width)


def test_rejects_16_lanes_of_doubles() -> None:
    with pytest.raises(InputError, match="16 lanes of 'square' do not fit into a vector") as refusal:
        trimtab.compile(jnp.square, 1.0, lanes=16)
    assert refusal.value.fix == "lanes=8, or None"
