"""Signs of zeros in the larger and the smaller of two numbers: -0 is smaller than +0, as in IEEE 754-2019 and JAX."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import trimtab

NUMBERS = [0.0, -0.0, np.nan, np.inf, -np.inf, 1.0, -1.0, 1e30]
PAIRS = np.array([*itertools.product(NUMBERS, NUMBERS)])
CONSTANTS = [0.0, -0.0, 1.0, np.inf]


def extremes(a: Any, b: Any) -> list[Any]:
    found = [jnp.maximum(a, b), jnp.minimum(a, b), jnp.clip(a, b, 1), jnp.clip(a, -1, b), jax.nn.relu(a)]
    for number in np.array(CONSTANTS, a.dtype):
        found += [jnp.maximum(a, number), jnp.maximum(number, a), jnp.minimum(a, number), jnp.minimum(number, a)]
    return found


def assert_same_numbers(got: Any, wanted: Any) -> None:
    np.testing.assert_array_equal(got, wanted)
    known = ~np.isnan(wanted)
    np.testing.assert_array_equal(np.signbit(got)[known], np.signbit(wanted)[known])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_zero_signs_of_pairs_match_jax_in_lanes(dtype: Any) -> None:
    a, b = PAIRS.T.astype(dtype)
    compiled = trimtab.compile(extremes, a[0], b[0], lanes=4)
    many = compiled.lanes(a, b)
    for got, wanted in zip(many, extremes(jnp.asarray(a), jnp.asarray(b)), strict=True):
        assert_same_numbers(got, np.asarray(wanted))
    for k, (x, y) in enumerate(zip(a, b, strict=True)):
        for got, lane in zip(compiled(x, y), many, strict=True):
            assert_same_numbers(got, lane[k])


def test_zero_signs_of_arrays_and_constants_match_jax() -> None:
    a, b = PAIRS.T
    for got, wanted in zip(
        trimtab.compile(extremes, a, b)(a, b), extremes(jnp.asarray(a), jnp.asarray(b)), strict=True
    ):
        assert_same_numbers(got, np.asarray(wanted))
    known = trimtab.compile(lambda _: [jnp.maximum(x, y) for x, y in PAIRS], 0.0)(0.0)
    assert_same_numbers(np.array(known), np.asarray(jnp.maximum(a, b)))
    known = trimtab.compile(lambda _: [jnp.minimum(x, y) for x, y in PAIRS], 0.0)(0.0)
    assert_same_numbers(np.array(known), np.asarray(jnp.minimum(a, b)))


@pytest.mark.parametrize("count", [4, 60])
def test_reductions_order_negative_zero_below_positive(count: int) -> None:
    # JAX does not promise the zero of a reduction, but the reduction of two numbers is their extreme
    def reductions(x: Any) -> Any:
        window = [jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (2,), (1,), "VALID")]
        most = jnp.full(2, -0.0).at[jnp.array([0, 1, 1, 1])].max(x[:4])
        return jnp.max(x), jnp.min(x), jax.lax.cummax(x), jax.lax.cummin(x), *window, most

    compiled = trimtab.compile(reductions, np.zeros(count))
    for pattern in itertools.product((0.0, -0.0), repeat=4):
        x = np.array(pattern * (count // 4))
        negative = np.signbit(x)
        signs = [np.signbit(v) for v in compiled(x)]
        assert signs[0] == negative.all()
        assert signs[1] == negative.any()
        assert np.array_equal(signs[2], np.logical_and.accumulate(negative))
        assert np.array_equal(signs[3], np.logical_or.accumulate(negative))
        assert np.array_equal(signs[4], negative[1:] & negative[:-1])
        assert np.array_equal(signs[5], [negative[0], negative[1:4].all()])


def test_heading_of_a_stopped_vehicle_is_zero() -> None:
    heading = trimtab.compile(lambda s, v: jnp.arctan2(0 * s, jnp.maximum(-v * s, 0)), 0.0, 1.0)
    assert heading(0.0, 1.0) == 0.0
