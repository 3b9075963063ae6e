"""Products of arrays and factorisations of matrices: numbers of JAX, the same bits in lanes, sums in order."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.compiler.rules import product

RUNS = 5


def numbers(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape) / max(1, shape[-1]) ** 0.5


def agree(function, *arguments):
    """Compare one call with JAX, and lanes with single calls; gives what was compiled."""
    compiled = trimtab.compile(function, *arguments, lanes=4)
    leaves, wanted = jax.tree.leaves(compiled(*arguments)), jax.tree.leaves(jax.jit(function)(*arguments))
    for k, (result, number) in enumerate(zip(leaves, wanted, strict=True)):
        scale = max(1.0, float(np.max(np.abs(number), initial=0)))
        tolerance = 1e-13 if result.dtype == np.float64 else 2e-6
        np.testing.assert_allclose(result, number, rtol=0, atol=tolerance * scale, err_msg=f"result {k}")
    many = [np.stack([a + 0.01 * k for k in range(RUNS)]).astype(a.dtype) for a in arguments]
    together = jax.tree.leaves(compiled.lanes(*many))
    for k in range(RUNS):
        for result, alone in zip(together, jax.tree.leaves(compiled(*(a[k] for a in many))), strict=True):
            assert np.array_equal(result[k], alone, equal_nan=True)
    return compiled


FORMULAS = (
    ("ij,jk->ik", (7, 7), (7, 7)),
    ("ij,jk->ik", (9, 50), (50, 17)),  # more terms than are unrolled, neighbours in tiles and a rest
    ("ij,jk->ik", (64, 64), (64, 64)),  # tiles that are copied
    ("ij,jk->ik", (30, 60), (60, 2)),  # few columns: the rows are the neighbours
    ("ij,kj->ik", (9, 20), (11, 20)),
    ("ij,kj->ik", (2, 60), (70, 60)),  # few rows, columns that lie apart
    ("ij,j->i", (60, 51), (51,)),
    ("ij,j->i", (3, 70), (70,)),
    ("ji,j->i", (51, 60), (51,)),
    ("bij,bjk->bik", (5, 8, 9), (5, 9, 10)),
    ("ijk,jkl->il", (6, 12, 7), (12, 7, 9)),
    ("ijk,ljk->li", (6, 12, 7), (9, 12, 7)),
    ("i,j->ij", (20,), (30,)),
    ("ij,ij->", (20, 30), (20, 30)),
    ("bi,bi->b", (60, 9), (60, 9)),
    ("ij,jk->ik", (60, 0), (0, 3)),
)
"""Formula, and the shapes of its two arrays."""


@pytest.mark.thorough
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_products_match_jax(dtype):
    """All formulas in one program: one call of each compiler."""
    arrays = [numbers(*shape, seed=k).astype(dtype) for _, *shapes in FORMULAS for k, shape in enumerate(shapes)]

    def multiply(*arrays):
        return [
            jnp.einsum(f, *pair)
            for (f, _, _), pair in zip(FORMULAS, zip(arrays[::2], arrays[1::2], strict=True), strict=True)
        ]

    agree(multiply, *arrays)


def test_integer_products_are_exact():
    a = np.arange(60 * 61, dtype=np.int32).reshape(60, 61) * 7919
    compiled = trimtab.compile(lambda a: a @ a.T, a)
    assert np.array_equal(compiled(a), np.asarray(jax.jit(lambda a: a @ a.T)(a)))


@pytest.mark.parametrize("terms", [20, 60])
def test_products_sum_in_index_order(terms):
    a, b = numbers(9, terms), numbers(terms, 30, seed=1)
    total = np.zeros((9, 30))
    for k in range(terms):
        total = total + a[:, k, None] * b[k]
    assert np.array_equal(trimtab.compile(lambda a, b: a @ b, a, b)(a, b), total)


def test_sum_of_negative_zeros_is_negative_zero():
    zeros = trimtab.compile(lambda a, b: a @ b, np.zeros((9, 8)), np.zeros((8, 9)))(-np.zeros((9, 8)), np.ones((8, 9)))
    assert np.all(np.signbit(zeros))


def test_products_propagate_nan_and_infinity():
    a, b = numbers(60, 60), numbers(60, 60, seed=1)
    a[3, 4], a[5, 6], b[7, 8] = np.nan, np.inf, -np.inf
    compiled = trimtab.compile(lambda a, b: a @ b, a, b)
    wanted = np.asarray(jax.jit(lambda a, b: a @ b)(a, b))
    assert np.array_equal(np.isnan(compiled(a, b)), np.isnan(wanted))
    assert np.array_equal(np.isinf(compiled(a, b)), np.isinf(wanted))


def test_constant_weights_are_transposed_and_stored_once():
    W = numbers(16, 60)
    compiled = agree(lambda v, w: (W @ v) + (W @ w), numbers(60), numbers(60, seed=1))
    assert len(re.findall(r"static const double \w+\[960\]", compiled.c_source)) == 1
    assert compiled.c_source.index(repr(float(W[1, 0]))) - compiled.c_source.index(repr(float(W[0, 0]))) < 100


def test_given_weights_are_transposed_before_the_loop():
    W, x = numbers(64, 64), numbers(64)

    def steps(W, x):
        return jax.lax.fori_loop(0, 50, lambda _, x: jnp.tanh(W @ x), x)

    source = agree(steps, W, x).c_source
    assert source.index("< 64; ") < source.index("< 50; ")


def in_a_scan(W, x):
    """A flat vector of numbers taken as two matrices, again and again."""

    def body(x, _):
        return W.reshape(48, 24) @ jnp.tanh(W.reshape(24, 48) @ x), None

    return jax.lax.scan(body, x, None, length=3)[0]


SHAPES = {
    "tied weights": ((24, 48), (48,), lambda W, x: W.reshape(48, 24) @ (W @ x)),
    "heads": (
        (4, 6, 48),
        (4, 48),
        lambda W, x: (
            jnp.einsum("bi,hdi->bhd", x, W).ravel() + jnp.einsum("bi,hdi->bhd", x, W.reshape(2, 12, 48)).ravel()
        ),
    ),
    "three shapes": (
        (2, 12, 48),
        (5, 48),
        lambda W, x: [jnp.einsum("bi,hdi->bhd", x, W.reshape(n, 24 // n, 48)) for n in (2, 4, 8)],
    ),
    "scan": ((24 * 48,), (48,), in_a_scan),
}


@pytest.mark.thorough(
    *("float32-scan", "float32-three shapes", "float32-heads", "float32-tied weights"),
    *("float64-heads", "float64-three shapes"),
)
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_products_of_one_array_at_several_shapes_match_jax(name, dtype):
    shape, other, function = SHAPES[name]
    """A given array and a known one, in one program: one call of each compiler."""
    W, x = numbers(*shape).astype(dtype), numbers(*other, seed=1).astype(dtype)
    agree(lambda given, x: [function(given, x), function(jnp.asarray(W), x)], W, x)


def test_innermost_loop_covers_neighbouring_elements(monkeypatch):
    a = numbers(60, 60)
    for width in (4, 8):
        monkeypatch.setattr(product, "WIDTH", width)
        source = trimtab.compile(lambda a, b: a @ b, a, a).c_source
        assert f"< {width}; " in source


@pytest.mark.thorough
@pytest.mark.parametrize("n", [2, 5, 7, 24, 50])
def test_factorisations_and_solutions_match_jax(n):
    def factors(a, b):
        return [
            jnp.linalg.cholesky(a @ a.T + jnp.eye(n)),
            jax.lax.linalg.lu(a + 3 * jnp.eye(n)[::-1]),
            jnp.linalg.solve(a + 3 * jnp.eye(n), b),
            jnp.linalg.solve(a + 3 * jnp.eye(n), b[:, 0]),
        ]

    agree(factors, numbers(n, n), numbers(n, 3, seed=1))


def test_lu_of_tall_and_wide_matrices_matches_jax():
    """All shapes in one program: one call of each compiler."""
    matrices = [numbers(*shape) for shape in ((9, 6), (6, 9), (60, 8))]
    agree(lambda *matrices: [jax.lax.linalg.lu(a) for a in matrices], *matrices)


def test_lu_of_singular_matrix_reproduces_it():
    a = numbers(8, 8)
    a[:, 3] = 0
    a[5] = a[2]
    L, pivots, order = trimtab.compile(jax.lax.linalg.lu, a)(a)
    factors = (np.tril(L, -1) + np.eye(8)) @ np.triu(L)
    np.testing.assert_allclose(factors, a[order], atol=1e-15)
    assert np.all(pivots >= np.arange(8))


def test_cholesky_of_non_positive_definite_matrix_is_nan():
    a = -np.eye(9)
    assert np.all(np.isnan(np.tril(trimtab.compile(jnp.linalg.cholesky, a)(a))[np.tril_indices(9)]))


@pytest.mark.thorough
@pytest.mark.parametrize("sides", [1, 2, 12])
def test_triangular_solutions_match_jax(sides):
    """All kinds in one program: one call of each compiler."""
    a, b = numbers(20, 20), numbers(20, sides, seed=1)

    def solve(a, columns, rows):
        return [
            jax.lax.linalg.triangular_solve(
                a + 3 * jnp.eye(20), columns if left else rows, left_side=left, lower=lower, transpose_a=transpose
            )
            for lower, transpose, left in itertools.product([False, True], repeat=3)
        ]

    agree(solve, a, b, b.T.copy())


@pytest.mark.thorough
def test_batched_solve_and_cholesky_match_jax():
    agree(jnp.linalg.solve, numbers(4, 8, 8) + 2 * np.eye(8), numbers(4, 8, 2, seed=1))
    agree(lambda a: jnp.linalg.cholesky(a @ jnp.swapaxes(a, 1, 2) + jnp.eye(8)), numbers(3, 8, 8))


@pytest.mark.parametrize("mode", ["same", "full"])
def test_convolution_ignores_padding(mode):
    kernel = np.array([1.0, np.inf, 2.0, np.nan])
    compiled = trimtab.compile(lambda a, k: jnp.convolve(a, k, mode=mode), np.ones(8), kernel)
    for k in (kernel, kernel[::-1]):
        np.testing.assert_array_equal(compiled(np.ones(8), k), np.convolve(np.ones(8), k, mode))
