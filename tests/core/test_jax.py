"""JAX computes right numbers: two programs that JAX 0.10.2 gets wrong on CPUs without saying so (jax-ml/jax#39103)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.compiled_function import compile

jax.config.update("jax_enable_x64", True)

ROWS = {"float64": 16_385, "float32": 32_769}
"""Fewest rows for which JAX 0.10.2 is wrong."""


def products(dtype):
    """Squared lengths of products of a matrix and many vectors, the vectors, and the exact numbers."""
    numbers = np.arange(ROWS[dtype], dtype=dtype)
    vectors = np.zeros((len(numbers), 3), dtype)
    vectors[:, 0] = numbers
    matrix = jnp.eye(3, dtype=dtype)
    return jax.vmap(lambda vector: jnp.sum((matrix @ vector) ** 2)), vectors, numbers**2


@pytest.mark.parametrize("dtype", ROWS)
def test_jit_sums_products_of_many_vectors_correctly(dtype):
    function, vectors, exact = products(dtype)
    np.testing.assert_array_equal(jax.jit(function)(vectors), exact)


@pytest.mark.parametrize("dtype", ROWS)
def test_compiled_c_sums_products_of_many_vectors_correctly(dtype):
    function, vectors, exact = products(dtype)
    np.testing.assert_array_equal(compile(function, vectors)(vectors), exact)
