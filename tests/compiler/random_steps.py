"""Random programs over ticks: selects by tests that are the same in all lanes or differ, nested, with a ring in memory.

The numbers meet NaN, infinities, limits of integers, divisions by zero, and reads behind the end of the ring.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

TICKS = 7
STATEMENTS = 26
RING = 64
NUMBERS = (0.0, 1.0, -2.5, 1e10, np.inf, np.nan, 2147483647.5)


def random_program(rng: Any) -> Callable[[Any, Any], Any]:
    """A function of three floats and two int32 that repeats a random step; rng: of the standard library."""
    kinds = list(STEPS) * 2 + ["select_same"] * 8 + ["test_of_time"] * 2
    steps = [(STEPS[kind], rng.random(), rng.random(), rng.random()) for kind in rng.choices(kinds, k=STATEMENTS)]
    ends = [rng.random() for _ in range(5)]

    def program(x: Any, i: Any) -> Any:
        def tick(carry: Any, k: Any) -> Any:
            x, i, ring = carry
            pools = {
                "float": [*x, 0.5 * k.astype(jnp.float64)],
                "int": [*i, k],
                "same": [k % 3 == 0, k < 4],
                "differs": [x[0] < x[1]],
                "ring": [ring],
                "time": [k.astype(jnp.int64) * 1000],
            }
            for step, *draws in steps:
                step(pools, *draws)
            new_x = jnp.stack([_pick(pools["float"], e) for e in ends[:3]])
            new_i = jnp.stack([_pick(pools["int"], e) for e in ends[3:]])
            small = jnp.where(jnp.abs(new_x) < 1e12, new_x, 0.125)  # rounding of XLA's own must not grow
            return (small, new_i, pools["ring"][-1]), new_x[0]

        start = x, i, jnp.linspace(-1.0, 1.0, RING) + x[0]
        (x, i, ring), row = lax.scan(tick, start, jnp.arange(TICKS, dtype=jnp.int32))
        return x, i, ring, row

    return program


def _pick(pool: list[Any], draw: float) -> Any:
    """The last ones are taken more often, so that values build on each other."""
    return pool[int(len(pool) * draw**0.5)]


def _arithmetic(pools: Any, a: float, b: float, c: float) -> None:
    x, y = _pick(pools["float"], a), _pick(pools["float"], b)
    pools["float"].append([x + y, x - y, x * y, x / y, jnp.maximum(x, NUMBERS[int(7 * b)])][int(5 * c)])


def _function(pools: Any, a: float, b: float, c: float) -> None:
    x = _pick(pools["float"], a)
    small = jnp.clip(x, -3.0, 3.0)
    pools["float"].append([jnp.sin(small), jnp.exp(small), jnp.sqrt(small), jnp.log(small), -x][int(5 * c)])


def _number(pools: Any, a: float, b: float, c: float) -> None:
    pools["float"].append(_pick(pools["float"], a) * NUMBERS[int(7 * b)])


def _conversion(pools: Any, a: float, b: float, c: float) -> None:
    pools["int"].append(_pick(pools["float"], a).astype(jnp.int32))


def _division(pools: Any, a: float, b: float, c: float) -> None:
    x, y = _pick(pools["int"], a), _pick(pools["int"], b)
    pools["int"].append([lax.div(x, y), lax.rem(x, y), x + y, x * y][int(4 * c)])


def _test_of_time(pools: Any, a: float, b: float, c: float) -> None:
    k, test = pools["int"][2], _pick(pools["same"], a)
    pools["same"].append([k % (2 + int(3 * b)) == 1, ~test, test & (k > int(4 * b)), test | (k == 2)][int(4 * c)])


def _test_of_lanes(pools: Any, a: float, b: float, c: float) -> None:
    test = _pick(pools["float"], a) < _pick(pools["float"], b)
    pools["differs"].append(test if c < 0.7 else test & _pick(pools["same"], b))


def _select_same(pools: Any, a: float, b: float, c: float) -> None:
    for kind, draw in (("float", a), ("int", b)):
        if kind == "int" and c < 0.5:
            continue
        yes, no = _pick(pools[kind], draw), _pick(pools[kind], c)
        pools[kind].append(jnp.where(_pick(pools["same"], c), yes, no))


def _select_differs(pools: Any, a: float, b: float, c: float) -> None:
    yes, no = _pick(pools["float"], a), _pick(pools["float"], b)
    pools["float"].append(jnp.where(_pick(pools["differs"], c), yes, no))


def _place(pools: Any, a: float, b: float, c: float) -> None:
    """A place in a ring from a time in 64 bits."""
    back = _pick(pools["int"], a).astype(jnp.int64)
    pools["int"].append(((pools["time"][0] - back) & (RING - 1)).astype(jnp.int32))


def _read(pools: Any, a: float, b: float, c: float) -> None:
    place = _pick(pools["int"], a)
    pools["float"].append(pools["ring"][-1][place & 63 if c < 0.6 else jnp.clip(place, -5, 70)])


def _write(pools: Any, a: float, b: float, c: float) -> None:
    ring, place = pools["ring"][-1], _pick(pools["int"], a) & 63
    new = ring.at[place].set(jnp.clip(_pick(pools["float"], b), -9.0, 9.0))
    pools["ring"].append(new if c < 0.4 else jnp.where(_pick(pools["same"], c), new, ring))


STEPS = {
    "arithmetic": _arithmetic,
    "function": _function,
    "number": _number,
    "conversion": _conversion,
    "division": _division,
    "test_of_time": _test_of_time,
    "test_of_lanes": _test_of_lanes,
    "select_same": _select_same,
    "select_differs": _select_differs,
    "place": _place,
    "read": _read,
    "write": _write,
}
