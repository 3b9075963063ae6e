"""Every covered primitive is compared with JAX; every other one is rejected with an alternative."""

from functools import cache
from typing import Any

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from contracts import primitive_groups
from contracts.compiled import LANES, Case, compiled, primitives
from trimtab.compiler.coverage import COVERED_PRIMITIVES, coverage_table
from trimtab.compiler.function import lower_function
from trimtab.compiler.jaxprs import CALLS
from trimtab.compiler.lower import ALTERNATIVES
from trimtab.compiler.rules import RULES
from trimtab.core.errors import InputError


def test_covered_primitives_are_those_with_a_rule() -> None:
    assert set(COVERED_PRIMITIVES) == set(RULES) | set(CALLS)


def test_every_covered_primitive_is_tested() -> None:
    tried = set().union(*(primitives(c.function, c.sets[0]) for make in primitive_groups.ALL for c in make()))
    assert set(COVERED_PRIMITIVES) - tried == set()


def test_coverage_table_has_a_row_per_primitive() -> None:
    assert len(coverage_table().splitlines()) == len(COVERED_PRIMITIVES) + 2


@pytest.mark.thorough
def test_subnormal_numbers_are_kept() -> None:
    # JAX on the CPU takes them as zero; here it is IEEE 754, as numpy does
    tiny = np.array([5e-324, -1e-310, 2.2250738585072014e-308, 1e-320])

    def program(x: jax.Array) -> tuple[jax.Array, ...]:
        return x * 0.5, x + x, x > 0, jnp.sqrt(jnp.abs(x)), -x, jnp.sign(x)

    wanted = [tiny * 0.5, tiny + tiny, tiny > 0, np.sqrt(np.abs(tiny)), -tiny, np.sign(tiny)]
    for lanes in (0, LANES):
        for got in compiled([Case("tiny", program, [(tiny,)])], lanes):
            assert all(np.array_equal(g, w) for g, w in zip(got, wanted, strict=True))


SIGNED = np.array([np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 5e-324])


@pytest.mark.thorough("50-float64", "50-float32")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("count", [5, 50])
def test_top_k_orders_nan_and_zeros_by_sign(dtype: Any, count: int) -> None:
    def top(x: jax.Array) -> Any:
        return [jax.lax.top_k(y, k) for y in (x, -x) for k in (1, count)]

    rng = np.random.default_rng(count)
    given = [rng.choice(SIGNED, count).astype(dtype) for _ in range(40)]
    function, traced = trimtab.compile(top, given[0]), jax.jit(top)
    for x in given:
        for got, wanted in zip(jax.tree.leaves(function(x)), jax.tree.leaves(traced(x)), strict=True):
            np.testing.assert_array_equal(got, wanted)
            assert np.array_equal(np.signbit(got), np.signbit(wanted))


def test_top_k_of_a_table_with_a_negative_nan() -> None:
    table = np.array([1.0, -np.nan, 2.0])
    top = trimtab.compile(lambda x: jax.lax.top_k(jnp.where(x > 0, table, x), 2), 1.0)
    np.testing.assert_array_equal(top(1.0)[1], [2, 0])


def test_sums_of_negative_zeros_are_negative_zero() -> None:
    [[got]] = compiled([Case("zeros", jnp.sum, [(np.array([-0.0, -0.0]),)])], 0)
    assert got == 0
    assert np.signbit(got)


def complex_numbers(x: jax.Array) -> jax.Array:
    return jnp.abs(x + 1j)  # refused


def moving_sum(x: jax.Array, first: jax.Array) -> jax.Array:
    return jax.lax.reduce_window(x, first, jax.lax.add, (2,), (1,), "VALID")  # refused


def half_precision(x: jax.Array) -> jax.Array:
    return x.astype(np.float16) * 2  # refused


def host_call(x: jax.Array) -> jax.Array:
    return jax.pure_callback(np.sin, x, x)  # refused


def in_a_loop(x: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(
        0,
        3,
        lambda i, x: jnp.linalg.eig(jnp.outer(x, x))[0].real,  # refused
        x,
    )


def printed(x: jax.Array) -> jax.Array:
    jax.debug.print("{}", x)  # refused
    return x


def pooled(x: jax.Array) -> jax.Array:
    return jnp.sum(jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (2,), (2,), "VALID") ** 2)  # refused


def own_reduction(x: jax.Array) -> jax.Array:
    return jax.lax.reduce(x, 0.0, lambda a, b: a + 2 * b, (0,))  # refused


