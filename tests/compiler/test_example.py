"""Examples that `trimtab.compile` takes and refuses: each refusal has its problem and a fix that works."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab
from trimtab.core.errors import InputError

KEY = jax.random.key(3)


def scaled(x: Any, k: Any) -> Any:
    return x * k, x.sum()


def inside_itself() -> list[Any]:
    endless: list[Any] = []
    endless.append(endless)
    return endless


def bad_programs() -> dict[str, tuple[Any, tuple[Any, ...], str, str]]:
    x = np.zeros(3)
    return {
        "no function": (3, (1.0,), "int is not a function", ""),
        "too few": (scaled, (1.0,), "missing a required argument: 'k'", ""),
        "dates": (lambda x: x, (np.zeros(2, "M8[s]"),), "cannot be used", ""),
        "objects": (lambda x: x, (np.array([None]),), "cannot be used", ""),
        "texts": (lambda x: x, (np.array(["a"]),), "cannot be used", ""),
        "records of numpy": (lambda x: x, (np.zeros(2, [("a", "f8")]),), "cannot be used", ""),
        "a large number": (lambda x: x, (2**70,), "cannot be used", "float64"),
        "complex": (lambda x: x, (1j,), "complex128", "imaginary"),
        "half": (lambda x: x, (np.float16(1),), "float16", "float32"),
        "in itself": (lambda x: x, (inside_itself(),), "not a tree", ""),
        "keys of several types": (lambda d: d[1], ({1: 1.0, "a": 2.0},), "not a tree", ""),
        "text out": (lambda x: "a", (1.0,), "does not return arrays", ""),
        "numpy": (lambda x: np.sin(np.asarray(x)), (1.0,), "numpy array", "jax.numpy"),
        "mask": (lambda x: x[x > 0], (x,), "number of elements", "jnp.where"),
        "range": (lambda n: sum(range(n)), (3,), "branches in Python", "fori_loop"),
        "2^31 in": (lambda x: x[:1], (jax.ShapeDtypeStruct((2**16, 2**15), np.float64),), "2147483648", "2**31"),
        "2^31 within": (lambda x: jnp.broadcast_to(x, (2**31,)).sum(), (1.0,), "test_example.py", "2**31"),
        "2^32 within": (lambda x: jnp.outer(x, x).min(), (np.zeros(2**16),), "4294967296", "2**31"),
    }


@pytest.mark.parametrize("name", bad_programs())
def test_rejects_unsupported_programs(name: str) -> None:
    function, example, problem, fix = bad_programs()[name]
    with pytest.raises(InputError, match=problem) as refusal:
        trimtab.compile(function, *example)
    assert fix in refusal.value.fix
    assert refusal.value.fix


def test_suggested_fixes_for_complex_and_half_numbers_work() -> None:
    z = np.array([1 + 2j, -0.5j])
    product = trimtab.compile(lambda a, b: (a * a - b * b, 2 * a * b), jnp.real(z), jnp.imag(z))
    real, imaginary = product(jnp.real(z), jnp.imag(z))
    np.testing.assert_allclose(real + 1j * imaginary, z * z, rtol=1e-15)
    half = trimtab.compile(lambda x: x * 2, np.float16(1.5).astype(np.float32))
    assert half(np.float16(1.5)) == 3.0


def test_compiles_keys_captured_by_closure() -> None:
    keys = jax.random.split(KEY, 60)
    compiled = trimtab.compile(lambda i: jax.random.uniform(keys[i]) + jax.random.uniform(KEY), 3)
    for i in (0, 59):
        assert compiled(i) == jax.random.uniform(keys[i]) + jax.random.uniform(KEY)


def test_accepts_byte_swapped_examples() -> None:
    x = np.arange(3.0)
    assert np.array_equal(trimtab.compile(lambda x: x * 2, x.astype(">f8"))(x), x * 2)
