"""Every primitive that is said to be covered, compared with JAX; every other one refused with a way out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from contracts import primitive_groups
from contracts.compiled import LANES, Case, compiled, primitives
from trimtab.compiler.coverage import COVERED_PRIMITIVES, coverage_table
from trimtab.compiler.function import lower_function
from trimtab.compiler.jaxprs import CALLS
from trimtab.compiler.rules import RULES
from trimtab.core.errors import InputError


def test_list_is_what_has_a_rule() -> None:
    assert set(COVERED_PRIMITIVES) == set(RULES) | set(CALLS)


def test_every_entry_is_tried() -> None:
    tried = set().union(*(primitives(c.function, c.sets[0]) for make in primitive_groups.ALL for c in make()))
    assert set(COVERED_PRIMITIVES) - tried == set()


def test_table_has_a_row_for_each() -> None:
    assert len(coverage_table().splitlines()) == len(COVERED_PRIMITIVES) + 2


def test_subnormal_numbers_are_kept() -> None:
    # JAX on the CPU takes them as zero; here it is IEEE 754, as numpy does
    tiny = np.array([5e-324, -1e-310, 2.2250738585072014e-308, 1e-320])

    def program(x: jax.Array) -> tuple[jax.Array, ...]:
        return x * 0.5, x + x, x > 0, jnp.sqrt(jnp.abs(x)), -x, jnp.sign(x)

    wanted = [tiny * 0.5, tiny + tiny, tiny > 0, np.sqrt(np.abs(tiny)), -tiny, np.sign(tiny)]
    for lanes in (0, LANES):
        for got in compiled([Case("tiny", program, [(tiny,)])], lanes):
            assert all(np.array_equal(g, w) for g, w in zip(got, wanted, strict=True))


def test_sums_of_negative_zeros_are_negative_zero() -> None:
    [[got]] = compiled([Case("zeros", jnp.sum, [(np.array([-0.0, -0.0]),)])], 0)
    assert got == 0
    assert np.signbit(got)


def complex_numbers(x: jax.Array) -> jax.Array:
    return jnp.abs(x + 1j)  # refused


def half_precision(x: jax.Array) -> jax.Array:
    return x.astype(np.float16) * 2  # refused


def host_call(x: jax.Array) -> jax.Array:
    return jax.pure_callback(np.sin, x, x)  # refused


def in_a_loop(x: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(
        0,
        3,
        lambda i, x: jnp.sort(x),  # refused
        x,
    )


def printed(x: jax.Array) -> jax.Array:
    jax.debug.print("{}", x)  # refused
    return x


REFUSED = {
    "sort": (lambda x: jnp.sort(x), "partition"),  # refused
    "lu": (lambda x: jnp.linalg.inv(jnp.outer(x, x)), "solve_spd"),  # refused
    "svd": (lambda x: jnp.linalg.svd(jnp.outer(x, x))[1], "design"),  # refused
    "eigh": (lambda x: jnp.linalg.eigh(jnp.outer(x, x))[0], "design"),  # refused
    "qr": (lambda x: jnp.linalg.qr(jnp.outer(x, x))[1], "Cholesky"),  # refused
    "fft": (lambda x: jnp.fft.rfft(x).real, "difference equation"),  # refused
    "random_bits": (lambda x: x + jax.random.normal(jax.random.key(0)), "core.rng"),  # refused
    "cumlogsumexp": (lambda x: jax.lax.cumlogsumexp(x), "coverage"),  # refused
    "pure_callback": (host_call, "plain jax.numpy"),
    "debug_print": (printed, "logged signal"),
    "complex": (complex_numbers, "float64"),
    "float16": (half_precision, "float64"),
    "sort in a loop": (in_a_loop, "partition"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_line_and_way_out(name: str) -> None:
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


def test_batches_of_matrices_are_refused() -> None:
    with pytest.raises(InputError, match="batch"):
        lower_function(jnp.linalg.cholesky, (np.ones((2, 3, 3)),))


def test_narrow_types_are_refused_in_lanes() -> None:
    with pytest.raises(InputError, match="i8"):
        lower_function(lambda x: x + 1, (np.ones(3, np.int8),)).text("go", LANES)


def test_known_programs_keep_their_shape() -> None:
    # an update that nobody looks behind is done in place: the copy of the input is the result's own memory
    def ring(x: jax.Array, k: jax.Array) -> jax.Array:
        for i in range(3):
            x = x.at[k + i].set(1.0 * i)
        return x

    text = lower_function(ring, (np.zeros(100), np.int64(3))).text("go")
    assert text.count("[100];") == 0
    assert text.count(" < 100;") == 1