REFUSED = {
    "reduce with a function": (own_reduction, "fori_loop"),
    "reduce_precision": (lambda x: jax.lax.reduce_precision(x, 8, 23), "astype"),  # refused
    "select_and_scatter_add": (jax.grad(pooled), "reshape"),
    "select_and_gather_add": (lambda x: jax.jvp(pooled, (x,), (x,)), "reshape"),
    "approx_top_k": (lambda x: jax.lax.approx_max_k(x, 2)[0], "top_k"),  # refused
    "eig": (lambda x: jnp.linalg.eig(jnp.outer(x, x))[0].real, "eigh"),  # refused
    "fft": (lambda x: jnp.fft.rfft(x).real, "cosines"),  # refused
    "rng_bit_generator": (lambda x: x + jax.random.normal(jax.random.key(0, impl="rbg")), "threefry"),  # refused
    "reduce_window": (lambda x: moving_sum(x, x[0]), "as Python numbers"),  # refused
    "pure_callback": (host_call, "plain jax.numpy"),
    "debug_print": (printed, "logged signal"),
    "complex": (complex_numbers, "float64"),
    "float16": (half_precision, "float64"),
    "eig in a loop": (in_a_loop, "eigh"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rejected_primitive_error_names_line_and_alternative(name: str) -> None:
    function, instead = REFUSED[name]
    with pytest.raises(InputError) as caught:
        lower_function(function, (np.arange(4.0),))
    text = str(caught.value)
    assert name.split()[0].split("_")[0] in text
    assert instead in caught.value.fix
    # the line is one of this file's that say so
    line = int(text.split("test_coverage.py:")[1].split(",")[0])
    with open(__file__) as file:
        assert "# refused" in file.readlines()[line - 1]


def cosines(x: jax.Array) -> jax.Array:
    n = x.shape[0]
    return jnp.cos(2 * jnp.pi / n * jnp.arange(n // 2 + 1)[:, None] * jnp.arange(n)) @ x


def threefry(seed: jax.Array) -> jax.Array:
    return jax.random.normal(jax.random.key(seed))


def alternating_sum(x: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(0, x.shape[0], lambda i, total: x[i] - total, 0.0)


def pooling_gradient(x: jax.Array) -> jax.Array:
    return jax.grad(lambda x: jnp.sum(x.reshape(-1, 2).max(axis=1) ** 2))(x)


TALL = np.random.default_rng(5).normal(size=(6, 4))
SUBSTITUTES = {
    "eig": (lambda a: jnp.linalg.eigh(a.T @ a)[0], TALL, lambda a: np.sort(np.linalg.eigvals(a.T @ a)), 1e-12),
    "rng": (
        lambda s: jax.random.normal(jax.random.key(s)),
        3,
        lambda s: float(jax.random.normal(jax.random.key(s))),
        1e-14,
    ),
    "fft": (cosines, TALL.ravel(), lambda x: np.fft.rfft(x).real, 1e-12),
    "reduce_window": (
        lambda x: jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (2,), (1,), "VALID"),
        TALL.ravel(),
        lambda x: np.maximum(x[1:], x[:-1]),
        0,
    ),
    "reduce": (alternating_sum, TALL.ravel(), lambda x: np.sum(x[::-1][::2]) - np.sum(x[::-1][1::2]), 1e-14),
    "reduce_precision": (
        lambda x: x.astype(jnp.float32).astype(jnp.float64),
        TALL,
        lambda x: jax.lax.reduce_precision(x, 8, 23),
        0,
    ),
    "select_and": (pooling_gradient, TALL.ravel(), jax.grad(pooled), 0),
    "approx_top_k": (lambda x: jax.lax.top_k(x, 3), TALL.ravel(), lambda x: jax.lax.approx_max_k(x, 3), 0),
    "callback": (lambda x: jnp.sin(x), TALL, np.sin, 1e-15),
    "print": (lambda x: x.sum(0), TALL, lambda x: x.sum(0), 1e-14),
}


@cache
def substitute_results() -> list[Any]:
    """Return the results of all substitutes, compiled as one program."""
    functions, arguments = [f for f, *_ in SUBSTITUTES.values()], [a for _, a, *_ in SUBSTITUTES.values()]
    return trimtab.compile(lambda *given: [f(a) for f, a in zip(functions, given, strict=True)], *arguments)(*arguments)


@pytest.mark.parametrize("name", SUBSTITUTES)
def test_suggested_substitutes_compile_and_agree(name: str) -> None:
    _, argument, wanted, off = SUBSTITUTES[name]
    results = jax.tree.leaves(substitute_results()[list(SUBSTITUTES).index(name)])
    for got, right in zip(results, jax.tree.leaves(wanted(argument)), strict=True):
        np.testing.assert_allclose(got, right, atol=off, rtol=0)


def test_every_suggested_substitute_is_tested() -> None:
    tried = {**dict.fromkeys(SUBSTITUTES), "schur": None}  # of schur the same is said as of eig
    assert ALTERNATIVES["schur"] == ALTERNATIVES["eig"]
    assert [name for name in ALTERNATIVES if not any(t in name for t in tried)] == []


def test_primitives_of_other_packages_use_their_implementation() -> None:
    other = jax.extend.core.Primitive("unvmap_any")
    other.def_impl(lambda x, *, sign: jnp.any(sign * x > 0))
    other.def_abstract_eval(lambda x, *, sign: jax.core.ShapedArray((), np.bool_))
    compiled = trimtab.compile(lambda x: other.bind(x, sign=-1.0), np.ones(3))
    assert not compiled(np.ones(3))
    assert compiled(np.array([1.0, -1.0, 0.0]))


def test_rejects_narrow_types_in_lanes() -> None:
    with pytest.raises(InputError, match="i8"):
        lower_function(lambda x: x + 1, (np.ones(3, np.int8),)).text("go", LANES)


def test_ring_update_is_done_in_place() -> None:
    # an update that nobody looks behind is done in place: the copy of the input is the result's own memory
    def ring(x: jax.Array, k: jax.Array) -> jax.Array:
        for i in range(3):
            x = x.at[k + i].set(1.0 * i)
        return x

    text = lower_function(ring, (np.zeros(100), np.int64(3))).text("go")
    assert text.count("[100];") == 0
    assert text.count(" < 100;") == 1
