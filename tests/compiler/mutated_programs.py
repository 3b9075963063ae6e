"""Functions whose text is mutated, each with a maker of its arguments: random ones, and edges where tests turn."""

from typing import Any, NamedTuple

import numpy as np
from jax import lax
from jax import numpy as jnp


class Sample(NamedTuple):
    """function, and make(rng) -> its arguments."""

    name: str
    function: Any
    make: Any


def _numbers(r: np.random.Generator, *shape: int) -> Any:
    return np.round(r.normal(0, 2, shape), 3)


def _halves(r: np.random.Generator, *shape: int) -> Any:
    """Few different numbers, so that they are often equal."""
    return r.integers(-3, 4, shape) / 2


def _side(r: np.random.Generator) -> Any:
    """A half, or a number near 0.25 or -0.25."""
    return r.choice([_halves(r), np.round(r.uniform(-0.4, 0.4), 3), 0.26, 0.24, -0.26, -0.24])


def _odd(r: np.random.Generator, n: int) -> Any:
    """Numbers that are often equal, sometimes infinite or NaN."""
    x = _halves(r, n)
    return np.where(r.random(n) < 0.4 * (r.random() < 0.5), r.choice([np.nan, np.nan, np.nan, np.inf, -np.inf], n), x)


def _place(r: np.random.Generator, n: int) -> Any:
    """An index, counted from the front or the back, or beyond: often the first, the last, and those just outside."""
    return r.choice(
        [0, n - 1, n, n + 1, -1, -n, -n - 1, 1, n - 2, int(r.integers(-n, n)), int(r.integers(-n, n)), 3 - n]
    )


def _two_places(r: np.random.Generator, n: int) -> Any:
    """Two indices, often the same."""
    k, j = np.int32(_place(r, n)), np.int32(_place(r, n))
    return k, r.choice([k, j])


def _integer(r: np.random.Generator) -> Any:
    """Small and large integers of both signs, and zero."""
    return np.int64(
        r.choice([0, 1, -1, int(r.integers(-9, 9)), int(r.integers(-400, 400)), int(r.integers(-(2**62), 2**62))])
    )


def rates(q: Any, w: Any) -> Any:
    """Quaternion kinematics."""
    a, b, c, d = q
    x, y, z = w
    turn = 0.5 * jnp.stack(
        [-b * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x]
    )
    return turn / jnp.sqrt(jnp.sum(q * q) + 0.1)


def kalman(x: Any, p: Any, q: Any, z: Any) -> Any:
    """One step of a filter of two states."""
    f = jnp.array([[1.0, 0.013], [-0.21, 0.97]])
    x, p = f @ x, f @ p @ f.T + q
    gain = p[:, 0] / (p[0, 0] + 0.37)
    return x + gain * (z - x[0]), p - jnp.outer(gain, p[0])


def limited(x: Any, low: Any, high: Any, z: Any) -> Any:
    """Saturation, and choices on tests that do not follow from each other."""
    y = jnp.clip(2.5 * x + 0.3, low, high)
    rest = jnp.where((z >= high) & (x > 0.25) | (z <= low) & (x < -0.25), 0.4, 0.02 * x)
    return y, rest, jnp.where(x == z, 7.0, y - x)


def turned(e: Any, v: Any) -> Any:
    """Elementary functions one after the other."""
    a = jnp.arctan2(jnp.sin(e) + 0.2, jnp.cos(e) * v)
    return a, jnp.exp(-0.3 * v) * a, jnp.log(v * v + 1.5), jnp.tanh(e - v)


def ring(x: Any, k: Any, j: Any, u: Any) -> Any:
    """A ring in a large array, read at another place."""
    past = lax.dynamic_update_index_in_dim(x, u, k, 0)
    return lax.dynamic_index_in_dim(past, j, keepdims=False), jnp.sum(x * x[::-1]) - u


def swept(x: Any, y: Any) -> Any:
    """A scan with a state and results."""

    def turn(c: Any, u: Any) -> Any:
        c = 0.9 * c + 0.31 * u * y[0]
        return c, jnp.where(c > y[1], c - y[1], c * 2)

    return lax.scan(turn, y[2], x)


def until(x: Any, z: Any, n: Any) -> Any:
    """A loop that ends on data and on a count, and a branch."""
    c, i = lax.while_loop(lambda c: (c[0] < x) & (c[1] < n), lambda c: (c[0] * 1.7 + 0.3, c[1] + 2), (z, 0))
    return lax.cond(c > 3.0, lambda: c * z, lambda: x - 3.0), i


def whole(a: Any, b: Any) -> Any:
    """Integers."""
    c = (a * 37 + b) ^ (b << 2)
    return (
        lax.rem(c, jnp.int64(11)),
        lax.div(c, jnp.int64(7)),
        c & 0xFF | a,
        jnp.where(a == b, c, b),
        (c > b).astype(jnp.int64) + a,
        c >> 3,
    )


def short(x: Any, y: Any) -> Any:
    """float32."""
    z = x * y + x / (y * y + jnp.float32(0.5))
    return z, y.astype(jnp.float64) * 0.3, jnp.where(z > x, z, y)


def product(a: Any, x: Any) -> Any:
    """A matrix of 49 numbers times another, in loops."""
    return a @ x, jnp.sum(a, 0) - x[:, 0]


def sorted_most(x: Any, i: Any) -> Any:
    """Where the largest is, and sums up to there."""
    return jnp.argmax(x), jnp.min(x), jnp.cumsum(x)[i]


SAMPLES = [
    Sample("rates", rates, lambda r: (_numbers(r, 4), _numbers(r, 3))),
    Sample("kalman", kalman, lambda r: (_numbers(r, 2), _numbers(r, 2, 2) ** 2, _numbers(r, 2, 2) ** 2, _numbers(r))),
    Sample("limited", limited, lambda r: (_side(r), -1.5 - _halves(r), 1.5 + _halves(r), _halves(r))),
    Sample("turned", turned, lambda r: (_numbers(r), _numbers(r))),
    Sample("ring", ring, lambda r: (_numbers(r, 60), *_two_places(r, 60), _numbers(r))),
    Sample("swept", swept, lambda r: (_numbers(r, 7), _numbers(r, 3))),
    Sample("until", until, lambda r: (_numbers(r) * 5 + 8, 1 + abs(_numbers(r)), np.int64(r.integers(-1, 9)))),
    Sample("whole", whole, lambda r: (_integer(r), _integer(r))),
    Sample("short", short, lambda r: (np.float32(_numbers(r)), np.float32(_numbers(r)))),
    Sample("product", product, lambda r: (_numbers(r, 7, 7), _numbers(r, 7, 7))),
    Sample("sorted_most", sorted_most, lambda r: (_odd(r, 6), np.int32(_place(r, 6)))),
]
